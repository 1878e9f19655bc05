// One decoded instruction. The code caches hold one of these for every halfword of executable
// memory, so that decoding happens once for each address and running is an indirect call.
#pragma once

#include <cstdint>

namespace due_emulator {

class Cpu;
struct Insn;

// Executes the instruction and returns the next one to execute.
using Handler = const Insn* (*)(Cpu&, const Insn*);

// Numbers of the registers with a role of their own.
inline constexpr std::uint8_t kSp = 13;
inline constexpr std::uint8_t kLr = 14;
inline constexpr std::uint8_t kPc = 15;

struct Insn {
  Handler run;
  std::uint32_t imm;  // immediate, absolute branch target, or literal
  std::int32_t step;  // distance in halfwords to the target of a branch inside the same memory
  std::uint8_t rd;
  std::uint8_t rn;
  std::uint8_t rm;
  std::uint8_t ra;
  std::uint8_t length;  // in halfwords: 1 or 2
  std::uint8_t cycles;  // of the model in cpu/README.md
  std::uint8_t it;      // ITSTATE in front of this instruction; 0 outside of an IT block
  std::uint8_t extra;  // shift amount, cycles that a taken branch adds, or bytes of a register list
};

// Why the processor could not do an instruction: an ARMv7-M exception and what CFSR says of it.
struct Fault {
  std::uint8_t exception;
  std::uint32_t cfsr;
  std::uint32_t address = 0;
  bool has_address = false;
};

// Bits of the configurable fault status register.
namespace cfsr {
inline constexpr std::uint32_t kIaccViol = 1U << 0;
inline constexpr std::uint32_t kMunstkErr = 1U << 3;
inline constexpr std::uint32_t kMstkErr = 1U << 4;
inline constexpr std::uint32_t kMmarValid = 1U << 7;
inline constexpr std::uint32_t kIbusErr = 1U << 8;
inline constexpr std::uint32_t kPrecisErr = 1U << 9;
inline constexpr std::uint32_t kUnstkErr = 1U << 11;
inline constexpr std::uint32_t kStkErr = 1U << 12;
inline constexpr std::uint32_t kBfarValid = 1U << 15;
inline constexpr std::uint32_t kUndefInstr = 1U << 16;
inline constexpr std::uint32_t kInvState = 1U << 17;
inline constexpr std::uint32_t kInvPc = 1U << 18;
inline constexpr std::uint32_t kNoCp = 1U << 19;
inline constexpr std::uint32_t kUnaligned = 1U << 24;
inline constexpr std::uint32_t kDivByZero = 1U << 25;
}  // namespace cfsr

// Exception numbers of ARMv7-M; external interrupt n is kIrq0 + n.
namespace exc {
inline constexpr std::uint8_t kNmi = 2;
inline constexpr std::uint8_t kHardFault = 3;
inline constexpr std::uint8_t kMemManage = 4;
inline constexpr std::uint8_t kBusFault = 5;
inline constexpr std::uint8_t kUsageFault = 6;
inline constexpr std::uint8_t kSvCall = 11;
inline constexpr std::uint8_t kDebugMonitor = 12;
inline constexpr std::uint8_t kPendSv = 14;
inline constexpr std::uint8_t kSysTick = 15;
inline constexpr std::uint8_t kIrq0 = 16;
inline constexpr std::uint8_t kIrqCount = 45;
inline constexpr std::uint8_t kCount = kIrq0 + kIrqCount;
}  // namespace exc

}  // namespace due_emulator
