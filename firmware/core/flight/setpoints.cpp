#include "flight/setpoints.hpp"

#include "control/math.hpp"

namespace heli::flight {

using control::clamp;
using control::kRadPerDeg;
using control::kTick_s;
using control::kTickRate_Hz;
using control::magnitude;
using link::Param;

namespace {

// Room between the highest setpoint and the trip limit, for overshoot.
constexpr float kElevationMargin_rad = 2.0F * kRadPerDeg;
constexpr float kTravelMargin_rad = 5.0F * kRadPerDeg;
// The rest angle is only known to a count or so; a setpoint just below it is harmless.
constexpr float kRestMargin_rad = 1.0F * kRadPerDeg;

// Near the path the setpoint closes in exponentially, this share of the distance a tick (10/s).
constexpr float kCloseIn = 0.01F;
constexpr float kPerCloseInSquared = 1.0F / (kCloseIn * kCloseIn);

// The host sends the path in 20 ms pieces; their corners are smoothed over five of them before
// the control law sees an acceleration.
constexpr float kSmoothing = 0.01F;

// Fastest approach to a point this far away that can still brake in time.
float approach(float distance_rad, float change_max_rad) {
  const float away_rad = magnitude(distance_rad);
  const float exponential_rad = change_max_rad * kPerCloseInSquared;
  if (away_rad <= exponential_rad) {
    return distance_rad * kCloseIn;
  }
  const float step_rad =
      control::square_root(2.0F * change_max_rad * (away_rad - 0.5F * exponential_rad));
  return distance_rad < 0.0F ? -step_rad : step_rad;
}

}  // namespace

SetpointLimits setpoint_limits_of(const params::Params& params) {
  const auto rad = [&params](Param p) { return params.get(p) * kRadPerDeg; };
  const float travel_rad = rad(Param::travel_max_deg) - kTravelMargin_rad;
  const float pitch_rad = rad(Param::pitch_setpoint_max_deg);
  SetpointLimits limits{};
  limits.step_max_rad[kElevation] = rad(Param::elevation_slew_deg_s) * kTick_s;
  limits.step_max_rad[kPitch] = rad(Param::pitch_slew_deg_s) * kTick_s;
  limits.step_max_rad[kTravel] = rad(Param::travel_slew_deg_s) * kTick_s;
  limits.change_max_rad[kElevation] = rad(Param::elevation_acceleration_deg_s2) * kTick_s * kTick_s;
  limits.change_max_rad[kTravel] = rad(Param::travel_acceleration_deg_s2) * kTick_s * kTick_s;
  limits.least_rad[kElevation] = rad(Param::elevation_rest_deg) - kRestMargin_rad;
  limits.most_rad[kElevation] = rad(Param::elevation_max_deg) - kElevationMargin_rad;
  limits.least_rad[kPitch] = -pitch_rad;
  limits.most_rad[kPitch] = pitch_rad;
  limits.least_rad[kTravel] = -travel_rad;
  limits.most_rad[kTravel] = travel_rad;
  limits.landing_step_rad = rad(Param::landing_rate_deg_s) * kTick_s;
  return limits;
}

void Setpoints::start_at(const float (&angle_rad)[kAxisCount]) {
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    hold_at(axis, angle_rad[axis]);
  }
}

void Setpoints::hold_at(std::size_t axis, float angle_rad) {
  axes_[axis] = Axis{};
  axes_[axis].path_rad = angle_rad;
  axes_[axis].target_rad = angle_rad;
  axes_[axis].angle_rad = angle_rad;
}

Setpoint Setpoints::of(std::size_t axis) const {
  const Axis& a = axes_[axis];
  return {a.angle_rad, a.step_rad * kTickRate_Hz,
          a.smooth_change_rad * (kTickRate_Hz * kTickRate_Hz)};
}

bool Setpoints::aim(const float (&target_rad)[kAxisCount], std::uint32_t apply_tick,
                    std::uint32_t now_tick, const SetpointLimits& limits) {
  const auto ahead = static_cast<std::int32_t>(apply_tick - now_tick);
  if (ahead > static_cast<std::int32_t>(kMaxAhead_ticks)) {
    return false;
  }
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    if (!(target_rad[axis] >= limits.least_rad[axis] &&
          target_rad[axis] <= limits.most_rad[axis])) {
      return false;
    }
  }
  ramp_ticks_ = ahead > 0 ? static_cast<std::uint32_t>(ahead) : 0U;
  const float per_tick =
      ramp_ticks_ > 0U ? control::reciprocal(static_cast<float>(ramp_ticks_)) : 0.0F;
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    axes_[axis].target_rad = target_rad[axis];
    axes_[axis].slope_rad = (target_rad[axis] - axes_[axis].path_rad) * per_tick;
  }
  return true;
}

void Setpoints::follow(Axis& axis, float step_max_rad, float change_max_rad) {
  const float slope_rad = clamp(axis.slope_rad, -step_max_rad, step_max_rad);
  const float wanted_rad =
      clamp(slope_rad + approach(axis.path_rad - axis.angle_rad, change_max_rad), -step_max_rad,
            step_max_rad);
  const float change_rad = clamp(wanted_rad - axis.step_rad, -change_max_rad, change_max_rad);
  axis.step_rad += change_rad;
  axis.angle_rad += axis.step_rad;
  axis.smooth_change_rad += kSmoothing * (change_rad - axis.smooth_change_rad);
}

void Setpoints::advance(const SetpointLimits& limits) {
  if (ramp_ticks_ > 0U) {
    --ramp_ticks_;
  }
  for (std::size_t i = 0; i < kAxisCount; ++i) {
    Axis& axis = axes_[i];
    if (ramp_ticks_ > 0U) {
      axis.path_rad += axis.slope_rad;
    } else {
      axis.path_rad = axis.target_rad;
      axis.slope_rad = 0.0F;
    }
    if (i == kPitch) {
      const float step_max_rad = limits.step_max_rad[i];
      axis.angle_rad += clamp(axis.path_rad - axis.angle_rad, -step_max_rad, step_max_rad);
    } else {
      follow(axis, limits.step_max_rad[i], limits.change_max_rad[i]);
    }
  }
}

void Setpoints::descend(const SetpointLimits& limits, float floor_rad) {
  Axis& axis = axes_[kElevation];
  axis.target_rad = floor_rad;
  axis.path_rad = floor_rad;
  axis.slope_rad = 0.0F;
  follow(axis, limits.landing_step_rad, limits.change_max_rad[kElevation]);
}

}  // namespace heli::flight
