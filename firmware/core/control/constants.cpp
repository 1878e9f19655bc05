#include "control/constants.hpp"

#include "control/math.hpp"

namespace heli::control {

namespace {

using link::Param;

// 1 - exp(-x) by its series, for x up to 1.3. Every C library rounds its exp in its own way, and by
// that alone the emulated Due flew one count away from the same code on a PC.
float gone_after(float x) {
  float sum = 1.0F;
  for (int n = 14; n > 1; --n) {
    sum = 1.0F - x / static_cast<float>(n) * sum;
  }
  return x * sum;
}

float smoothing_of(float cutoff_Hz) { return gone_after(2.0F * kPi * cutoff_Hz * kTick_s); }

PidGains gains_of(float kp, float ki, float kd, float integral_max) {
  return {Gain::of(kp), Share::of(ki * kTick_s), Gain::of(kd), Quantity::of(integral_max)};
}

}  // namespace

Constants constants_of(const params::Params& params) {
  Constants c{};
  const Param counts[kAxisCount] = {Param::elevation_counts_per_rev, Param::pitch_counts_per_rev,
                                    Param::travel_counts_per_rev};
  const Param cutoffs[kAxisCount] = {Param::elevation_filter_Hz, Param::pitch_filter_Hz,
                                     Param::travel_filter_Hz};
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    const float per_rev = params.get(counts[axis]);
    c.count_sign[axis] = per_rev < 0.0F ? -1 : 1;
    c.rad_per_count[axis] = PerCount::of(2.0F * kPi / magnitude(per_rev));
    c.smoothing[axis] = Share::of(smoothing_of(params.get(cutoffs[axis])));
  }
  c.elevation_rest_counts = round_to_int(params.get(Param::elevation_rest_deg) / 360.0F *
                                         magnitude(params.get(Param::elevation_counts_per_rev)));

  const auto volts = [&params](Param p) { return Quantity::of(params.get(p)); };
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
  c.bumpless_keep = Share::of(1.0F - gone_after(kTick_s / params.get(Param::bumpless_s)));

  c.dead_zone = DeadZone::of(params.get(Param::dead_zone_V));
  c.motor_min_V = volts(Param::motor_min_V);
  c.motor_max_V = volts(Param::motor_max_V);
  c.mixer = MixerLimits::of(lift_from_motor_V(c.motor_min_V, c.dead_zone),
                            lift_from_motor_V(c.motor_max_V, c.dead_zone),
                            volts(Param::differential_max_V));
  const float V_per_duty = params.get(Param::supply_V) / static_cast<float>(kDutyFull);
  const float front_sign = params.get(Param::motor_front_sign);
  const float back_sign = params.get(Param::motor_back_sign);
  c.front_duty_per_V = Gain::of(front_sign / V_per_duty);
  c.back_duty_per_V = Gain::of(back_sign / V_per_duty);
  c.front_V_per_duty = Share::of(V_per_duty / front_sign);
  c.back_V_per_duty = Share::of(V_per_duty / back_sign);
  return c;
}

}  // namespace heli::control
