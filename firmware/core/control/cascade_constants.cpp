// Converts the cascade's parameters (V/deg, deg, 1/s) to constants per tick in rad and fixed point.
#include "control/cascade_constants.hpp"

#include "control/bumpless_transfer.hpp"
#include "control/math.hpp"

namespace heli::control {

namespace {

using link::Param;

// `ki` is per second. Units as in PidGains, with the loop's output.
PidGains gains_of(float kp, float ki, float kd, float integral_max) {
  return {Gain::of(kp), Share::of(ki * kTick_s), Gain::of(kd), Quantity::of(integral_max)};
}

}  // namespace

CascadeConstants cascade_constants_of(const params::Params& params) {
  CascadeConstants c{};
  const auto volts = [&params](Param p) { return Quantity::of(params.get(p)); };
  // The parameter is in V/deg (V per deg/s, V per deg/s2); the result is in V/rad.
  const auto volts_per_deg = [&params](Param p) { return params.get(p) * kDegPerRad; };
  c.elevation =
      gains_of(volts_per_deg(Param::elevation_kp), volts_per_deg(Param::elevation_ki),
               volts_per_deg(Param::elevation_kd), params.get(Param::elevation_integral_max_V));
  c.pitch = gains_of(volts_per_deg(Param::pitch_kp), volts_per_deg(Param::pitch_ki),
                     volts_per_deg(Param::pitch_kd), params.get(Param::pitch_integral_max_V));
  c.travel = gains_of(params.get(Param::travel_kp), params.get(Param::travel_ki),
                      params.get(Param::travel_kd),
                      params.get(Param::travel_integral_max_deg) * kRadPerDeg);
  c.hover_V = volts(Param::hover_V);
  c.hover_V_per_rad = Gain::of(volts_per_deg(Param::hover_slope));
  c.pitch_hold_V_per_rad = Gain::of(volts_per_deg(Param::pitch_hold_ff));
  c.elevation_rate_ff = Share::of(params.get(Param::elevation_rate_ff));
  c.travel_rate_ff = Share::of(params.get(Param::travel_rate_ff));
  c.elevation_acceleration_ff = Gain::of(volts_per_deg(Param::elevation_acceleration_ff));
  c.travel_acceleration_ff = Gain::of(params.get(Param::travel_acceleration_ff));
  c.pitch_setpoint_max_rad = Quantity::of(params.get(Param::pitch_setpoint_max_deg) * kRadPerDeg);
  c.pitch_step_max_rad = Quantity::of(params.get(Param::pitch_slew_deg_s) * kRadPerDeg * kTick_s);
  c.bumpless_keep = bumpless_keep_of(params);

  c.dead_zone = DeadZone::of(params.get(Param::dead_zone_V));
  c.motor_min_V = volts(Param::motor_min_V);
  c.motor_max_V = volts(Param::motor_max_V);
  c.mixer = MixerLimits::of(lift_from_motor_V(c.motor_min_V, c.dead_zone),
                            lift_from_motor_V(c.motor_max_V, c.dead_zone),
                            volts(Param::differential_max_V));
  return c;
}

}  // namespace heli::control
