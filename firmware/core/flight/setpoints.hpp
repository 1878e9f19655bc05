// Setpoints: targets with a device tick at which they are to be reached, slew limits, bounds.
#pragma once

#include <cstdint>

#include "board.hpp"
#include "control/math.hpp"
#include "params/params.hpp"

namespace heli::flight {

// From the parameters, in the idle loop.
struct SetpointLimits {
  float step_max_rad[kAxisCount];  // slew, per tick
  float least_rad[kAxisCount];
  float most_rad[kAxisCount];
  float landing_step_rad;  // per tick
};

SetpointLimits setpoint_limits_of(const params::Params& params);

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
  // One tick of descent below the bounds, towards `floor_rad`.
  void descend(const SetpointLimits& limits, float floor_rad);

  const float (&value_rad() const)[kAxisCount] { return value_rad_; }

 private:
  float value_rad_[kAxisCount] = {};
  float target_rad_[kAxisCount] = {};
  float slope_rad_[kAxisCount] = {};  // per tick, while ramping
  std::uint32_t ramp_ticks_ = 0;
};

}  // namespace heli::flight
