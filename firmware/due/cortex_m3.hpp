// Registers and instructions of the processor itself, named as in ARM's manual (ARMv7-M).
#pragma once

#include <cstdint>

#include "registers.hpp"

namespace heli::due {

struct Nvic {
  ReadWrite NVIC_ISER[8];
  Reserved<184> reserved_120;
  ReadWrite NVIC_IPR[60];
};
inline constexpr At<Nvic> NVIC{0xE000E100};

struct Scb {
  Reserved<2> reserved_d00;
  ReadWrite VTOR;
  Reserved<2> reserved_d0c;
  ReadWrite CCR;
  Reserved<4> reserved_d18;
  ReadWrite CFSR;
  Reserved<3> reserved_d2c;
  ReadOnly BFAR;
};
inline constexpr At<Scb> SCB{0xE000ED00};
inline constexpr std::uint32_t CCR_UNALIGN_TRP = bit(3);
inline constexpr std::uint32_t CCR_DIV_0_TRP = bit(4);
inline constexpr std::uint32_t CCR_STKALIGN = bit(9);

// Smaller is more urgent; the SAM3X has 16 levels, in the upper half of each byte of NVIC_IPR.
inline void enable_interrupt(unsigned number, unsigned priority) {
  const unsigned shift = 8U * (number % 4U) + 4U;
  ReadWrite& reg = NVIC->NVIC_IPR[number / 4U];
  reg.write((reg.read() & ~(0xFU << shift)) | (priority << shift));
  NVIC->NVIC_ISER[number / 32U].write(bit(number % 32U));
}

inline void mask_interrupts() { asm volatile("cpsid i" ::: "memory"); }
inline void unmask_interrupts() { asm volatile("cpsie i" ::: "memory"); }

// Sleeps until an interrupt is pending, even a masked one.
inline void wait_for_interrupt() { asm volatile("dsb\n\twfi" ::: "memory"); }

// Number of the exception that is being handled, 0 in the idle loop (ARMv7-M B1.4.2).
inline std::uint32_t exception_number() {
  std::uint32_t ipsr = 0;
  asm volatile("mrs %0, ipsr" : "=r"(ipsr));
  return ipsr;
}

// Returns when all writes before it have reached their registers.
inline void wait_for_writes() { asm volatile("dsb" ::: "memory"); }

}  // namespace heli::due
