// The interface of a compiled controller: measured state and setpoints in, two motor voltages out.
// Core, supervisor, link and telemetry use a controller only through it.
#pragma once

#include <cstddef>
#include <cstdint>

#include "board.hpp"
#include "control/fixed.hpp"
#include "params/params.hpp"

namespace heli {
class Core;
}

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

// Constants derived from the parameters exist twice: ticks read one bank while the idle loop fills
// the other, and the core switches banks by writing one byte.
using Bank = std::uint8_t;
inline constexpr std::size_t kBanks = 2;

// Proof that the caller is the idle loop: only Core::poll() and start() make one. A function that
// takes it may be slow and divide. firmware/due/report.py relies on it: no virtual call of an
// interrupt reaches such a function.
class IdleLoop {
  friend class heli::Core;
  friend struct IdleLoopOfTests;
  explicit constexpr IdleLoop(std::nullptr_t) {}
};

class Controller {
 public:
  // Puts the constants that update() needs from the parameters into `bank`, which no tick reads
  // meanwhile. update() and shadow() get no bank that has not been filled.
  virtual void derive(IdleLoop, const params::Params& params, Bank bank) = 0;

  // Once in each tick without a control law's voltages on the motors: forgets the last flight.
  virtual void init() = 0;

  // Once in each tick in which this controller flies.
  virtual ControlOutput update(const ControlInput& in, Bank bank) = 0;

  // In place of update() in a tick in which an uploaded law's voltages `acting` drive the motors:
  // keeps the state such that the next update() continues from there.
  virtual void shadow(const ControlInput& in, Bank bank, const ControlOutput& acting) = 0;

  // After shadow() and before update(), if the arm has to be recovered from the uploaded law: the
  // next update() acts immediately, without a smooth transfer from that law's voltages.
  virtual void take_over() = 0;

 protected:
  ~Controller() = default;
};

}  // namespace heli::control
