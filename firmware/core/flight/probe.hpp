// Tests by a tilt whether the encoder of an axis still counts after a long silence.
//
// An encoder that dies while travel is calm reads like an arm that dry friction holds. No
// observation distinguishes them, so the board tilts the arm to one side and then to the other, by
// more than dry friction can hold. Counts end it. Without counts, the measured tilt shows how far
// the arm must have turned. Tilts to both sides leave little speed behind.
#pragma once

#include <cstddef>
#include <cstdint>

#include "control/fixed.hpp"
#include "link/declaration.hpp"

namespace heli::flight {

using control::Quantity;

struct ProbeLimits {
  // An update takes place every 4 ms. Angles are pitch.
  std::uint32_t silence_updates = 0;  // without a count, while pitch counts; 0: no probes
  Quantity tilt_rad;                  // size of the probing tilt
  Quantity step_rad;                  // of the tilt, per update
  Quantity steady_rad;                // of pitch: beyond, the loop itself tilts the arm
  Quantity pitch_max_rad;             // of pitch: beyond, there is no room for the tilt
  Quantity friction_rad;              // tilt that dry friction may hold
  Quantity expected_travel_min;  // a tilt beyond that, integrated twice, that must show as counts
};

// What happened to the axis since the last update.
struct ProbeInput {
  bool is_held = false;      // the cascade controls travel, and the arm is in the air
  bool may_begin = false;    // the arm is high enough to begin a tilt
  bool suspected = false;    // Tracking::check() suspects the encoder
  bool moved = false;        // travel's encoder has counted
  bool pitch_moved = false;  // pitch has moved by kStirringPitch_rad: something disturbs the arm
  Quantity error_rad;        // setpoint of travel minus its angle
  Quantity pitch_rad;
  control::Share lift;  // of the rotors at this elevation; 1 carries the level arm
};

class Probe {
 public:
  // Forgets all that is known of the axis.
  void restart() { *this = Probe{}; }
  // Returns the event to report, if any.
  link::Probe update(const ProbeInput& axis, const ProbeLimits& limits);
  // Whether it tilts the arm: then the pitch setpoint is pitch_rad(), not that of the travel loop.
  bool is_tilting() const { return stage_ != Stage::waits; }
  Quantity pitch_rad() const { return balance_rad_ + tilt_rad_; }
  Quantity tilt_rad() const { return tilt_rad_; }
  // How far the arm must have turned, as `expected_travel_min`. It may have rested near the end of
  // what friction holds to one side. Then the tilt to the other side has to move it, so the smaller
  // distance is returned.
  Quantity expected_travel() const {
    return expected_travel_max_[0] < expected_travel_max_[1] ? expected_travel_max_[0]
                                                             : expected_travel_max_[1];
  }

 private:
  enum class Stage : std::uint8_t { waits, first, second };

  link::Probe wait_for_silence(const ProbeInput& axis, const ProbeLimits& limits);
  link::Probe tilt(const ProbeInput& axis, const ProbeLimits& limits);
  link::Probe end(link::Probe answer);
  void integrate_motion(std::size_t side, Quantity excess_rad);

  Stage stage_ = Stage::waits;
  std::uint8_t silence_doublings_ = 0;     // the accepted silence doubles this often
  std::uint8_t side_ = 0;                  // of the present tilt: 0 is positive pitch
  std::uint32_t silent_updates_ = 0;       // without counts
  std::uint32_t pitch_still_updates_ = 0;  // since pitch counted
  std::uint32_t since_probe_updates_ = 0;  // since the last probe ended
  std::uint32_t tilt_updates_ = 0;         // to this side
  Quantity tilt_rad_;
  Quantity balance_rad_;         // pitch at which the axis was still
  Quantity expected_rate_[2];    // to each side: tilt beyond friction, integrated once
  Quantity expected_travel_[2];  // integrated twice
  Quantity expected_travel_max_[2];
};

}  // namespace heli::flight
