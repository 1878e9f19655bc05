// Checks of angles, rates, encoders and overruns in flight, and of the state before arming; see
// limits.hpp. The checks run in the tick, limits_of() in the idle loop.
#include "flight/limits.hpp"

#include <utility>

#include "control/math.hpp"
#include "flight/balance.hpp"

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
constexpr Fault kStepFault[kAxisCount] = {Fault::elevation_step, Fault::pitch_step,
                                          Fault::travel_step};
constexpr Fault kEncoderFault[kAxisCount] = {Fault::encoder_elevation, Fault::encoder_pitch,
                                             Fault::encoder_travel};

// An elevation this far below the tolerance of arming is not that of an arm on a soft table.
constexpr float kTable_deg = 1.0F;
// Until elevation has risen by this since arming, the board does not know that its sign is right.
constexpr Quantity kLiftOff_rad = Quantity::of(1.0F * kRadPerDeg);
// An arm that lies on its table sinks by less than this when the rotors start. With twice as much,
// a wrong sign raises the voltage beyond that of a hover before it is noticed.
constexpr Quantity kWrongWay_rad = Quantity::of(0.25F * kRadPerDeg);
// A reading may change by a tenth more than at the highest rate, because a tick may be late, and by
// an edge. With twice as much, steps of 2 degrees of pitch pass; with less, a fast motion is a
// step.
constexpr float kStepRates = 1.1F * static_cast<float>(kTrackingSlots);
constexpr std::uint32_t kStepEdges_counts = 1;

}  // namespace

Limits limits_of(const params::Params& params) {
  const auto rad = [&params](Param p) { return Quantity::of(params.get(p) * kRadPerDeg); };
  Limits limits{};
  limits.angle_max_rad[kElevation] = rad(Param::elevation_max_deg);
  limits.angle_max_rad[kPitch] = rad(Param::pitch_max_deg);
  limits.angle_max_rad[kTravel] = rad(Param::travel_max_deg);
  limits.rate_max_rad_s[kElevation] = rad(Param::elevation_rate_max_deg_s);
  limits.rate_max_rad_s[kPitch] = rad(Param::pitch_rate_max_deg_s);
  limits.rate_max_rad_s[kTravel] = rad(Param::travel_rate_max_deg_s);
  const std::pair<Param, Param> of_rate[kAxisCount] = {
      {Param::elevation_rate_max_deg_s, Param::elevation_counts_per_rev},
      {Param::pitch_rate_max_deg_s, Param::pitch_counts_per_rev},
      {Param::travel_rate_max_deg_s, Param::travel_counts_per_rev}};
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    const auto [rate, counts] = of_rate[axis];
    const float counts_per_tick = params.get(rate) * control::kTick_s *
                                  control::magnitude(params.get(counts)) * (1.0F / 360.0F);
    limits.step_max_counts[axis] =
        static_cast<std::uint32_t>(control::nearest(kStepRates * counts_per_tick)) +
        kStepEdges_counts;
  }
  limits.below_table_rad =
      Quantity::of((params.get(Param::elevation_rest_deg) -
                    params.get(Param::arm_elevation_tolerance_deg) - kTable_deg) *
                   kRadPerDeg);
  limits.encoder_illegal_max = static_cast<std::uint32_t>(params.get(Param::encoder_illegal_max));
  limits.overrun_max = static_cast<std::uint32_t>(params.get(Param::overrun_max));
  limits.arm_rate_max_rad_s = rad(Param::arm_rate_max_deg_s);
  limits.arm_elevation_tolerance_rad = rad(Param::arm_elevation_tolerance_deg);
  limits.arm_pitch_tolerance_rad = rad(Param::arm_pitch_tolerance_deg);
  limits.rest_rad = rad(Param::elevation_rest_deg);
  limits.hold_ticks = ticks_of(params.get(Param::setpoint_hold_s));
  limits.land_ticks = ticks_of(params.get(Param::setpoint_land_s));
  limits.landing_timeout_ticks = ticks_of(params.get(Param::landing_timeout_s));
  limits.blind_landing_ticks = ticks_of(1.5F * params.get(Param::landing_timeout_s));
  limits.voltage_valid_max_ticks =
      static_cast<std::uint32_t>(params.get(Param::voltage_valid_max_ms));
  limits.excitation_max_V = params.get(Param::excitation_max_V);
  limits.excitation_max_s = params.get(Param::excitation_max_s);
  limits.hover_motor_V =
      Quantity::of(0.5F * params.get(Param::hover_V) + params.get(Param::dead_zone_V));
  limits.motor_min_V = params.get(Param::motor_min_V);
  limits.motor_max_V = params.get(Param::motor_max_V);
  limits.params_consistent = params.consistent();
  return limits;
}

void update_floor(AtArming& before, const Observation& observation, const Limits& limits) {
  before.lifted_off = observation.angle_rad[kElevation] > before.elevation_rad + kLiftOff_rad;
  const Quantity lowest_rad =
      before.elevation_rad < limits.rest_rad ? before.elevation_rad : limits.rest_rad;
  before.floor_rad = before.lifted_off ? limits.below_table_rad : lowest_rad - kWrongWay_rad;
}

Verdict check_flight(const Observation& observation, const AtArming& before, const Limits& limits,
                     std::uint8_t trusted) {
  if (observation.hardware_stop) {
    return {Fault::hardware_stop, 0.0F};
  }
  // Checked first, because a wrong count exceeds the other limits too.
  if (observation.overload_edges > 0U) {
    return {Fault::encoder_overload, static_cast<float>(observation.overload_edges)};
  }
  const auto is_trusted = [trusted](std::size_t axis) { return (trusted & (1U << axis)) != 0U; };
  // A step exceeds the other limits too.
  if ((observation.steps & trusted) != 0U) {
    const std::size_t axis = observation.tick % kTrackingSlots;
    return {kStepFault[axis], static_cast<float>(observation.step_counts)};
  }
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    // The lower limit of elevation is the table; see update_floor().
    const Quantity angle_rad =
        axis == kElevation ? observation.angle_rad[axis] : magnitude(observation.angle_rad[axis]);
    if (angle_rad > limits.angle_max_rad[axis] && is_trusted(axis)) {
      return {kAngleFault[axis], deg(observation.angle_rad[axis])};
    }
    if (magnitude(observation.rate_rad_s[axis]) > limits.rate_max_rad_s[axis] && is_trusted(axis)) {
      return {kRateFault[axis], deg(observation.rate_rad_s[axis])};
    }
    const std::uint32_t illegal = observation.illegal[axis] - before.illegal[axis];
    if (illegal > limits.encoder_illegal_max && is_trusted(axis)) {
      return {kEncoderFault[axis], static_cast<float>(illegal)};
    }
  }
  const std::uint32_t overruns = observation.overruns - before.overruns;
  if (overruns > limits.overrun_max) {
    return {Fault::tick_overrun, static_cast<float>(overruns)};
  }
  return {Fault::none, 0.0F};
}

Verdict check_before_arming(const Observation& observation, const Limits& limits,
                            std::uint8_t stepped_axes) {
  if (observation.hardware_stop) {
    return {Fault::hardware_stop, 0.0F};
  }
  if (observation.overload_edges > 0U) {
    return {Fault::encoder_overload, static_cast<float>(observation.overload_edges)};
  }
  if (!observation.params_usable || !limits.params_consistent) {
    return {Fault::parameters_invalid, 0.0F};
  }
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    if ((stepped_axes & (1U << axis)) != 0U) {
      return {kStepFault[axis], deg(observation.angle_rad[axis])};
    }
  }
  if (observation.link_age_ticks > limits.hold_ticks) {
    return {Fault::link_not_alive,
            static_cast<float>(observation.link_age_ticks) * control::kTick_s};
  }
  for (const Quantity rate_rad_s : observation.rate_rad_s) {
    if (magnitude(rate_rad_s) > limits.arm_rate_max_rad_s) {
      return {Fault::moving, deg(rate_rad_s)};
    }
  }
  if (magnitude(observation.angle_rad[kElevation] - limits.rest_rad) >
      limits.arm_elevation_tolerance_rad) {
    return {Fault::not_at_rest, deg(observation.angle_rad[kElevation])};
  }
  if (magnitude(observation.angle_rad[kPitch]) > limits.arm_pitch_tolerance_rad) {
    return {Fault::pitch_not_level, deg(observation.angle_rad[kPitch])};
  }
  if (magnitude(observation.angle_rad[kTravel]) > limits.angle_max_rad[kTravel]) {
    return {Fault::travel_limit, deg(observation.angle_rad[kTravel])};
  }
  return {Fault::none, 0.0F};
}

}  // namespace heli::flight
