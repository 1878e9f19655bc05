// What the tick needs of the parameters, converted once for each change of one.
#pragma once

#include <cstdint>

#include "board.hpp"
#include "control/mixer.hpp"
#include "control/pid.hpp"
#include "params/params.hpp"

namespace heli::control {

struct Constants {
  float rad_per_count[kAxisCount];
  std::int32_t count_sign[kAxisCount];
  std::int32_t elevation_rest_counts;
  float smoothing[kAxisCount];

  PidGains elevation;
  PidGains pitch;
  PidGains travel;  // output is the pitch setpoint in rad
  float hover_V;
  float hover_V_per_rad;
  float elevation_rate_ff;
  float travel_rate_ff;
  float elevation_acceleration_ff;  // V per rad/s2
  float travel_acceleration_ff;     // rad per rad/s2
  float pitch_setpoint_max_rad;
  float pitch_step_max_rad;  // per tick
  float bumpless_keep;       // share of the jump left after one tick

  float dead_zone_V;
  MixerLimits mixer;
  float motor_min_V;
  float motor_max_V;
  float front_duty_per_V;  // signed
  float back_duty_per_V;
  float front_V_per_duty;
  float back_V_per_duty;
};

// Uses divisions and exponentials: idle loop only.
Constants constants_of(const params::Params& params);

}  // namespace heli::control
