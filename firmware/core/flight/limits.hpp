// Angle, rate and encoder limits in flight, and the checks before arming.
#pragma once

#include <cstdint>

#include "board.hpp"
#include "control/fixed.hpp"
#include "flight/observation.hpp"
#include "link/declaration.hpp"
#include "params/params.hpp"

namespace heli::flight {

// Derived from the parameters in the idle loop.
struct Limits {
  Quantity angle_max_rad[kAxisCount];
  Quantity below_table_rad;  // elevation beyond which the reading is wrong: the table is above
  std::uint32_t step_max_counts[kAxisCount] = {};  // in kTrackingSlots ticks
  Quantity rate_max_rad_s[kAxisCount];
  std::uint32_t encoder_illegal_max = 0;
  std::uint32_t overrun_max = 0;
  Quantity arm_rate_max_rad_s;
  Quantity arm_elevation_tolerance_rad;
  Quantity arm_pitch_tolerance_rad;
  Quantity rest_rad;
  std::uint32_t hold_ticks = 0;
  std::uint32_t land_ticks = 0;
  std::uint32_t landing_timeout_ticks = 0;
  std::uint32_t blind_landing_ticks = 0;  // without the elevation encoder
  std::uint32_t voltage_valid_max_ticks = 0;
  float excitation_max_V = 0.0F;
  float excitation_max_s = 0.0F;
  Quantity hover_motor_V;  // of one motor, in a hover
  float motor_min_V = 0.0F;
  float motor_max_V = 0.0F;
  bool params_consistent = false;
};

Limits limits_of(const params::Params& params);

// What the checks in flight compare with: the counters since power-up and the elevation, as they
// were at arming.
struct AtArming {
  std::uint32_t illegal[kAxisCount] = {};
  std::uint32_t overruns = 0;
  Quantity elevation_rad;
  Quantity floor_rad;       // elevation below which its reading or its sign is wrong
  bool lifted_off = false;  // elevation has risen since
};

struct Verdict {
  link::Fault fault;  // none: all is well
  float value;        // the offending quantity, in degrees, deg/s or a count
};

// Sets the floor of a flight that begins, or that has lifted off if elevation has risen.
void update_floor(AtArming& before, const Observation& observation, const Limits& limits);

// Returns the first limit that is exceeded by an axis of `trusted` (link::axes bits), whose reading
// no fault has shown to be wrong.
Verdict check_flight(const Observation& observation, const AtArming& before, const Limits& limits,
                     std::uint8_t trusted);

// The axis (link::axes bits) whose reading a fault has shown to be wrong, so that the arm can land
// without it; none if the fault concerns the whole arm.
constexpr std::uint8_t axis_lost_by(link::Fault fault) {
  switch (fault) {
    case link::Fault::elevation_limit:
    case link::Fault::elevation_rate:
    case link::Fault::encoder_elevation:
    case link::Fault::elevation_following:
    case link::Fault::elevation_motionless:
    case link::Fault::elevation_below_table:
    case link::Fault::elevation_step:
      return link::axes::elevation;
    case link::Fault::encoder_pitch:
    case link::Fault::pitch_motionless:
    case link::Fault::pitch_sign:
    case link::Fault::pitch_step:
      return link::axes::pitch;
    case link::Fault::encoder_travel:
    case link::Fault::travel_following:
    case link::Fault::travel_motionless:
    case link::Fault::travel_step:
    case link::Fault::travel_sign:
      return link::axes::travel;
    default:
      return 0;
  }
}

// Returns the first reason not to arm. `stepped_axes`: readings that have stepped since they were
// zeroed.
Verdict check_before_arming(const Observation& observation, const Limits& limits,
                            std::uint8_t stepped_axes);

}  // namespace heli::flight
