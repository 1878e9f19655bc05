// What the tick needs of the parameters, converted once for each change of one.
#pragma once

#include <cstdint>

#include "board.hpp"
#include "control/fixed.hpp"
#include "control/mixer.hpp"
#include "control/pid.hpp"
#include "params/params.hpp"

namespace heli::control {

struct Constants {
  PerCount rad_per_count[kAxisCount];
  std::int32_t count_sign[kAxisCount] = {};
  std::int32_t elevation_rest_counts = 0;
  Share smoothing[kAxisCount];

  PidGains elevation;
  PidGains pitch;
  PidGains travel;  // output is the pitch setpoint in rad
  Quantity hover_V;
  Gain hover_V_per_rad;
  Gain pitch_hold_V_per_rad;
  Share elevation_rate_ff;
  Share travel_rate_ff;
  Gain elevation_acceleration_ff;  // V per rad/s2
  Gain travel_acceleration_ff;     // rad per rad/s2
  Quantity pitch_setpoint_max_rad;
  Quantity pitch_step_max_rad;  // per tick
  Share bumpless_keep;          // of the jump left after one tick

  DeadZone dead_zone;
  MixerLimits mixer;
  Quantity motor_min_V;
  Quantity motor_max_V;
  Gain front_duty_per_V;  // signed
  Gain back_duty_per_V;
  Share front_V_per_duty;
  Share back_V_per_duty;
};

// Uses floats, divisions and exponentials: idle loop only.
Constants constants_of(const params::Params& params);

}  // namespace heli::control
