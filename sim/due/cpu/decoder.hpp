// Thumb-2 decoder of ARMv7-M. One object decodes one instruction.
//
// Encodings that the architecture leaves UNPREDICTABLE are refused like undefined ones wherever a
// compiler would never write them, so that a firmware that runs into data is noticed.
#pragma once

#include <cstdint>

#include "bus/memory.hpp"
#include "cpu/cpu.hpp"
#include "cpu/insn.hpp"
#include "cpu/ops_branch.hpp"

namespace due_emulator {

// The `bits` bits of `w` from bit `low` on.
inline std::uint32_t field(std::uint32_t w, unsigned low, unsigned bits) {
  return (w >> low) & ((1U << bits) - 1U);
}

// Widens a two's complement number of `bits` bits to 32.
inline std::uint32_t sign_extend(std::uint32_t value, unsigned bits) {
  const std::uint32_t sign = 1U << (bits - 1);
  return (value ^ sign) - sign;
}

// What a load or store moves; a signed one is widened with its sign.
enum class Access : std::uint8_t { kWord, kHalf, kByte, kSignedHalf, kSignedByte };

// Names for what the functions below and the handlers take as numbers and booleans.
inline constexpr bool kSetFlags = true;
inline constexpr bool kKeepFlags = false;
inline constexpr bool kLoad = true;
inline constexpr bool kStore = false;
inline constexpr std::uint32_t kWriteBack = 1;  // `ra` of LDM and STM: the base becomes the end
inline constexpr std::uint32_t kKeepBase = 0;
inline constexpr std::uint32_t kUnknownTarget = ~0U;

class Decoder {
 public:
  // `it` is ITSTATE in front of the instruction at `address`.
  Decoder(const Cpu& cpu, const CodeWindow& window, std::uint32_t address, std::uint8_t it);

  const Insn& insn() const { return out_; }
  bool is_it() const { return is_it_; }
  // ITSTATE that an IT instruction sets up.
  std::uint8_t opens_it() const { return static_cast<std::uint8_t>(out_.imm); }

 private:
  // Each of these fills `out_` for the instructions of one table of the manual.
  void decode16(std::uint32_t w);
  void shift_add_compare(std::uint32_t w);
  void data_processing16(std::uint32_t w);
  void special_data(std::uint32_t w);
  void load_store16(std::uint32_t w);
  void miscellaneous16(std::uint32_t w);
  void multiple16(std::uint32_t w);
  void hints(std::uint32_t w);

  void decode32(std::uint32_t hw1, std::uint32_t hw2);
  void multiple32(std::uint32_t hw1, std::uint32_t hw2);
  void double_exclusive(std::uint32_t hw1, std::uint32_t hw2);
  void shifted_register(std::uint32_t hw1, std::uint32_t hw2);
  void modified_immediate(std::uint32_t hw1, std::uint32_t hw2);
  void plain_immediate(std::uint32_t hw1, std::uint32_t hw2);
  void branches(std::uint32_t hw1, std::uint32_t hw2);
  void control(std::uint32_t hw1, std::uint32_t hw2);
  void special_register(std::uint32_t hw1, std::uint32_t hw2);
  void load_store32(std::uint32_t hw1, std::uint32_t hw2);
  void register_operations(std::uint32_t hw1, std::uint32_t hw2);
  void multiply32(std::uint32_t hw1, std::uint32_t hw2);
  void multiply_long32(std::uint32_t hw1, std::uint32_t hw2);
  void data_processing32(std::uint32_t op, bool flags, ops::Op2 op2, std::uint32_t rd,
                         std::uint32_t rn);

  // Sets the handler that runs the instruction. In an IT block, it first checks the condition.
  template <Handler kHandler>
  void put() {
    out_.run = it_ != 0 ? &ops::conditional<kHandler> : kHandler;
  }
  // As put(), for handlers that write `rd`, which may be the stack pointer.
  template <Handler kHandler>
  void put_rd() {
    if (out_.rd == kSp) {
      put<&ops::into_sp<kHandler>>();
    } else {
      put<kHandler>();
    }
  }
  // Sets the handler of a data processing instruction, with or without flags.
  template <ops::Alu kAlu, ops::Op2 kOp>
  void put_alu(bool flags) {
    if (flags) {
      put_rd<&ops::alu<kAlu, kOp, true>>();
    } else {
      put_rd<&ops::alu<kAlu, kOp, false>>();
    }
  }
  // The same for a second operand that is known only at run time.
  template <ops::Alu kAlu>
  void put_op2(ops::Op2 op2, bool flags);
  // Sets the handler of a load or store.
  template <ops::Mode kMode>
  void put_load_store(Access access, bool is_load);
  // A load from `address`, which is relative to PC and so known when decoding.
  void literal(Access access, std::uint32_t address);
  // Notes the shift's amount in `extra`; returns its kind. `type` is the encoding's field.
  ops::Op2 immediate_shift(std::uint32_t type, std::uint32_t amount);

  void undefined();  // the instruction raises UsageFault
  void branch_to(std::uint32_t target, bool link);
  // B<c>: `condition` as in A7.3.
  void branch_to_if(std::uint32_t condition, std::uint32_t target);
  // Whether a branch from here may go by a distance between decoded instructions.
  bool near(std::uint32_t target) const;
  std::uint8_t taken_cycles(std::uint32_t target) const;
  void set_target(std::uint32_t target);
  // What an instruction here reads from PC: two halfwords ahead.
  std::uint32_t pc() const { return address_ + 4; }
  bool in_it() const { return it_ != 0; }
  bool last_in_it() const { return (it_ & 0xFU) == 0x8U; }
  void rd(std::uint32_t value) { out_.rd = static_cast<std::uint8_t>(value); }
  void rn(std::uint32_t value) { out_.rn = static_cast<std::uint8_t>(value); }
  void rm(std::uint32_t value) { out_.rm = static_cast<std::uint8_t>(value); }
  void ra(std::uint32_t value) { out_.ra = static_cast<std::uint8_t>(value); }
  void extra(std::uint32_t value) { out_.extra = static_cast<std::uint8_t>(value); }
  // The register list of LDM or STM, bit n for rn: a cycle for each register, and `more` cycles.
  void registers(std::uint32_t list, std::uint32_t more = 1);
  void cycles(std::uint32_t value) { out_.cycles = static_cast<std::uint8_t>(value); }

  const Cpu& cpu_;
  const CodeWindow& window_;
  std::uint32_t address_;
  std::uint8_t it_;
  bool is_it_ = false;
  Insn out_{};
};

// Turns the run-time operand kind into a template argument.
template <ops::Alu kAlu>
void Decoder::put_op2(ops::Op2 op2, bool flags) {
  switch (op2) {
    case ops::Op2::kImm:
      return put_alu<kAlu, ops::Op2::kImm>(flags);
    case ops::Op2::kImmCarry:
      return put_alu<kAlu, ops::Op2::kImmCarry>(flags);
    case ops::Op2::kReg:
      return put_alu<kAlu, ops::Op2::kReg>(flags);
    case ops::Op2::kLsl:
      return put_alu<kAlu, ops::Op2::kLsl>(flags);
    case ops::Op2::kLsr:
      return put_alu<kAlu, ops::Op2::kLsr>(flags);
    case ops::Op2::kAsr:
      return put_alu<kAlu, ops::Op2::kAsr>(flags);
    case ops::Op2::kRor:
      return put_alu<kAlu, ops::Op2::kRor>(flags);
    case ops::Op2::kRrx:
      return put_alu<kAlu, ops::Op2::kRrx>(flags);
  }
}

// Chooses the handler by access and direction. A word that is loaded into PC branches.
template <ops::Mode kMode>
void Decoder::put_load_store(Access access, bool is_load) {
  using u8 = std::uint8_t;
  using u16 = std::uint16_t;
  using u32 = std::uint32_t;
  cycles(is_load ? 2 : 1);
  switch (access) {
    case Access::kByte:
      return is_load ? put_rd<&ops::load<u8, false, kMode>>() : put<&ops::store<u8, kMode>>();
    case Access::kHalf:
      return is_load ? put_rd<&ops::load<u16, false, kMode>>() : put<&ops::store<u16, kMode>>();
    case Access::kSignedByte:
      return put_rd<&ops::load<u8, true, kMode>>();
    case Access::kSignedHalf:
      return put_rd<&ops::load<u16, true, kMode>>();
    case Access::kWord:
      break;
  }
  if (!is_load) return put<&ops::store<u32, kMode>>();
  if (out_.rd == kPc) {
    cycles(2U + taken_cycles(kUnknownTarget));
    return put<&ops::load_pc<kMode>>();
  }
  put_rd<&ops::load<u32, false, kMode>>();
}

}  // namespace due_emulator
