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
  std::uint32_t voltage_valid_max_ticks = 0;
  float excitation_max_V = 0.0F;
  float excitation_max_s = 0.0F;
  float motor_min_V = 0.0F;
  float motor_max_V = 0.0F;
  bool params_consistent = false;
};

Limits limits_of(const params::Params& params);

// Counters since power-up, as they stood at arming.
struct AtArming {
  std::uint32_t illegal[kAxisCount] = {};
  std::uint32_t overruns = 0;
};

struct Verdict {
  link::Fault fault;  // none: all is well
  float value;        // the offending quantity, in degrees, deg/s or a count
};

// Returns the first limit that is exceeded.
Verdict check_flight(const Observation& observation, const AtArming& before, const Limits& limits);

// Returns the first reason not to arm.
Verdict check_before_arming(const Observation& observation, const Limits& limits);

}  // namespace heli::flight
