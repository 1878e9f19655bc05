#include "flight/setpoints.hpp"

namespace heli::flight {

using control::clamp;
using control::kRadPerDeg;
using control::kTick_s;
using link::Param;

namespace {

// Room between the highest setpoint and the trip limit, for overshoot.
constexpr float kElevationMargin_rad = 2.0F * kRadPerDeg;
constexpr float kTravelMargin_rad = 5.0F * kRadPerDeg;
// The rest angle is only known to a count or so; a setpoint just below it is harmless.
constexpr float kRestMargin_rad = 1.0F * kRadPerDeg;

}  // namespace

SetpointLimits setpoint_limits_of(const params::Params& params) {
  const auto rad = [&params](Param p) { return params.get(p) * kRadPerDeg; };
  const float travel_rad = rad(Param::travel_max_deg) - kTravelMargin_rad;
  const float pitch_rad = rad(Param::pitch_setpoint_max_deg);
  SetpointLimits limits{};
  limits.step_max_rad[kElevation] = rad(Param::elevation_slew_deg_s) * kTick_s;
  limits.step_max_rad[kPitch] = rad(Param::pitch_slew_deg_s) * kTick_s;
  limits.step_max_rad[kTravel] = rad(Param::travel_slew_deg_s) * kTick_s;
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
  value_rad_[axis] = angle_rad;
  target_rad_[axis] = angle_rad;
  slope_rad_[axis] = 0.0F;
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
    target_rad_[axis] = target_rad[axis];
    slope_rad_[axis] = (target_rad[axis] - value_rad_[axis]) * per_tick;
  }
  return true;
}

void Setpoints::advance(const SetpointLimits& limits) {
  const bool ramping = ramp_ticks_ > 1U;
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    const float wanted_rad = ramping ? slope_rad_[axis] : target_rad_[axis] - value_rad_[axis];
    value_rad_[axis] +=
        clamp(wanted_rad, -limits.step_max_rad[axis], limits.step_max_rad[axis]);
  }
  if (ramp_ticks_ > 0U) {
    --ramp_ticks_;
  }
}

void Setpoints::descend(const SetpointLimits& limits, float floor_rad) {
  const float lower_rad = value_rad_[kElevation] - limits.landing_step_rad;
  hold_at(kElevation, lower_rad < floor_rad ? floor_rad : lower_rad);
}

}  // namespace heli::flight
