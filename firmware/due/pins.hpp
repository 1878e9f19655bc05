// Pins that the chip fixes, and their ports. The numbers behind D are those printed on the Arduino
// Due. What can be wired in more than one way is in wiring.hpp.
#pragma once

#include <cstdint>

#include "registers.hpp"

namespace heli::due {

// A pin of the chip.
struct Pin {
  At<Pio> port;
  unsigned number;
  constexpr std::uint32_t mask() const { return bit(number); }
  // Its mask if it is on this port, otherwise none.
  constexpr std::uint32_t mask_on(At<Pio> other) const {
    return port.address == other.address ? mask() : 0U;
  }
};

}  // namespace heli::due

namespace heli::due::pins {

inline constexpr Pin kTc0A{PIOB, 25};       // D2, TIOA0, peripheral B
inline constexpr Pin kTc0B{PIOB, 27};       // D13, TIOB0, peripheral B; carries the LED too
inline constexpr Pin kTc2A{PIOC, 25};       // D5, TIOA6, peripheral B
inline constexpr Pin kTc2B{PIOC, 26};       // D4, TIOB6, peripheral B; also on PA29: never drive it
inline constexpr Pin kInterruptA{PIOD, 0};  // D25
inline constexpr Pin kInterruptB{PIOD, 1};  // D26

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
