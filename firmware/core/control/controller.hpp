// The seam of the control law. Whatever stands behind it gets the measured state and the setpoints
// and gives two motor voltages; core, supervisor, link and telemetry know no more of it than this.
#pragma once

#include <cstddef>
#include <cstdint>

#include "board.hpp"
#include "control/fixed.hpp"
#include "params/params.hpp"

namespace heli::control {

struct ControlInput {
  Quantity angle_rad[kAxisCount];
  Quantity rate_rad_s[kAxisCount];
  Quantity setpoint_rad[kAxisCount];  // pitch counts only while travel is open or waits
  Quantity setpoint_rate_rad_s[kAxisCount];
  Quantity setpoint_acceleration_rad_s2[kAxisCount];
  std::uint8_t axes = 0;  // link::axes bits of the closed loops
  Quantity open_front_V;  // motor volts for what is not closed
  Quantity open_back_V;
  Quantity excitation_front_V;  // added to the motors
  Quantity excitation_back_V;
  bool travel_waits = false;  // travel stays closed, but pitch goes to its own setpoint for now
};

struct ControlOutput {
  Quantity front_V;  // motor volts; the core holds them to the motors' limits
  Quantity back_V;
  Quantity pitch_setpoint_rad;  // the one that was used
  bool front_saturated = false;
  bool back_saturated = false;
  bool pitch_limited = false;
};

// What is derived from the parameters exists twice: ticks read one bank while the idle loop fills
// the other, and the core switches all of it with one byte.
using Bank = std::uint8_t;
inline constexpr std::size_t kBanks = 2;

class Controller {
 public:
  // The idle loop's function comes first: firmware/due/report.py tells virtual calls apart by
  // their place in the table, and the tick must not be able to reach this one.

  // Puts what update() needs of the parameters into `bank`, which no tick reads meanwhile. May
  // divide and take its time. update() is given no bank that has not been filled.
  virtual void derive(const params::Params& params, Bank bank) = 0;

  // In each tick without a law's voltages on the motors: the next update() starts again.
  virtual void reset() = 0;
  // In each other tick, once.
  virtual ControlOutput update(const ControlInput& in, Bank bank) = 0;

 protected:
  ~Controller() = default;
};

}  // namespace heli::control
