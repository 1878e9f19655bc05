// Setpoints: the path that the host requests, and the setpoint that the control law follows.
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

// Angle per tick: up to 1,790 degrees a second, to 1e-11 rad. An acceleration of 1 deg/s2 is 1,200
// of these a tick.
using Step = control::Fixed<36>;
// Smoothed change of a step: with finer resolution, so that it decays to zero.
using Change = control::Fixed<44>;

// A sum of steps, or a distance that is too long for one step.
class Place {
 public:
  constexpr Place() = default;
  static constexpr Place at(Quantity angle_rad) {
    Place place;
    place.raw_ = angle_rad.raw() * (std::int64_t{1} << kFiner);
    return place;
  }
  static constexpr Place part_of(Quantity way_rad, control::Share part) {
    const std::int64_t exact = control::exact_product(way_rad, part);
    Place place;
    place.raw_ = (exact + (std::int64_t{1} << (30 - kFiner - 1))) >> (30 - kFiner);
    return place;
  }
  constexpr void add(Step step_rad) { raw_ += step_rad.raw(); }
  constexpr void add(Place way) { raw_ += way.raw_; }
  constexpr Quantity angle_rad() const {
    return Quantity::from_raw(
        control::saturated((raw_ + (std::int64_t{1} << (kFiner - 1))) >> kFiner));
  }
  // Returns the distance to `goal`, limited to the range of a step.
  constexpr Step towards(Place goal) const {
    return Step::from_raw(control::saturated(goal.raw_ - raw_));
  }
  // Returns the distance to `goal`, limited to half a radian, which exceeds the range of a step.
  constexpr control::Fixed<32> little_rad(Place goal) const {
    return control::Fixed<32>::from_raw(control::saturated((goal.raw_ - raw_) >> 4));
  }
  // Returns the whole distance to `goal`, with less resolution.
  constexpr Quantity distance_rad(Place goal) const {
    return Quantity::from_raw(control::saturated((goal.raw_ - raw_) >> kFiner));
  }

 private:
  static constexpr int kFiner = 36 - 24;

  std::int64_t raw_ = 0;  // as a Step's
};

// Derived from the parameters in the idle loop.
struct SetpointLimits {
  Step step_max_rad[kAxisCount];    // slew, per tick
  Step change_max_rad[kAxisCount];  // of the step from one tick to the next
  Quantity near_rad[kAxisCount];    // closer than this the setpoint closes in exponentially
  Quantity min_rad[kAxisCount];
  Quantity max_rad[kAxisCount];
  Step landing_step_rad;  // per tick
};

SetpointLimits setpoint_limits_of(const params::Params& params);

// The path of an axis is piecewise linear: each target is reached at its device tick. The setpoint
// follows the path exactly while it is slow and smooth enough, and otherwise as fast as slew and
// acceleration allow, without overshooting it: a step comes out as a ramp with gentle ends.
class Setpoints {
 public:
  // Farthest time that a target may lie ahead.
  static constexpr std::uint32_t kMaxAhead_ticks = 500;

  void start_at(const Quantity (&angle_rad)[kAxisCount]);
  void hold_at(std::size_t axis, Quantity angle_rad);
  // Starts again at rest from another angle, towards the same target.
  void continue_from(std::size_t axis, Quantity angle_rad);

  // False when a target lies outside the bounds or too far ahead; then nothing changes.
  bool aim(const Quantity (&target_rad)[kAxisCount], std::uint32_t apply_tick,
           std::uint32_t now_tick, const SetpointLimits& limits);

  void advance(const SetpointLimits& limits);
  // One tick of descent, below the bounds, towards `floor_rad`; the other axes stay.
  void descend(const SetpointLimits& limits, Quantity floor_rad);

  Setpoint of(std::size_t axis) const;
  Quantity angle_rad(std::size_t axis) const { return axes_[axis].place.angle_rad(); }

 private:
  struct Axis {
    Place path;
    Place slope;  // of the path, per tick
    Place target;
    Place place;    // of the setpoint
    Step step_rad;  // its last change
    Change smooth_change_rad;
  };

  static void follow(Axis& axis, Step step_max_rad, Step change_max_rad, Quantity near_rad);

  Axis axes_[kAxisCount];
  std::uint32_t ramp_ticks_ = 0;
};

}  // namespace heli::flight
