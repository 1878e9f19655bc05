// Constants of the cascade, derived from the parameters each time that one changes.
#pragma once

#include "control/fixed.hpp"
#include "control/mixer.hpp"
#include "control/pid.hpp"
#include "params/params.hpp"

namespace heli::control {

struct CascadeConstants {
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
};

// Uses floats, divisions and exponentials: idle loop only.
CascadeConstants cascade_constants_of(const params::Params& params);

}  // namespace heli::control
