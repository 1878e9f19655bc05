// The door to the control law. Whatever stands behind it gets the measured state and the setpoints
// and gives two motor voltages; supervisor, link and telemetry know no more of it than this.
#pragma once

#include <cstdint>

#include "board.hpp"
#include "control/constants.hpp"

namespace heli::control {

struct ControlInput {
  Quantity angle_rad[kAxisCount];
  Quantity rate_rad_s[kAxisCount];
  Quantity setpoint_rad[kAxisCount];  // pitch counts only while travel is not closed
  Quantity setpoint_rate_rad_s[kAxisCount];
  Quantity setpoint_acceleration_rad_s2[kAxisCount];
  std::uint8_t axes = 0;  // link::axes bits of the closed loops
  Quantity open_front_V;  // motor volts for what is not closed
  Quantity open_back_V;
  Quantity excitation_front_V;  // added to the motors
  Quantity excitation_back_V;
};

struct ControlOutput {
  Quantity front_V;  // motor volts, within the motor limits
  Quantity back_V;
  Quantity pitch_setpoint_rad;  // the one that was used
  bool front_saturated = false;
  bool back_saturated = false;
  bool pitch_limited = false;
};

}  // namespace heli::control
