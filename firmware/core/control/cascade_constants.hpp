// Constants of the cascade, derived from the parameters each time that one changes.
#pragma once

#include "control/fixed.hpp"
#include "control/mixer.hpp"
#include "control/pid.hpp"
#include "params/params.hpp"

namespace heli::control {

struct CascadeConstants {
  PidGains elevation;              // output: collective lift volts
  PidGains pitch;                  // output: differential lift volts
  PidGains travel;                 // output: pitch setpoint in rad
  Quantity hover_V;                // collective lift volts that carry the level arm
  Gain hover_V_per_rad;            // their change with elevation
  Gain pitch_hold_V_per_rad;       // differential lift volts that hold a pitch
  Share elevation_rate_ff;         // share of the setpoint's rate that the D term does not brake
  Share travel_rate_ff;            // likewise
  Gain elevation_acceleration_ff;  // V per rad/s2
  Gain travel_acceleration_ff;     // rad per rad/s2
  Quantity pitch_setpoint_max_rad;
  Quantity pitch_step_max_rad;  // per tick
  Share bumpless_keep;          // share of a jump that remains after one tick

  DeadZone dead_zone;
  MixerLimits mixer;
  Quantity motor_min_V;
  Quantity motor_max_V;
};

// Uses floats, divisions and exponentials: idle loop only.
CascadeConstants cascade_constants_of(const params::Params& params);

}  // namespace heli::control
