// Written by firmware/generate.py from firmware/pins.toml. Do not edit.
// What can be wired in more than one way; pins.hpp has what the chip fixes.
#pragma once

#include <cstddef>
#include <cstdint>

#include "board.hpp"
#include "pins.hpp"

namespace heli::due::wiring {

inline constexpr std::size_t kTc0Axis = kElevation;
inline constexpr std::size_t kTc2Axis = kPitch;
inline constexpr std::size_t kInterruptAxis = kTravel;

inline constexpr Pin kFrontForward{PIOC, 21};        // D9, RPWM
inline constexpr Pin kFrontReverse{PIOC, 22};        // D8, LPWM
inline constexpr Pin kFrontForwardEnable{PIOB, 26};  // D22, R_EN
inline constexpr Pin kFrontReverseEnable{PIOA, 14};  // D23, L_EN
inline constexpr unsigned kFrontForwardChannel = 4;
inline constexpr unsigned kFrontReverseChannel = 5;

inline constexpr Pin kBackForward{PIOC, 23};        // D7, RPWM
inline constexpr Pin kBackReverse{PIOC, 24};        // D6, LPWM
inline constexpr Pin kBackForwardEnable{PIOA, 15};  // D24, R_EN
inline constexpr Pin kBackReverseEnable{PIOD, 3};   // D28, L_EN
inline constexpr unsigned kBackForwardChannel = 6;
inline constexpr unsigned kBackReverseChannel = 7;

inline constexpr std::uint32_t kPwm_Hz = 20000;
inline constexpr bool kPwmInverted = false;
inline constexpr bool kEnableInverted = false;
inline constexpr bool kStopIsHigh = true;

}  // namespace heli::due::wiring
