#include "control/constants.hpp"

#include <cmath>

namespace heli::control {

namespace {

using link::Param;

float smoothing_of(float cutoff_Hz) { return 1.0F - std::exp(-2.0F * kPi * cutoff_Hz * kTick_s); }

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
    c.rad_per_count[axis] = 2.0F * kPi / magnitude(per_rev);
    c.smoothing[axis] = smoothing_of(params.get(cutoffs[axis]));
  }
  c.elevation_rest_counts = round_to_int(params.get(Param::elevation_rest_deg) / 360.0F *
                                         magnitude(params.get(Param::elevation_counts_per_rev)));

  c.elevation = {params.get(Param::elevation_kp) * kDegPerRad,
                 params.get(Param::elevation_ki) * kDegPerRad * kTick_s,
                 params.get(Param::elevation_kd) * kDegPerRad,
                 params.get(Param::elevation_integral_max_V)};
  c.pitch = {params.get(Param::pitch_kp) * kDegPerRad,
             params.get(Param::pitch_ki) * kDegPerRad * kTick_s,
             params.get(Param::pitch_kd) * kDegPerRad, params.get(Param::pitch_integral_max_V)};
  c.travel = {params.get(Param::travel_kp), params.get(Param::travel_ki) * kTick_s,
              params.get(Param::travel_kd),
              params.get(Param::travel_integral_max_deg) * kRadPerDeg};
  c.hover_V = params.get(Param::hover_V);
  c.hover_V_per_rad = params.get(Param::hover_slope) * kDegPerRad;
  c.elevation_rate_ff = params.get(Param::elevation_rate_ff);
  c.travel_rate_ff = params.get(Param::travel_rate_ff);
  c.elevation_acceleration_ff = params.get(Param::elevation_acceleration_ff) * kDegPerRad;
  c.travel_acceleration_ff = params.get(Param::travel_acceleration_ff);
  c.pitch_setpoint_max_rad = params.get(Param::pitch_setpoint_max_deg) * kRadPerDeg;
  c.pitch_step_max_rad = params.get(Param::pitch_slew_deg_s) * kRadPerDeg * kTick_s;
  c.bumpless_keep = std::exp(-kTick_s / params.get(Param::bumpless_s));

  c.dead_zone_V = params.get(Param::dead_zone_V);
  c.motor_min_V = params.get(Param::motor_min_V);
  c.motor_max_V = params.get(Param::motor_max_V);
  c.mixer = {lift_from_motor_V(c.motor_min_V, c.dead_zone_V),
             lift_from_motor_V(c.motor_max_V, c.dead_zone_V),
             params.get(Param::differential_max_V)};
  const float supply_V = params.get(Param::supply_V);
  const float front_sign = params.get(Param::motor_front_sign);
  const float back_sign = params.get(Param::motor_back_sign);
  c.front_duty_per_V = front_sign * static_cast<float>(kDutyFull) / supply_V;
  c.back_duty_per_V = back_sign * static_cast<float>(kDutyFull) / supply_V;
  c.front_V_per_duty = 1.0F / c.front_duty_per_V;
  c.back_V_per_duty = 1.0F / c.back_duty_per_V;
  return c;
}

}  // namespace heli::control
