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
  std::uint32_t silence_updates = 0;  // without a count, while pitch counts; 0: it never asks
  Quantity tilt_rad;
  Quantity step_rad;      // of the tilt, per update
  Quantity steady_rad;    // of pitch: beyond, the loop itself tilts the arm
  Quantity most_rad;      // of pitch: beyond, there is no room for the tilt
  Quantity friction_rad;  // tilt that dry friction may hold
  Quantity moved_least;   // a tilt beyond that, integrated twice, that must show as counts
};

// The axis, since the last update.
struct Asked {
  bool held = false;       // by the cascade, in the air
  bool may_begin = false;  // a tilt, now
  bool doubted = false;    // for another reason than its silence
  bool moved = false;      // its encoder has counted
  bool stirred = false;    // pitch has counted: something disturbs the arm
  Quantity error_rad;
  Quantity pitch_rad;
  control::Share lift;  // that a tilt turns, of what carries the level arm
};

class Probe {
 public:
  // Forgets all that is known of the axis.
  void restart() { *this = Probe{}; }
  // Returns the event to report, if any.
  link::Probe update(const Asked& axis, const ProbeLimits& limits);
  // Whether it tilts the arm: then the pitch setpoint is pitch_rad(), not that of the travel loop.
  bool asks() const { return stage_ != Stage::listens; }
  Quantity pitch_rad() const { return balance_rad_ + tilt_rad_; }
  Quantity tilt_rad() const { return tilt_rad_; }
  // How far the arm must have turned, as `moved_least`. It may have rested near the end of what
  // friction holds to one side. Then the tilt to the other side has to move it, so the smaller
  // distance is returned.
  Quantity turned() const { return most_[0] < most_[1] ? most_[0] : most_[1]; }

 private:
  enum class Stage : std::uint8_t { listens, first, second };

  link::Probe listen(const Asked& axis, const ProbeLimits& limits);
  link::Probe tilt(const Asked& axis, const ProbeLimits& limits);
  link::Probe end(link::Probe answer);
  void integrate(std::size_t side, Quantity beyond);

  Stage stage_ = Stage::listens;
  std::uint8_t patience_ = 0;         // doublings of the silence that it accepts
  std::uint8_t side_ = 0;             // of the tilt: 0 is up
  std::uint32_t silent_updates_ = 0;  // without counts
  std::uint32_t still_updates_ = 0;   // since pitch counted
  std::uint32_t calm_updates_ = 0;    // since it last asked
  std::uint32_t tilted_updates_ = 0;  // to this side
  Quantity tilt_rad_;
  Quantity balance_rad_;  // pitch at which the axis was still
  Quantity rate_[2];      // to each side: what the tilt beyond friction makes of it
  Quantity turned_[2];
  Quantity most_[2];
};

}  // namespace heli::flight
