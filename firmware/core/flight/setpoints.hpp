// Setpoints: the path that the host asks for, and what of it the control law is asked to follow.
#pragma once

#include <cstddef>
#include <cstdint>

#include "board.hpp"
#include "params/params.hpp"

namespace heli::flight {

// Of one axis, as the control law gets it.
struct Setpoint {
  float angle_rad;
  float rate_rad_s;
  float acceleration_rad_s2;
};

// From the parameters, in the idle loop.
struct SetpointLimits {
  float step_max_rad[kAxisCount];    // slew, per tick
  float change_max_rad[kAxisCount];  // of the step from one tick to the next
  float least_rad[kAxisCount];
  float most_rad[kAxisCount];
  float landing_step_rad;  // per tick
};

SetpointLimits setpoint_limits_of(const params::Params& params);

// The path of an axis is piecewise linear: each target is reached at its device tick. The setpoint
// follows the path exactly while it is slow and smooth enough, and otherwise as fast as slew and
// acceleration allow, without overshooting it: a step comes out as a ramp with gentle ends.
class Setpoints {
 public:
  // Farthest a target may lie ahead; a link that delivers later than this is not in control.
  static constexpr std::uint32_t kMaxAhead_ticks = 500;

  void start_at(const float (&angle_rad)[kAxisCount]);
  void hold_at(std::size_t axis, float angle_rad);

  // False when a target lies outside the bounds or too far ahead; then nothing changes.
  bool aim(const float (&target_rad)[kAxisCount], std::uint32_t apply_tick, std::uint32_t now_tick,
           const SetpointLimits& limits);

  void advance(const SetpointLimits& limits);
  // One tick of descent, below the bounds, towards `floor_rad`; the other axes stay.
  void descend(const SetpointLimits& limits, float floor_rad);

  Setpoint of(std::size_t axis) const;

 private:
  struct Axis {
    float path_rad = 0.0F;
    float slope_rad = 0.0F;  // of the path, per tick
    float target_rad = 0.0F;
    float angle_rad = 0.0F;  // the setpoint
    float step_rad = 0.0F;   // its last change
    float smooth_change_rad = 0.0F;
  };

  static void follow(Axis& axis, float step_max_rad, float change_max_rad);

  Axis axes_[kAxisCount];
  std::uint32_t ramp_ticks_ = 0;
};

}  // namespace heli::flight
