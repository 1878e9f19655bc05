// Two motor drivers of two half bridges each: PWM on four pins, enables on four more.
#pragma once

#include <cstdint>
#include <wiring.hpp>

#include "board.hpp"
#include "drivers.hpp"

namespace heli::due::motors {

// Steps of full duty: half a PWM period in master clocks, because a centre-aligned counter runs up
// and down.
inline constexpr std::int16_t kDutyFull = clock::kMck_Hz / (2 * wiring::kPwm_Hz);

// Before anything else after a reset: enables low, PWM pins low.
void hold_off();

// PWM at duty zero with the outputs forced low; the enables stay low.
void start();

// Control tick.
void write(const MotorCommand& command);

// Control tick. True while the hardware stop forces the outputs low. It stays so until the input is
// released and the motors have been commanded off.
bool hardware_stop();

// Any context, at any moment after a reset, even before start(): switches the bridges off.
void cut();

}  // namespace heli::due::motors
