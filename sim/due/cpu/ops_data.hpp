// Handlers of data processing: arithmetic, logic, shifts, multiplication, bit fields. A handler
// executes the decoded instruction `i` on the processor `c` and returns the next instruction.
#pragma once

#include <cstdint>

#include "cpu/cpu.hpp"

namespace due_emulator::ops {

// The second operand of a data processing instruction. kImmCarry is an immediate that also gives
// the carry; kReg is a register without a shift.
enum class Op2 : std::uint8_t { kImm, kImmCarry, kReg, kLsl, kLsr, kAsr, kRor, kRrx };

enum class Alu : std::uint8_t {
  kAnd,
  kBic,
  kOrr,
  kOrn,
  kEor,
  kAdd,
  kAdc,
  kSub,
  kSbc,
  kRsb,
  kMov,
  kMvn,
  kTst,
  kTeq,
  kCmp,
  kCmn
};

// The instruction behind `i`, if it did not branch.
inline const Insn* next(const Insn* i) { return i + i->length; }

// N and Z follow from the result when they are read.
inline void set_nz(Cpu& c, std::uint32_t result) {
  c.n_src = result;
  c.z_src = result;
}

// AddWithCarry (A2.2.1); a - b is add(a, ~b, 1).
template <bool kFlags>
inline std::uint32_t add(Cpu& c, std::uint32_t a, std::uint32_t b, std::uint32_t carry) {
  const std::uint64_t wide = std::uint64_t{a} + b + carry;
  const auto result = static_cast<std::uint32_t>(wide);
  if (kFlags) {
    set_nz(c, result);
    c.carry = static_cast<std::uint32_t>(wide >> 32);
    c.v_src = ~(a ^ b) & (a ^ result);
  }
  return result;
}

inline std::uint32_t rotate_right(std::uint32_t value, unsigned amount) {
  amount &= 31U;
  return amount == 0 ? value : (value >> amount) | (value << (32 - amount));
}

// ASR, by any amount: from 32 on only copies of the sign are left.
inline std::uint32_t arithmetic_right(std::uint32_t value, unsigned amount) {
  return static_cast<std::uint32_t>(static_cast<std::int32_t>(value) >>
                                    (amount > 31 ? 31 : amount));
}

// The operand, and the carry that the shifter gives out. Shift amounts are 1..31 for LSL and ROR,
// 1..32 for LSR and ASR.
template <Op2 kOp>
inline std::uint32_t operand(const Cpu& c, const Insn* i, std::uint32_t& carry) {
  if constexpr (kOp == Op2::kImm) return i->imm;
  if constexpr (kOp == Op2::kImmCarry) {
    carry = i->imm >> 31;
    return i->imm;
  }
  const std::uint32_t value = c.r[i->rm];
  const unsigned amount = i->extra;
  if constexpr (kOp == Op2::kLsl) {
    carry = (value >> (32 - amount)) & 1U;
    return value << amount;
  }
  if constexpr (kOp == Op2::kLsr) {
    carry = (value >> (amount - 1)) & 1U;
    return amount > 31 ? 0 : value >> amount;
  }
  if constexpr (kOp == Op2::kAsr) {
    carry = arithmetic_right(value, amount - 1) & 1U;
    return arithmetic_right(value, amount);
  }
  if constexpr (kOp == Op2::kRor) {
    carry = (value >> (amount - 1)) & 1U;
    return rotate_right(value, amount);
  }
  if constexpr (kOp == Op2::kRrx) {
    carry = value & 1U;
    return (c.carry << 31) | (value >> 1);
  }
  return value;
}

// rd = rn op operand, one function for each operation, operand and flags. Comparisons (TST, TEQ,
// CMP, CMN) only set the flags.
template <Alu kAlu, Op2 kOp, bool kFlags>
const Insn* alu(Cpu& c, const Insn* i) {
  std::uint32_t carry = c.carry;
  const std::uint32_t b = operand<kOp>(c, i, carry);
  const std::uint32_t a = c.r[i->rn];
  std::uint32_t result = 0;
  switch (kAlu) {
    case Alu::kAnd:
    case Alu::kTst:
      result = a & b;
      break;
    case Alu::kBic:
      result = a & ~b;
      break;
    case Alu::kOrr:
      result = a | b;
      break;
    case Alu::kOrn:
      result = a | ~b;
      break;
    case Alu::kEor:
    case Alu::kTeq:
      result = a ^ b;
      break;
    case Alu::kMov:
      result = b;
      break;
    case Alu::kMvn:
      result = ~b;
      break;
    case Alu::kAdd:
    case Alu::kCmn:
      result = add<kFlags>(c, a, b, 0);
      break;
    case Alu::kAdc:
      result = add<kFlags>(c, a, b, c.carry);
      break;
    case Alu::kSub:
    case Alu::kCmp:
      result = add<kFlags>(c, a, ~b, 1);
      break;
    case Alu::kSbc:
      result = add<kFlags>(c, a, ~b, c.carry);
      break;
    case Alu::kRsb:
      result = add<kFlags>(c, ~a, b, 1);
      break;
  }
  constexpr bool kArithmetic = kAlu == Alu::kAdd || kAlu == Alu::kAdc || kAlu == Alu::kSub ||
                               kAlu == Alu::kSbc || kAlu == Alu::kRsb || kAlu == Alu::kCmp ||
                               kAlu == Alu::kCmn;
  if (kFlags && !kArithmetic) {
    set_nz(c, result);
    c.carry = carry;
  }
  constexpr bool kCompares =
      kAlu == Alu::kTst || kAlu == Alu::kTeq || kAlu == Alu::kCmp || kAlu == Alu::kCmn;
  if (!kCompares) c.r[i->rd] = result;
  return next(i);
}

enum class Shift : std::uint8_t { kLsl, kLsr, kAsr, kRor };

// Shift by the low byte of a register: amounts of 32 and more are legal.
template <Shift kShift, bool kFlags>
const Insn* shift_by_register(Cpu& c, const Insn* i) {
  const std::uint32_t value = c.r[i->rn];
  const unsigned amount = c.r[i->rm] & 0xFFU;
  std::uint32_t result = value;
  std::uint32_t carry = c.carry;
  if (amount != 0) {
    switch (kShift) {
      case Shift::kLsl:
        result = amount > 31 ? 0 : value << amount;
        carry = amount > 32 ? 0 : (value >> (32 - amount)) & 1U;
        break;
      case Shift::kLsr:
        result = amount > 31 ? 0 : value >> amount;
        carry = amount > 32 ? 0 : (value >> (amount - 1)) & 1U;
        break;
      case Shift::kAsr:
        result = arithmetic_right(value, amount);
        carry = arithmetic_right(value, amount - 1) & 1U;
        break;
      case Shift::kRor:
        result = rotate_right(value, amount);
        carry = result >> 31;
        break;
    }
  }
  c.r[i->rd] = result;
  if (kFlags) {
    set_nz(c, result);
    c.carry = carry;
  }
  return next(i);
}

// MOVT: the upper halfword.
inline const Insn* move_top(Cpu& c, const Insn* i) {
  c.r[i->rd] = (c.r[i->rd] & 0xFFFFU) | (i->imm << 16);
  return next(i);
}

enum class Extend : std::uint8_t { kSxtb, kSxth, kUxtb, kUxth };

// SXTB, SXTH, UXTB, UXTH of rm, rotated right by `extra` bits.
template <Extend kExtend>
const Insn* extend(Cpu& c, const Insn* i) {
  const std::uint32_t value = rotate_right(c.r[i->rm], i->extra);
  std::uint32_t result = 0;
  switch (kExtend) {
    case Extend::kSxtb:
      result = static_cast<std::uint32_t>(static_cast<std::int8_t>(value));
      break;
    case Extend::kSxth:
      result = static_cast<std::uint32_t>(static_cast<std::int16_t>(value));
      break;
    case Extend::kUxtb:
      result = value & 0xFFU;
      break;
    case Extend::kUxth:
      result = value & 0xFFFFU;
      break;
  }
  c.r[i->rd] = result;
  return next(i);
}

enum class Unary : std::uint8_t { kRev, kRev16, kRevsh, kRbit, kClz };

// REV, REV16, REVSH (byte order), RBIT (bit order) and CLZ (leading zeros) of rm.
template <Unary kUnary>
const Insn* unary(Cpu& c, const Insn* i) {
  const std::uint32_t value = c.r[i->rm];
  std::uint32_t result = 0;
  switch (kUnary) {
    case Unary::kRev:
      result = __builtin_bswap32(value);
      break;
    case Unary::kRev16:
      result = rotate_right(__builtin_bswap32(value), 16);
      break;
    case Unary::kRevsh:
      result = static_cast<std::uint32_t>(
          static_cast<std::int16_t>(__builtin_bswap16(static_cast<std::uint16_t>(value))));
      break;
    case Unary::kRbit:
      for (unsigned bit = 0; bit < 32; ++bit) result |= ((value >> bit) & 1U) << (31 - bit);
      break;
    case Unary::kClz:
      result = value == 0 ? 32U : static_cast<unsigned>(__builtin_clz(value));
      break;
  }
  c.r[i->rd] = result;
  return next(i);
}

// BFI; with rn = 15 it is BFC, which inserts zeros. In all bit field handlers `extra` is the least
// significant bit, `imm` the mask of the field at bit 0.
inline const Insn* bit_field_insert(Cpu& c, const Insn* i) {
  const std::uint32_t source = i->rn == kPc ? 0 : c.r[i->rn];
  const std::uint32_t mask = i->imm << i->extra;
  c.r[i->rd] = (c.r[i->rd] & ~mask) | ((source << i->extra) & mask);
  return next(i);
}

// UBFX.
inline const Insn* bit_field_unsigned(Cpu& c, const Insn* i) {
  c.r[i->rd] = (c.r[i->rn] >> i->extra) & i->imm;
  return next(i);
}

// SBFX.
inline const Insn* bit_field_signed(Cpu& c, const Insn* i) {
  const std::uint32_t field = (c.r[i->rn] >> i->extra) & i->imm;
  const std::uint32_t sign = i->imm ^ (i->imm >> 1);
  c.r[i->rd] = (field ^ sign) - sign;
  return next(i);
}

// SSAT and USAT: shifts rn by `extra` (LSL, or ASR if `ra` is not 0), limits it to `imm` and 0 or
// -imm - 1, and sets Q if that changed it.
template <bool kSigned>
const Insn* saturate(Cpu& c, const Insn* i) {
  const std::uint32_t raw = c.r[i->rn];
  const std::uint32_t shifted = i->ra != 0 ? arithmetic_right(raw, i->extra) : raw << i->extra;
  const auto value = static_cast<std::int64_t>(static_cast<std::int32_t>(shifted));
  const auto high = static_cast<std::int64_t>(i->imm);
  const std::int64_t low = kSigned ? -high - 1 : 0;
  std::int64_t result = value;
  if (value > high) result = high;
  if (value < low) result = low;
  if (result != value) c.q_flag = 1;
  c.r[i->rd] = static_cast<std::uint32_t>(result);
  return next(i);
}

// MUL.
template <bool kFlags>
const Insn* multiply(Cpu& c, const Insn* i) {
  const std::uint32_t result = c.r[i->rn] * c.r[i->rm];
  c.r[i->rd] = result;
  if (kFlags) set_nz(c, result);
  return next(i);
}

inline const Insn* multiply_add(Cpu& c, const Insn* i) {
  c.r[i->rd] = c.r[i->ra] + c.r[i->rn] * c.r[i->rm];
  return next(i);
}

inline const Insn* multiply_subtract(Cpu& c, const Insn* i) {
  c.r[i->rd] = c.r[i->ra] - c.r[i->rn] * c.r[i->rm];
  return next(i);
}

// SMULL, UMULL, SMLAL, UMLAL: `rd` takes the low word, `ra` the high word.
template <bool kSigned, bool kAccumulate>
const Insn* multiply_long(Cpu& c, const Insn* i) {
  std::uint64_t product = 0;
  if (kSigned) {
    product = static_cast<std::uint64_t>(
        static_cast<std::int64_t>(static_cast<std::int32_t>(c.r[i->rn])) *
        static_cast<std::int32_t>(c.r[i->rm]));
  } else {
    product = std::uint64_t{c.r[i->rn]} * c.r[i->rm];
  }
  if (kAccumulate) product += (std::uint64_t{c.r[i->ra]} << 32) | c.r[i->rd];
  c.r[i->rd] = static_cast<std::uint32_t>(product);
  c.r[i->ra] = static_cast<std::uint32_t>(product >> 32);
  return next(i);
}

// The divider ends early: 2 to 12 cycles, by the difference of the operands' lengths.
inline std::uint32_t division_cycles(std::uint32_t a, std::uint32_t b) {
  if (b == 0 || a < b) return 0;
  const int quotient_bits = __builtin_clz(b) - __builtin_clz(a) + 1;
  return static_cast<std::uint32_t>((quotient_bits + 3) / 4 + 1);
}

// SDIV and UDIV, rounded towards 0. A division by 0 gives 0, or a UsageFault if CCR.DIV_0_TRP (bit
// 4) is set.
template <bool kSigned>
const Insn* divide(Cpu& c, const Insn* i) {
  const std::uint32_t a = c.r[i->rn];
  const std::uint32_t b = c.r[i->rm];
  if (b == 0) {
    if ((c.ccr & 0x10U) != 0)  // DIV_0_TRP
      throw Fault{exc::kUsageFault, cfsr::kDivByZero};
    c.r[i->rd] = 0;
    return next(i);
  }
  if (kSigned) {
    const auto sa = static_cast<std::int64_t>(static_cast<std::int32_t>(a));
    const auto sb = static_cast<std::int64_t>(static_cast<std::int32_t>(b));
    c.add_cycles(division_cycles(static_cast<std::uint32_t>(sa < 0 ? -sa : sa),
                                 static_cast<std::uint32_t>(sb < 0 ? -sb : sb)));
    c.r[i->rd] = static_cast<std::uint32_t>(sa / sb);
  } else {
    c.add_cycles(division_cycles(a, b));
    c.r[i->rd] = a / b;
  }
  return next(i);
}

// Wraps a handler whose rd is SP (r13): its two lowest bits always read 0.
template <Handler kInner>
const Insn* into_sp(Cpu& c, const Insn* i) {
  const Insn* after = kInner(c, i);
  c.r[kSp] &= ~3U;
  return after;
}

}  // namespace due_emulator::ops
