// The helicopter's wiring table: encoders, drivers and stop input on the pins of an emulated Due.
#pragma once

#include "board/due.hpp"
#include "link/declaration.hpp"

namespace heli_sim {

inline constexpr int kEncoders = static_cast<int>(heli::link::kAxisCount);
inline constexpr int kMotors = 2;

// Attaches one encoder for each axis, numbered as the axes, the drivers' pull-downs and a closed
// stop switch. Once for each board.
void wire(due_emulator::Due& due);

// Signed duty of a motor's bridge, and whether both of its enables are high. Motor 0 is the front.
double motor_duty(const due_emulator::Due& due, int motor);
bool motor_enabled(const due_emulator::Due& due, int motor);

// The stop input is on a normally closed switch to ground. Pressed, or with a cut wire, it is open
// and the chip's pull-up makes it high, which stops.
void set_stop(due_emulator::Due& due, bool pressed);

}  // namespace heli_sim
