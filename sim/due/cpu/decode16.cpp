// 16-bit Thumb encodings. Each function decodes one table of the ARMv7-M manual (A5.2), and `w` is
// the instruction's halfword.
#include "cpu/decoder.hpp"

namespace due_emulator {

using ops::Alu;
using ops::Mode;
using ops::Op2;

// Chooses the table by the upper four bits (A5.2).
void Decoder::decode16(std::uint32_t w) {
  switch (w >> 12) {
    case 0:
    case 1:
    case 2:
    case 3:
      return shift_add_compare(w);
    case 4:
      if ((w & 0x0C00U) == 0) return data_processing16(w);
      if ((w & 0x0C00U) == 0x0400U) return special_data(w);
      rd(field(w, 8, 3));  // LDR (literal)
      return literal(Access::kWord, (pc() & ~3U) + 4 * field(w, 0, 8));
    case 5:
    case 6:
    case 7:
    case 8:
    case 9:
      return load_store16(w);
    case 10:
      rd(field(w, 8, 3));
      if ((w & 0x0800U) == 0) {  // ADR: the address is a constant
        out_.imm = (pc() & ~3U) + 4 * field(w, 0, 8);
        return put_alu<Alu::kMov, Op2::kImm>(kKeepFlags);
      }
      rn(kSp);  // ADD (SP plus immediate)
      out_.imm = 4 * field(w, 0, 8);
      return put_alu<Alu::kAdd, Op2::kImm>(kKeepFlags);
    case 11:
      return miscellaneous16(w);
    case 12:
      return multiple16(w);
    case 13: {  // B<c>, UDF, SVC
      const std::uint32_t condition = field(w, 8, 4);
      if (condition == 14) return undefined();
      if (condition == 15) {
        out_.imm = field(w, 0, 8);
        return put<&ops::supervisor_call>();
      }
      return branch_to_if(condition, pc() + 2 * sign_extend(field(w, 0, 8), 8));
    }
    default:  // B
      if (in_it() && !last_in_it()) return undefined();
      return branch_to(pc() + 2 * sign_extend(field(w, 0, 11), 11), false);
  }
}

// Shift by a constant, add, subtract, move and compare (A5.2.1). Outside of an IT block they set
// the flags.
void Decoder::shift_add_compare(std::uint32_t w) {
  const bool flags = !in_it();
  const std::uint32_t op = field(w, 11, 3);
  if ((w >> 13) == 1) {  // a register and an immediate of 8 bits
    rd(field(w, 8, 3));
    rn(field(w, 8, 3));
    out_.imm = field(w, 0, 8);
    switch (field(w, 11, 2)) {
      case 0:
        return put_alu<Alu::kMov, Op2::kImm>(flags);
      case 1:
        return put_alu<Alu::kCmp, Op2::kImm>(kSetFlags);
      case 2:
        return put_alu<Alu::kAdd, Op2::kImm>(flags);
      default:
        return put_alu<Alu::kSub, Op2::kImm>(flags);
    }
  }
  rd(field(w, 0, 3));
  if (op < 3) {  // LSL, LSR, ASR (immediate)
    rm(field(w, 3, 3));
    return put_op2<Alu::kMov>(immediate_shift(op, field(w, 6, 5)), flags);
  }
  // ADD and SUB of a register, or of an immediate of 3 bits in the same place.
  rn(field(w, 3, 3));
  rm(field(w, 6, 3));
  out_.imm = field(w, 6, 3);
  switch (field(w, 9, 2)) {
    case 0:
      return put_alu<Alu::kAdd, Op2::kReg>(flags);
    case 1:
      return put_alu<Alu::kSub, Op2::kReg>(flags);
    case 2:
      return put_alu<Alu::kAdd, Op2::kImm>(flags);
    default:
      return put_alu<Alu::kSub, Op2::kImm>(flags);
  }
}

// Data processing of two low registers (A5.2.2): rd = rd op rm.
void Decoder::data_processing16(std::uint32_t w) {
  using ops::Shift;
  const bool flags = !in_it();
  const std::uint32_t low = field(w, 0, 3);
  rd(low);
  rn(low);
  rm(field(w, 3, 3));
  switch (field(w, 6, 4)) {
    case 0:
      return put_alu<Alu::kAnd, Op2::kReg>(flags);
    case 1:
      return put_alu<Alu::kEor, Op2::kReg>(flags);
    case 2:
      return flags ? put<&ops::shift_by_register<Shift::kLsl, kSetFlags>>()
                   : put<&ops::shift_by_register<Shift::kLsl, kKeepFlags>>();
    case 3:
      return flags ? put<&ops::shift_by_register<Shift::kLsr, kSetFlags>>()
                   : put<&ops::shift_by_register<Shift::kLsr, kKeepFlags>>();
    case 4:
      return flags ? put<&ops::shift_by_register<Shift::kAsr, kSetFlags>>()
                   : put<&ops::shift_by_register<Shift::kAsr, kKeepFlags>>();
    case 5:
      return put_alu<Alu::kAdc, Op2::kReg>(flags);
    case 6:
      return put_alu<Alu::kSbc, Op2::kReg>(flags);
    case 7:
      return flags ? put<&ops::shift_by_register<Shift::kRor, kSetFlags>>()
                   : put<&ops::shift_by_register<Shift::kRor, kKeepFlags>>();
    case 8:
      return put_alu<Alu::kTst, Op2::kReg>(kSetFlags);
    case 9:  // RSB from 0, also called NEG
      rn(field(w, 3, 3));
      out_.imm = 0;
      return put_alu<Alu::kRsb, Op2::kImm>(flags);
    case 10:
      return put_alu<Alu::kCmp, Op2::kReg>(kSetFlags);
    case 11:
      return put_alu<Alu::kCmn, Op2::kReg>(kSetFlags);
    case 12:
      return put_alu<Alu::kOrr, Op2::kReg>(flags);
    case 13:
      return flags ? put<&ops::multiply<kSetFlags>>() : put<&ops::multiply<kKeepFlags>>();
    case 14:
      return put_alu<Alu::kBic, Op2::kReg>(flags);
    default:
      return put_alu<Alu::kMvn, Op2::kReg>(flags);
  }
}

// ADD (op 0), CMP (1), MOV (2) of any registers, BX and BLX (3): A5.2.3. What writes PC branches,
// and may only be the last instruction of an IT block; a read of PC is a constant.
void Decoder::special_data(std::uint32_t w) {
  const std::uint32_t d = field(w, 0, 3) | (field(w, 7, 1) << 3);
  rd(d);
  rn(d);
  rm(field(w, 3, 4));
  const std::uint32_t op = field(w, 8, 2);
  if (op == 1) {
    if (out_.rm == kPc || d == kPc) return undefined();
    return put_alu<Alu::kCmp, Op2::kReg>(kSetFlags);
  }
  if (op == 3 || d == kPc) {
    if (in_it() && !last_in_it()) return undefined();
    cycles(1U + taken_cycles(kUnknownTarget));
  }
  if (op == 3) {
    if (field(w, 0, 3) != 0 || out_.rm == kPc) return undefined();
    if (field(w, 7, 1) == 0) return put<&ops::branch_exchange>();
    out_.imm = (address_ + 2) | 1U;  // return address for LR; bit 0 means Thumb
    return put<&ops::branch_link_exchange>();
  }
  if (op == 0) {
    if (d == kPc) {
      if (out_.rm == kPc) return undefined();
      out_.imm = pc();
      return put<&ops::add_to_pc>();
    }
    if (out_.rm == kPc) {
      out_.imm = pc();
      return put_alu<Alu::kAdd, Op2::kImm>(kKeepFlags);
    }
    return put_alu<Alu::kAdd, Op2::kReg>(kKeepFlags);
  }
  if (out_.rm == kPc) {
    if (d == kPc) return undefined();
    out_.imm = pc();
    return put_alu<Alu::kMov, Op2::kImm>(kKeepFlags);
  }
  if (d == kPc) return put<&ops::move_to_pc>();
  put_alu<Alu::kMov, Op2::kReg>(kKeepFlags);
}

// Loads and stores of one register (A5.2.4): the address is rn plus a register, or plus an
// immediate that counts in units of the size.
void Decoder::load_store16(std::uint32_t w) {
  rd(field(w, 0, 3));
  rn(field(w, 3, 3));
  const std::uint32_t imm5 = field(w, 6, 5);
  const bool is_load = field(w, 11, 1) != 0;
  switch (w >> 12) {
    case 5: {
      rm(field(w, 6, 3));
      extra(0);
      switch (field(w, 9, 3)) {
        case 0:
          return put_load_store<Mode::kRegister>(Access::kWord, kStore);
        case 1:
          return put_load_store<Mode::kRegister>(Access::kHalf, kStore);
        case 2:
          return put_load_store<Mode::kRegister>(Access::kByte, kStore);
        case 3:
          return put_load_store<Mode::kRegister>(Access::kSignedByte, kLoad);
        case 4:
          return put_load_store<Mode::kRegister>(Access::kWord, kLoad);
        case 5:
          return put_load_store<Mode::kRegister>(Access::kHalf, kLoad);
        case 6:
          return put_load_store<Mode::kRegister>(Access::kByte, kLoad);
        default:
          return put_load_store<Mode::kRegister>(Access::kSignedHalf, kLoad);
      }
    }
    case 6:
      out_.imm = imm5 * 4;
      return put_load_store<Mode::kOffset>(Access::kWord, is_load);
    case 7:
      out_.imm = imm5;
      return put_load_store<Mode::kOffset>(Access::kByte, is_load);
    case 8:
      out_.imm = imm5 * 2;
      return put_load_store<Mode::kOffset>(Access::kHalf, is_load);
    default:  // relative to SP
      rd(field(w, 8, 3));
      rn(kSp);
      out_.imm = field(w, 0, 8) * 4;
      return put_load_store<Mode::kOffset>(Access::kWord, is_load);
  }
}

// The miscellaneous instructions (A5.2.5), by bits 8 to 11.
void Decoder::miscellaneous16(std::uint32_t w) {
  const std::uint32_t op = field(w, 8, 4);
  switch (op) {
    case 0:  // ADD, SUB (SP plus or minus immediate)
      rd(kSp);
      rn(kSp);
      out_.imm = field(w, 0, 7) * 4;
      return field(w, 7, 1) == 0 ? put_alu<Alu::kAdd, Op2::kImm>(kKeepFlags)
                                 : put_alu<Alu::kSub, Op2::kImm>(kKeepFlags);
    case 1:
    case 3:
    case 9:
    case 11: {  // CBZ, CBNZ
      if (in_it()) return undefined();
      rn(field(w, 0, 3));
      ra(field(w, 11, 1));
      const std::uint32_t target = pc() + ((field(w, 9, 1) << 6) | (field(w, 3, 5) << 1));
      set_target(target);
      extra(taken_cycles(target));
      return put<&ops::compare_and_branch>();
    }
    case 2:  // SXTH, SXTB, UXTH, UXTB
      rd(field(w, 0, 3));
      rm(field(w, 3, 3));
      switch (field(w, 6, 2)) {
        case 0:
          return put<&ops::extend<ops::Extend::kSxth>>();
        case 1:
          return put<&ops::extend<ops::Extend::kSxtb>>();
        case 2:
          return put<&ops::extend<ops::Extend::kUxth>>();
        default:
          return put<&ops::extend<ops::Extend::kUxtb>>();
      }
    case 4:
    case 5:  // PUSH; bit 8 adds LR
      rn(kSp);
      ra(kWriteBack);
      registers(field(w, 0, 8) | (field(w, 8, 1) << 14));
      if (out_.imm == 0) return undefined();
      return put<&ops::store_multiple<true>>();
    case 6:  // CPS
      if ((w & 0xE8U) != 0x60U || in_it()) return undefined();
      ra(field(w, 4, 1) | (field(w, 1, 1) << 1) | (field(w, 0, 1) << 2));
      return put<&ops::change_state>();
    case 10:  // REV, REV16, REVSH
      rd(field(w, 0, 3));
      rm(field(w, 3, 3));
      switch (field(w, 6, 2)) {
        case 0:
          return put<&ops::unary<ops::Unary::kRev>>();
        case 1:
          return put<&ops::unary<ops::Unary::kRev16>>();
        case 3:
          return put<&ops::unary<ops::Unary::kRevsh>>();
        default:
          return undefined();
      }
    case 12:
    case 13:  // POP; bit 8 adds PC, which is a branch
      rn(kSp);
      ra(kWriteBack);
      registers(field(w, 0, 8) | (field(w, 8, 1) << 15),
                1U + (op == 13 ? taken_cycles(kUnknownTarget) : 0U));
      if (out_.imm == 0 || (op == 13 && in_it() && !last_in_it())) return undefined();
      return put<&ops::load_multiple<false>>();
    case 14:  // BKPT
      out_.imm = field(w, 0, 8);
      out_.run = &ops::breakpoint;
      return;
    case 15:  // IT and hints
      return hints(w);
    default:
      return undefined();
  }
}

// IT, and the hints WFE, WFI, SEV; NOP and YIELD do nothing here.
void Decoder::hints(std::uint32_t w) {
  if ((w & 0xFU) != 0) {  // IT: a condition and a mask that is not 0
    const std::uint32_t condition = field(w, 4, 4);
    // AL takes no else part, and the IT block may not nest.
    const bool al_else = condition == 14 && (w & (w - 1) & 0xFU) != 0;
    if (in_it() || condition == 15 || al_else) return undefined();
    is_it_ = true;
    out_.imm = w & 0xFFU;
    out_.run = &ops::nop;
    return;
  }
  switch (field(w, 4, 4)) {
    case 2:
      return put<&ops::wait_for_event>();
    case 3:
      return put<&ops::wait_for_interrupt>();
    case 4:
      return put<&ops::send_event>();
    default:
      return put<&ops::nop>();
  }
}

// STM (bit 11 clear) and LDM (A7.7).
void Decoder::multiple16(std::uint32_t w) {
  rn(field(w, 8, 3));
  registers(field(w, 0, 8));
  if (out_.imm == 0) return undefined();
  const bool in_list = ((out_.imm >> out_.rn) & 1U) != 0;
  if (field(w, 11, 1) != 0) {
    ra(in_list ? kKeepBase : kWriteBack);
    return put<&ops::load_multiple<false>>();
  }
  ra(kWriteBack);
  put<&ops::store_multiple<false>>();
}

}  // namespace due_emulator
