// What is wired where. The numbers behind D are those printed on the Arduino Due.
#pragma once

#include <cstdint>

#include "registers.hpp"

namespace heli::due::pins {

struct Pin {
  At<Pio> port;
  unsigned number;
  constexpr std::uint32_t mask() const { return bit(number); }
};

inline constexpr Pin kElevationA{PIOB, 25};  // D2, TIOA0, peripheral B
inline constexpr Pin kElevationB{PIOB, 27};  // D13, TIOB0, peripheral B; carries the LED too
inline constexpr Pin kPitchA{PIOC, 25};      // D5, TIOA6, peripheral B
inline constexpr Pin kPitchB{PIOC, 26};  // D4, TIOB6, peripheral B; also on PA29: never drive it
inline constexpr Pin kTravelA{PIOD, 0};  // D25
inline constexpr Pin kTravelB{PIOD, 1};  // D26

inline constexpr Pin kFrontForward{PIOC, 21};  // D9, PWML4, peripheral B: RPWM of the front driver
inline constexpr Pin kFrontReverse{PIOC, 22};  // D8, PWML5, peripheral B: LPWM
inline constexpr Pin kBackForward{PIOC, 23};   // D7, PWML6, peripheral B: RPWM of the back driver
inline constexpr Pin kBackReverse{PIOC, 24};   // D6, PWML7, peripheral B: LPWM

inline constexpr Pin kFrontForwardEnable{PIOB, 26};  // D22: R_EN of the front driver
inline constexpr Pin kFrontReverseEnable{PIOA, 14};  // D23: L_EN
inline constexpr Pin kBackForwardEnable{PIOA, 15};   // D24: R_EN of the back driver
inline constexpr Pin kBackReverseEnable{PIOD, 3};    // D28: L_EN

inline constexpr Pin kHardwareStop{PIOD, 6};  // D29, PWMFI2, peripheral B

inline constexpr Pin kReceive{PIOA, 8};   // D0, URXD, peripheral A: from the ATmega16U2
inline constexpr Pin kTransmit{PIOA, 9};  // D1, UTXD, peripheral A

inline void clock_all_ports() {
  PMC->PMC_PCER0.write(bit(ID_PIOA) | bit(ID_PIOB) | bit(ID_PIOC) | bit(ID_PIOD));
}

// The pins of `mask` to peripheral A or B of their port.
inline void to_peripheral_a(At<Pio> port, std::uint32_t mask) {
  port->PIO_ABSR.write(port->PIO_ABSR.read() & ~mask);
  port->PIO_PDR.write(mask);
}
inline void to_peripheral_b(At<Pio> port, std::uint32_t mask) {
  port->PIO_ABSR.write(port->PIO_ABSR.read() | mask);
  port->PIO_PDR.write(mask);
}

}  // namespace heli::due::pins
