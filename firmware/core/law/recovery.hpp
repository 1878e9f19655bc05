// After an uploaded law's flight, the compiled controller first brings the arm to rest, then flies
// on. All of it runs in the tick, except recovery_limits_of().
//
// By then the arm may be far from its setpoint. The cascade overshoots such a step by a quarter:
// from 16 degrees on it would reach the upper limit. So an axis that is far from its setpoint gets
// a new one where the arm is, until the arm is at rest. From there the supervisor's setpoint moves
// on to the host's target at its usual rates. If travel has to return, elevation waits where the
// rotors have enough lift to tilt. Lower, the tilt itself lifts the arm: by 15 degrees at an
// elevation of -24 degrees, and further with slow rotors.
#pragma once

#include <cstdint>

#include "board.hpp"
#include "control/controller.hpp"
#include "control/fixed.hpp"
#include "params/params.hpp"

namespace heli::law {

using control::Quantity;

// Derived from the parameters in the idle loop.
struct RecoveryLimits {
  Quantity elevation_min_rad;
  Quantity elevation_max_rad;
  Quantity tilting_min_rad;  // lowest elevation at which the rotors may tilt
};

RecoveryLimits recovery_limits_of(const params::Params& params);

class Recovery {
 public:
  // A law's flight has ended; the next update() begins the recovery.
  void start() {
    active_ = true;
    begun_ = false;
  }
  void stop() { active_ = false; }
  bool active() const { return active_; }

  // Replaces the setpoints in `in` by setpoints that the arm can reach. `lift_V` and `tilt_V` are
  // the rotors' collective and differential voltage in excess of what carries the arm. Inactive
  // from the first tick on if the arm is at rest near its setpoints and the rotors carry it.
  void update(control::ControlInput& in, Quantity lift_V, Quantity tilt_V,
              const RecoveryLimits& limits);
  // True in the first tick of the recovery.
  bool begins() const { return active_ && ticks_ == 1U; }
  // Whether the arm is at rest while elevation waits for travel.
  bool returning() const { return returning_; }
  // Whether it has replaced the supervisor's setpoint of an axis, and by what.
  bool overrides(std::size_t axis) const { return overrides_[axis]; }
  Quantity setpoint_rad(std::size_t axis) const { return setpoint_rad_[axis]; }

 private:
  // One tick of each phase; false when the phase has ended.
  bool stop_arm(control::ControlInput& in, const RecoveryLimits& limits);
  bool return_travel(control::ControlInput& in, const RecoveryLimits& limits);
  void override_setpoint(control::ControlInput& in, std::size_t axis, Quantity setpoint_rad);
  bool at_rest_long_enough(bool at_rest_now);

  bool active_ = false;      // from start() until both phases have ended
  bool begun_ = false;       // the first update() has taken place
  bool returning_ = false;   // the second phase
  std::uint32_t ticks_ = 0;  // since the first update(), in both phases
  std::uint32_t rest_ticks_ = 0;
  bool overrides_[kAxisCount] = {};
  Quantity setpoint_rad_[kAxisCount];
};

}  // namespace heli::law
