// After a law's flight: the board's own law first brings the arm to rest, then flies on.
//
// By then the setpoint that the other law was to follow may be far away. To the cascade that is a
// step, of which it overshoots a quarter: from 16 degrees on into the upper limit. So an axis
// that has left its setpoint gets one where the arm is, until the arm is at rest. From there the
// supervisor's setpoint goes on to the host's target, at the rates that any setpoint has. Where
// travel has to, elevation waits where the rotors have lift enough to tilt: lower, the tilt itself
// lifts the arm, by 15 degrees at -24, and further on slow rotors.
#pragma once

#include <cstdint>

#include "board.hpp"
#include "control/controller.hpp"
#include "control/fixed.hpp"
#include "params/params.hpp"

namespace heli::law {

using control::Quantity;

// From the parameters, in the idle loop.
struct RecoveryLimits {
  Quantity elevation_least_rad;
  Quantity elevation_most_rad;
  Quantity tilting_least_rad;  // elevation at which the rotors may still tilt
};

RecoveryLimits recovery_limits_of(const params::Params& params);

class Recovery {
 public:
  // A law's flight has ended; the next update() begins.
  void start() {
    active_ = true;
    begun_ = false;
  }
  void stop() { active_ = false; }
  bool active() const { return active_; }

  // Puts setpoints that the arm can reach into `in`. `lift_V` and `tilt_V` are what the rotors were
  // driven to beyond what carries the arm. Inactive from the first tick on where the arm is at rest
  // near its setpoints, and the rotors carry it.
  void update(control::ControlInput& in, Quantity lift_V, Quantity tilt_V,
              const RecoveryLimits& limits);
  // True in its first tick.
  bool begins() const { return active_ && ticks_ == 1U; }
  // Whether the arm is at rest, and elevation waits for travel.
  bool returns() const { return returns_; }
  // Whether it has replaced the supervisor's setpoint of an axis, and by which.
  bool moves(std::size_t axis) const { return moves_[axis]; }
  Quantity setpoint_rad(std::size_t axis) const { return setpoint_rad_[axis]; }

 private:
  // A tick of each part; false where it has ended.
  bool stop_arm(control::ControlInput& in, const RecoveryLimits& limits);
  bool return_travel(control::ControlInput& in, const RecoveryLimits& limits);
  void move(control::ControlInput& in, std::size_t axis, Quantity setpoint_rad);
  bool calm_for_long(bool calm);

  bool active_ = false;
  bool begun_ = false;
  bool returns_ = false;
  std::uint32_t ticks_ = 0;
  std::uint32_t calm_ticks_ = 0;
  bool moves_[kAxisCount] = {};
  Quantity setpoint_rad_[kAxisCount];
};

}  // namespace heli::law
