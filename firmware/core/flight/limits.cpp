#include "flight/limits.hpp"

#include "control/math.hpp"

namespace heli::flight {

using control::kDegPerRad;
using control::kRadPerDeg;
using control::ticks_of;
using link::Fault;
using link::Param;

namespace {

float deg(Quantity rad) { return rad.to_float() * kDegPerRad; }

constexpr Fault kAngleFault[kAxisCount] = {Fault::elevation_limit, Fault::pitch_limit,
                                           Fault::travel_limit};
constexpr Fault kRateFault[kAxisCount] = {Fault::elevation_rate, Fault::pitch_rate,
                                          Fault::travel_rate};
constexpr Fault kEncoderFault[kAxisCount] = {Fault::encoder_elevation, Fault::encoder_pitch,
                                             Fault::encoder_travel};

}  // namespace

Limits limits_of(const params::Params& params) {
  const auto rad = [&params](Param p) { return Quantity::of(params.get(p) * kRadPerDeg); };
  Limits l{};
  l.angle_max_rad[kElevation] = rad(Param::elevation_max_deg);
  l.angle_max_rad[kPitch] = rad(Param::pitch_max_deg);
  l.angle_max_rad[kTravel] = rad(Param::travel_max_deg);
  l.rate_max_rad_s[kElevation] = rad(Param::elevation_rate_max_deg_s);
  l.rate_max_rad_s[kPitch] = rad(Param::pitch_rate_max_deg_s);
  l.rate_max_rad_s[kTravel] = rad(Param::travel_rate_max_deg_s);
  l.encoder_illegal_max = static_cast<std::uint32_t>(params.get(Param::encoder_illegal_max));
  l.overrun_max = static_cast<std::uint32_t>(params.get(Param::overrun_max));
  l.arm_rate_max_rad_s = rad(Param::arm_rate_max_deg_s);
  l.arm_elevation_tolerance_rad = rad(Param::arm_elevation_tolerance_deg);
  l.arm_pitch_tolerance_rad = rad(Param::arm_pitch_tolerance_deg);
  l.rest_rad = rad(Param::elevation_rest_deg);
  l.hold_ticks = ticks_of(params.get(Param::setpoint_hold_s));
  l.land_ticks = ticks_of(params.get(Param::setpoint_land_s));
  l.landing_timeout_ticks = ticks_of(params.get(Param::landing_timeout_s));
  l.voltage_valid_max_ticks = static_cast<std::uint32_t>(params.get(Param::voltage_valid_max_ms));
  l.excitation_max_V = params.get(Param::excitation_max_V);
  l.excitation_max_s = params.get(Param::excitation_max_s);
  l.motor_min_V = params.get(Param::motor_min_V);
  l.motor_max_V = params.get(Param::motor_max_V);
  l.params_consistent = params.consistent();
  return l;
}

Verdict check_flight(const Observation& s, const AtArming& before, const Limits& l) {
  if (s.hardware_stop) {
    return {Fault::hardware_stop, 0.0F};
  }
  // Checked first, because a wrong count exceeds the other limits too.
  if (s.overload_edges > 0U) {
    return {Fault::encoder_overload, static_cast<float>(s.overload_edges)};
  }
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    // Downwards the table is the elevation's limit.
    const Quantity angle_rad =
        axis == kElevation ? s.angle_rad[axis] : magnitude(s.angle_rad[axis]);
    if (angle_rad > l.angle_max_rad[axis]) {
      return {kAngleFault[axis], deg(s.angle_rad[axis])};
    }
    if (magnitude(s.rate_rad_s[axis]) > l.rate_max_rad_s[axis]) {
      return {kRateFault[axis], deg(s.rate_rad_s[axis])};
    }
    const std::uint32_t illegal = s.illegal[axis] - before.illegal[axis];
    if (illegal > l.encoder_illegal_max) {
      return {kEncoderFault[axis], static_cast<float>(illegal)};
    }
  }
  const std::uint32_t overruns = s.overruns - before.overruns;
  if (overruns > l.overrun_max) {
    return {Fault::tick_overrun, static_cast<float>(overruns)};
  }
  return {Fault::none, 0.0F};
}

Verdict check_before_arming(const Observation& s, const Limits& l) {
  if (s.hardware_stop) {
    return {Fault::hardware_stop, 0.0F};
  }
  if (s.overload_edges > 0U) {
    return {Fault::encoder_overload, static_cast<float>(s.overload_edges)};
  }
  if (!s.params_usable || !l.params_consistent) {
    return {Fault::parameters_invalid, 0.0F};
  }
  if (s.link_age_ticks > l.hold_ticks) {
    return {Fault::link_not_alive, static_cast<float>(s.link_age_ticks) * control::kTick_s};
  }
  for (const Quantity rate_rad_s : s.rate_rad_s) {
    if (magnitude(rate_rad_s) > l.arm_rate_max_rad_s) {
      return {Fault::moving, deg(rate_rad_s)};
    }
  }
  if (magnitude(s.angle_rad[kElevation] - l.rest_rad) > l.arm_elevation_tolerance_rad) {
    return {Fault::not_at_rest, deg(s.angle_rad[kElevation])};
  }
  if (magnitude(s.angle_rad[kPitch]) > l.arm_pitch_tolerance_rad) {
    return {Fault::pitch_not_level, deg(s.angle_rad[kPitch])};
  }
  if (magnitude(s.angle_rad[kTravel]) > l.angle_max_rad[kTravel]) {
    return {Fault::travel_limit, deg(s.angle_rad[kTravel])};
  }
  return {Fault::none, 0.0F};
}

}  // namespace heli::flight
