// Setpoints: the path that the host requests, and the setpoint that the control law follows.
// Fixed-point numbers here: Quantity has 24 bits behind the point, Step 36, Change 44.
#pragma once

#include <cstddef>
#include <cstdint>

#include "board.hpp"
#include "control/fixed.hpp"
#include "params/params.hpp"

namespace heli::flight {

using control::Quantity;

// Setpoint of one axis, as the control law gets it.
struct Setpoint {
  Quantity angle_rad;
  Quantity rate_rad_s;
  Quantity acceleration_rad_s2;
};

// Angle per tick in rad: up to 1,790 degrees per second, with a resolution of 1e-11 rad. At 1
// deg/s2 it changes by 1,200 of these units per tick.
using Step = control::Fixed<36>;
// Smoothed change of a step: with finer resolution, so that it decays to zero.
using Change = control::Fixed<44>;

// An angle, or an angle per tick, in rad with the resolution of a Step in 64 bits: it neither
// rounds nor overflows when steps are added.
class FineAngle {
 public:
  constexpr FineAngle() = default;
  static constexpr FineAngle at(Quantity angle_rad) {
    FineAngle setpoint;
    setpoint.raw_ = angle_rad.raw() * (std::int64_t{1} << kExtraBits);
    return setpoint;
  }
  static constexpr FineAngle share_of(Quantity distance_rad, control::Share part) {
    const std::int64_t exact_54 = control::exact_product(distance_rad, part);
    FineAngle setpoint;
    setpoint.raw_ = (exact_54 + (std::int64_t{1} << (30 - kExtraBits - 1))) >> (30 - kExtraBits);
    return setpoint;
  }
  constexpr void add(Step step_rad) { raw_ += step_rad.raw(); }
  constexpr void add(FineAngle fine_angle) { raw_ += fine_angle.raw_; }
  constexpr Quantity angle_rad() const {
    return Quantity::from_raw(
        control::saturated((raw_ + (std::int64_t{1} << (kExtraBits - 1))) >> kExtraBits));
  }
  // Returns the distance to `goal`, limited to the range of a step.
  constexpr Step step_to(FineAngle goal) const {
    return Step::from_raw(control::saturated(goal.raw_ - raw_));
  }
  // Returns the distance to `goal`, limited to half a radian, which exceeds the range of a step.
  constexpr control::Fixed<32> near_distance_rad(FineAngle goal) const {
    return control::Fixed<32>::from_raw(control::saturated((goal.raw_ - raw_) >> 4));
  }
  // Returns the whole distance to `goal`, with less resolution.
  constexpr Quantity distance_rad(FineAngle goal) const {
    return Quantity::from_raw(control::saturated((goal.raw_ - raw_) >> kExtraBits));
  }

 private:
  static constexpr int kExtraBits = 36 - 24;  // of a Step compared with a Quantity

  std::int64_t raw_ = 0;  // as a Step's
};

// Derived from the parameters in the idle loop.
struct SetpointLimits {
  Step step_max_rad[kAxisCount];         // slew, per tick
  Step step_change_max_rad[kAxisCount];  // acceleration: change of the step from one tick to the
                                         // next
  Quantity close_in_rad[kAxisCount];     // closer than this the setpoint closes in exponentially
  Quantity min_rad[kAxisCount];
  Quantity max_rad[kAxisCount];
  Step landing_step_rad;  // per tick
};

SetpointLimits setpoint_limits_of(const params::Params& params);

// Called in the tick. The path of an axis is piecewise linear: each target is reached at its device
// tick. The setpoint follows the path exactly while it is slow and smooth enough, and otherwise as
// fast as slew and acceleration allow, without overshooting it: a step comes out as a ramp with
// gentle ends.
class Setpoints {
 public:
  // Farthest time that a target may lie ahead.
  static constexpr std::uint32_t kMaxAhead_ticks = 500;

  // All axes rest at these angles: path, target and setpoint.
  void start_at(const Quantity (&angle_rad)[kAxisCount]);
  void hold_at(std::size_t axis, Quantity angle_rad);
  // Starts again at rest from another angle, towards the same target.
  void continue_from(std::size_t axis, Quantity angle_rad);

  // False when a target lies outside the bounds or too far ahead; then nothing changes.
  bool aim(const Quantity (&target_rad)[kAxisCount], std::uint32_t apply_tick,
           std::uint32_t now_tick, const SetpointLimits& limits);

  // One tick along the path.
  void advance(const SetpointLimits& limits);
  // One tick of descent, below the bounds, towards `floor_rad`; the other axes stay.
  void descend(const SetpointLimits& limits, Quantity floor_rad);

  Setpoint of(std::size_t axis) const;
  Quantity angle_rad(std::size_t axis) const { return axes_[axis].setpoint.angle_rad(); }

 private:
  struct Axis {
    FineAngle path;
    FineAngle slope;  // of the path, per tick
    FineAngle target;
    FineAngle setpoint;  // of the setpoint
    Step step_rad;       // its last change
    Change smooth_change_rad;
  };

  static void follow(Axis& axis, Step step_max_rad, Step step_change_max_rad,
                     Quantity close_in_rad);

  Axis axes_[kAxisCount];
  std::uint32_t ramp_ticks_ = 0;
};

}  // namespace heli::flight
