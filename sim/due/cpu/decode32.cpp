// 32-bit Thumb encodings. Each function decodes one table of the ARMv7-M manual (A5.3); `hw1` and
// `hw2` are the instruction's first and second halfword.
#include "cpu/decoder.hpp"

namespace due_emulator {

using ops::Alu;
using ops::Mode;
using ops::Op2;

namespace {

// SP and PC, which most 32-bit encodings forbid as a register.
bool is_sp_or_pc(std::uint32_t reg) { return reg == kSp || reg == kPc; }

}  // namespace

// Chooses the table (A5.3): op1 is the manual's field of that name.
void Decoder::decode32(std::uint32_t hw1, std::uint32_t hw2) {
  const std::uint32_t op1 = field(hw1, 11, 2);
  if (op1 == 1) {
    if (field(hw1, 9, 2) == 0)
      return field(hw1, 6, 1) == 0 ? multiple32(hw1, hw2) : double_exclusive(hw1, hw2);
    if (field(hw1, 9, 2) == 1) return shifted_register(hw1, hw2);
    return put<&ops::no_coprocessor>();
  }
  if (op1 == 2) {
    if (field(hw2, 15, 1) != 0) return branches(hw1, hw2);
    return field(hw1, 9, 1) == 0 ? modified_immediate(hw1, hw2) : plain_immediate(hw1, hw2);
  }
  if (field(hw1, 10, 1) != 0) return put<&ops::no_coprocessor>();
  if (field(hw1, 9, 1) == 0) return load_store32(hw1, hw2);
  if (field(hw1, 8, 1) == 0) return register_operations(hw1, hw2);
  return field(hw1, 7, 1) == 0 ? multiply32(hw1, hw2) : multiply_long32(hw1, hw2);
}

// LDM and STM (A5.3.5): op 1 increments after, op 2 decrements before. hw2 is the register list.
// Refuses lists with SP, with fewer than two registers, and loads of both LR and PC.
void Decoder::multiple32(std::uint32_t hw1, std::uint32_t hw2) {
  const std::uint32_t op = field(hw1, 7, 2);
  const bool is_load = field(hw1, 4, 1) != 0;
  const bool write_back = field(hw1, 5, 1) != 0;
  rn(field(hw1, 0, 4));
  ra(write_back ? kWriteBack : kKeepBase);
  const bool base_in_list = ((hw2 >> out_.rn) & 1U) != 0;
  const bool with_pc = (hw2 & 0x8000U) != 0;
  const bool single = (hw2 & (hw2 - 1U)) == 0;
  registers(hw2, 1U + (with_pc ? taken_cycles(kUnknownTarget) : 0U));
  if ((op != 1 && op != 2) || out_.rn == kPc || single || (hw2 & 0x2000U) != 0 ||
      (write_back && base_in_list)) {
    return undefined();
  }
  if (is_load ? (hw2 & 0xC000U) == 0xC000U : with_pc) return undefined();
  if (with_pc && in_it() && !last_in_it()) return undefined();
  if (is_load) {
    return op == 1 ? put<&ops::load_multiple<false>>() : put<&ops::load_multiple<true>>();
  }
  op == 1 ? put<&ops::store_multiple<false>>() : put<&ops::store_multiple<true>>();
}

// LDRD and STRD, exclusive loads and stores, TBB and TBH (A5.3.6). op1, op2 and op3 are the
// manual's fields: LDRD and STRD if op1 or op2 has bit 1 set, otherwise by op1 and op3.
void Decoder::double_exclusive(std::uint32_t hw1, std::uint32_t hw2) {
  const std::uint32_t op1 = field(hw1, 7, 2);
  const std::uint32_t op2 = field(hw1, 4, 2);
  const bool is_load = (op2 & 1U) != 0;
  rn(field(hw1, 0, 4));
  rd(field(hw2, 12, 4));
  if ((op1 & 2U) != 0 || (op2 & 2U) != 0) {
    // LDRD and STRD, to and from rd and ra; P (pre-index) is bit 8, U (add the offset) bit 7, W
    // (write back) bit 5 of hw1. PC as base is allowed only for loads, without write-back.
    const std::uint32_t offset = field(hw2, 0, 8) * 4;
    const bool add = field(hw1, 7, 1) != 0;
    const bool pre_index = field(hw1, 8, 1) != 0;
    const bool write_back = field(hw1, 5, 1) != 0;
    ra(field(hw2, 8, 4));
    cycles(3);
    if (is_sp_or_pc(out_.rd) || is_sp_or_pc(out_.ra)) return undefined();
    if (write_back && (out_.rn == out_.rd || out_.rn == out_.ra || out_.rn == kPc))
      return undefined();
    if (is_load && out_.rd == out_.ra) return undefined();
    if (out_.rn == kPc) {
      out_.imm = (pc() & ~3U) + (add ? offset : 0U - offset);
      return is_load ? put<&ops::load_double_literal>() : undefined();
    }
    out_.imm = add ? offset : 0U - offset;
    if (!pre_index) {
      return is_load ? put<&ops::load_double<Mode::kPost>>()
                     : put<&ops::store_double<Mode::kPost>>();
    }
    if (write_back) {
      return is_load ? put<&ops::load_double<Mode::kPre>>() : put<&ops::store_double<Mode::kPre>>();
    }
    return is_load ? put<&ops::load_double<Mode::kOffset>>()
                   : put<&ops::store_double<Mode::kOffset>>();
  }
  cycles(2);
  // In exclusive stores `ra` takes the result; loads have 15 in its place.
  if (op1 == 0) {  // LDREX, STREX
    out_.imm = field(hw2, 0, 8) * 4;
    if (out_.rn == kPc || is_sp_or_pc(out_.rd)) return undefined();
    if (is_load) {
      return field(hw2, 8, 4) == 15 ? put<&ops::load_exclusive<std::uint32_t>>() : undefined();
    }
    ra(field(hw2, 8, 4));
    if (is_sp_or_pc(out_.ra) || out_.ra == out_.rd || out_.ra == out_.rn) return undefined();
    return put<&ops::store_exclusive<std::uint32_t>>();
  }
  const std::uint32_t op3 = field(hw2, 4, 4);
  if (op3 <= 1) {  // TBB, TBH
    if (!is_load || out_.rn == kSp || field(hw2, 8, 8) != 0xF0U) return undefined();
    rm(field(hw2, 0, 4));
    if (is_sp_or_pc(out_.rm) || (in_it() && !last_in_it())) return undefined();
    out_.imm = pc();
    cycles(2U + taken_cycles(kUnknownTarget));
    return op3 == 0 ? put<&ops::table_branch<std::uint8_t>>()
                    : put<&ops::table_branch<std::uint16_t>>();
  }
  // LDREXB and STREXB (op3 4), LDREXH and STREXH (5).
  if ((op3 != 4 && op3 != 5) || field(hw2, 8, 4) != 15 || out_.rn == kPc || is_sp_or_pc(out_.rd)) {
    return undefined();
  }
  if (is_load) {
    if (field(hw2, 0, 4) != 15) return undefined();
    return op3 == 4 ? put<&ops::load_exclusive<std::uint8_t>>()
                    : put<&ops::load_exclusive<std::uint16_t>>();
  }
  ra(field(hw2, 0, 4));
  if (is_sp_or_pc(out_.ra) || out_.ra == out_.rd || out_.ra == out_.rn) return undefined();
  op3 == 4 ? put<&ops::store_exclusive<std::uint8_t>>()
           : put<&ops::store_exclusive<std::uint16_t>>();
}

// Loads and stores of one register (A5.3.7 to A5.3.10), by address: relative to PC, immediate of 12
// bits, register with LSL by 0 to 3, or immediate of 8 bits with P (pre-index), U (add) and W
// (write back) in bits 10, 9 and 8 of hw2.
void Decoder::load_store32(std::uint32_t hw1, std::uint32_t hw2) {
  const std::uint32_t size_field = field(hw1, 5, 2);  // 0 byte, 1 halfword, 2 word
  const bool is_load = field(hw1, 4, 1) != 0;
  const bool sign = field(hw1, 8, 1) != 0;
  if (size_field == 3 || (sign && (!is_load || size_field == 2))) return undefined();
  const Access access = size_field == 2   ? Access::kWord
                        : size_field == 1 ? (sign ? Access::kSignedHalf : Access::kHalf)
                                          : (sign ? Access::kSignedByte : Access::kByte);
  const bool is_word = access == Access::kWord;
  rd(field(hw2, 12, 4));
  rn(field(hw1, 0, 4));
  // A byte or halfword load into PC is a hint: PLD, PLI or a reserved one.
  const bool is_hint = is_load && !is_word && out_.rd == kPc;
  if (out_.rn == kPc) {
    if (!is_load) return undefined();
    const std::uint32_t offset = field(hw2, 0, 12);
    if (is_hint) return put<&ops::nop>();
    if (out_.rd == kSp && !is_word) return undefined();
    if (out_.rd == kPc && in_it() && !last_in_it()) return undefined();
    return literal(access, (pc() & ~3U) + (field(hw1, 7, 1) != 0 ? offset : 0U - offset));
  }
  if (!is_load && out_.rd == kPc) return undefined();
  if (out_.rd == kSp && !is_word) return undefined();
  // A load into PC is a branch, which may only end an IT block.
  if (is_load && out_.rd == kPc && is_word && in_it() && !last_in_it()) return undefined();
  if (field(hw1, 7, 1) != 0) {
    out_.imm = field(hw2, 0, 12);
    return is_hint ? put<&ops::nop>() : put_load_store<Mode::kOffset>(access, is_load);
  }
  if (field(hw2, 11, 1) == 0) {
    if (field(hw2, 6, 5) != 0) return undefined();
    rm(field(hw2, 0, 4));
    extra(field(hw2, 4, 2));
    if (is_sp_or_pc(out_.rm)) return undefined();
    return is_hint ? put<&ops::nop>() : put_load_store<Mode::kRegister>(access, is_load);
  }
  const bool pre_index = field(hw2, 10, 1) != 0;
  const bool add = field(hw2, 9, 1) != 0;
  const bool write_back = field(hw2, 8, 1) != 0;
  if (!pre_index && !write_back) return undefined();
  const std::uint32_t offset = field(hw2, 0, 8);
  out_.imm = add ? offset : 0U - offset;
  if (write_back) {
    if (out_.rn == out_.rd || is_hint) return undefined();
    return pre_index ? put_load_store<Mode::kPre>(access, is_load)
                     : put_load_store<Mode::kPost>(access, is_load);
  }
  if (is_hint) return put<&ops::nop>();
  // P = U = 1 with W = 0 is the unprivileged form (LDRT, STRT).
  if (add && is_sp_or_pc(out_.rd)) return undefined();
  put_load_store<Mode::kOffset>(access, is_load);
}

// Branches and control (A5.3.4). B (T4) and BL have offsets of 25 bits, B<c> (T3) of 21; the names
// S, J1, J2, I1, I2 are the manual's (A7.7.12).
void Decoder::branches(std::uint32_t hw1, std::uint32_t hw2) {
  const std::uint32_t s = field(hw1, 10, 1);
  const std::uint32_t j1 = field(hw2, 13, 1);
  const std::uint32_t j2 = field(hw2, 11, 1);
  const bool wide = field(hw2, 12, 1) != 0;  // T4 or BL: no condition
  const bool link = field(hw2, 14, 1) != 0;
  if (wide) {
    const std::uint32_t i1 = 1U ^ (j1 ^ s);
    const std::uint32_t i2 = 1U ^ (j2 ^ s);
    const std::uint32_t offset =
        (s << 24) | (i1 << 23) | (i2 << 22) | (field(hw1, 0, 10) << 12) | (field(hw2, 0, 11) << 1);
    if (in_it() && !last_in_it()) return undefined();
    return branch_to(pc() + sign_extend(offset, 25), link);
  }
  if (link) return undefined();                         // BLX to ARM code, or permanently undefined
  if (field(hw1, 7, 3) == 7) return control(hw1, hw2);  // no condition: 111x is not one
  const std::uint32_t offset =
      (s << 20) | (j2 << 19) | (j1 << 18) | (field(hw1, 0, 6) << 12) | (field(hw2, 0, 11) << 1);
  branch_to_if(field(hw1, 6, 4), pc() + sign_extend(offset, 21));
}

// MSR and MRS, 32-bit hints (A5.3.4), CLREX and barriers. A barrier only takes its time: the model
// finishes each access before the next instruction.
void Decoder::control(std::uint32_t hw1, std::uint32_t hw2) {
  switch (field(hw1, 4, 7)) {
    case 0x38:
    case 0x39:
    case 0x3E:
    case 0x3F:  // MSR (0x38, 0x39) and MRS
      return special_register(hw1, hw2);
    case 0x3A:  // hints: WFE, WFI, SEV, NOP
      if (field(hw2, 8, 3) != 0 || field(hw1, 0, 4) != 15) return undefined();
      switch (field(hw2, 0, 8)) {
        case 2:
          return put<&ops::wait_for_event>();
        case 3:
          return put<&ops::wait_for_interrupt>();
        case 4:
          return put<&ops::send_event>();
        default:
          return put<&ops::nop>();
      }
    case 0x3B:  // miscellaneous control
      switch (field(hw2, 4, 4)) {
        case 2:  // CLREX
          return put<&ops::clear_exclusive>();
        case 4:
        case 5:
        case 6:  // DSB, DMB, ISB
          cycles(3);
          return put<&ops::nop>();
        default:
          return undefined();
      }
    default:
      return undefined();
  }
}

// MRS (rd = special register) and MSR (special register = rn). `imm` is SYSm, the register's
// number; for MSR, `ra` is the mask of the parts to write.
void Decoder::special_register(std::uint32_t hw1, std::uint32_t hw2) {
  out_.imm = field(hw2, 0, 8);
  cycles(2);
  if (field(hw1, 5, 2) == 3) {
    rd(field(hw2, 8, 4));
    if (is_sp_or_pc(out_.rd) || field(hw1, 0, 4) != 15) return undefined();
    return put<&ops::move_from_special>();
  }
  rn(field(hw1, 0, 4));
  ra(field(hw2, 8, 4));
  if (is_sp_or_pc(out_.rn)) return undefined();
  put<&ops::move_to_special>();
}

// The operations that immediates (A5.3.1) and shifted registers (A5.3.11) share, by the field `op`.
// With d = 15 and the flags set, an operation only compares; with n = 15, ORR and ORN are MOV and
// MVN.
void Decoder::data_processing32(std::uint32_t op, bool flags, Op2 op2, std::uint32_t d,
                                std::uint32_t n) {
  rd(d);
  rn(n);
  // ADD and SUB may use the stack pointer; nothing else may.
  const bool sp_allowed = (op == 8 || op == 13) && n == kSp;
  if (d == kSp && !sp_allowed) return undefined();
  if (n == kSp && op != 8 && op != 13) return undefined();
  const bool compare = d == kPc && flags;
  if (d == kPc && !compare) return undefined();
  if (n == kPc && op != 2 && op != 3) return undefined();
  switch (op) {
    case 0:  // AND, TST
      return compare ? put_op2<Alu::kTst>(op2, kSetFlags) : put_op2<Alu::kAnd>(op2, flags);
    case 1:  // BIC
      return d == kPc ? undefined() : put_op2<Alu::kBic>(op2, flags);
    case 2:  // ORR, MOV
      if (d == kPc) return undefined();
      return n == kPc ? put_op2<Alu::kMov>(op2, flags) : put_op2<Alu::kOrr>(op2, flags);
    case 3:  // ORN, MVN
      if (d == kPc) return undefined();
      return n == kPc ? put_op2<Alu::kMvn>(op2, flags) : put_op2<Alu::kOrn>(op2, flags);
    case 4:  // EOR, TEQ
      return compare ? put_op2<Alu::kTeq>(op2, kSetFlags) : put_op2<Alu::kEor>(op2, flags);
    case 8:  // ADD, CMN
      return compare ? put_op2<Alu::kCmn>(op2, kSetFlags) : put_op2<Alu::kAdd>(op2, flags);
    case 10:
      return d == kPc ? undefined() : put_op2<Alu::kAdc>(op2, flags);
    case 11:
      return d == kPc ? undefined() : put_op2<Alu::kSbc>(op2, flags);
    case 13:  // SUB, CMP
      return compare ? put_op2<Alu::kCmp>(op2, kSetFlags) : put_op2<Alu::kSub>(op2, flags);
    case 14:
      return d == kPc ? undefined() : put_op2<Alu::kRsb>(op2, flags);
    default:
      return undefined();
  }
}

// Data processing with a shifted register as second operand (A5.3.11); `amount` is imm3:imm2.
void Decoder::shifted_register(std::uint32_t hw1, std::uint32_t hw2) {
  const std::uint32_t op = field(hw1, 5, 4);
  const std::uint32_t n = field(hw1, 0, 4);
  const std::uint32_t d = field(hw2, 8, 4);
  const bool flags = field(hw1, 4, 1) != 0;
  const std::uint32_t amount = (field(hw2, 12, 3) << 2) | field(hw2, 6, 2);
  rm(field(hw2, 0, 4));
  const bool is_move = op == 2 && n == kPc;
  if (field(hw2, 15, 1) != 0 || op == 6) return undefined();
  // MOV.W (register) without shift may read or write the stack pointer.
  if (is_move && !flags && amount == 0 && field(hw2, 4, 2) == 0 && d != kPc && out_.rm != kPc &&
      !(d == kSp && out_.rm == kSp)) {
    rd(d);
    return put_alu<Alu::kMov, Op2::kReg>(kKeepFlags);
  }
  if (is_sp_or_pc(out_.rm)) return undefined();
  // With the stack pointer as result only LSL by up to 3 is defined.
  if (d == kSp && (field(hw2, 4, 2) != 0 || amount > 3)) return undefined();
  data_processing32(op, flags, immediate_shift(field(hw2, 4, 2), amount), d, n);
}

// Data processing with a modified immediate (A5.3.1 and A5.3.2): imm12 is a byte that is repeated
// in a pattern, or a byte with its top bit set that is rotated right by imm12<11:7>. The rotation
// also gives the carry.
void Decoder::modified_immediate(std::uint32_t hw1, std::uint32_t hw2) {
  const std::uint32_t imm12 =
      (field(hw1, 10, 1) << 11) | (field(hw2, 12, 3) << 8) | field(hw2, 0, 8);
  const std::uint32_t low = imm12 & 0xFFU;
  Op2 op2 = Op2::kImm;
  if ((imm12 >> 10) == 0) {
    if (imm12 >= 0x100 && low == 0) return undefined();  // UNPREDICTABLE
    switch (imm12 >> 8) {
      case 0:  // 000000XY
        out_.imm = low;
        break;
      case 1:  // 00XY00XY
        out_.imm = low | (low << 16);
        break;
      case 2:  // XY00XY00
        out_.imm = (low << 8) | (low << 24);
        break;
      default:  // XYXYXYXY
        out_.imm = low | (low << 8) | (low << 16) | (low << 24);
        break;
    }
  } else {
    out_.imm = ops::rotate_right(0x80U | (imm12 & 0x7FU), imm12 >> 7);
    op2 = Op2::kImmCarry;
  }
  data_processing32(field(hw1, 5, 4), field(hw1, 4, 1) != 0, op2, field(hw2, 8, 4),
                    field(hw1, 0, 4));
}

// Plain binary immediate (A5.3.3), by op: 0 ADDW, 10 SUBW (with PC: ADR), 4 MOVW, 12 MOVT, 16 and
// 18 SSAT, 24 and 26 USAT, 20 SBFX, 28 UBFX, 22 BFI and BFC.
void Decoder::plain_immediate(std::uint32_t hw1, std::uint32_t hw2) {
  const std::uint32_t op = field(hw1, 4, 5);
  const std::uint32_t n = field(hw1, 0, 4);
  const std::uint32_t imm12 =
      (field(hw1, 10, 1) << 11) | (field(hw2, 12, 3) << 8) | field(hw2, 0, 8);
  // imm3:imm2 and imm5: a shift amount or lowest bit, and a width or highest bit.
  const std::uint32_t low_bit = (field(hw2, 12, 3) << 2) | field(hw2, 6, 2);
  const std::uint32_t width = field(hw2, 0, 5);
  rd(field(hw2, 8, 4));
  rn(n);
  const bool sp_result = out_.rd == kSp && n == kSp && (op == 0 || op == 10);
  if (is_sp_or_pc(out_.rd) && !sp_result) return undefined();
  switch (op) {
    case 0:
    case 10:  // ADDW, SUBW
      if (n == kPc) {
        out_.imm = op == 0 ? (pc() & ~3U) + imm12 : (pc() & ~3U) - imm12;
        return put_alu<Alu::kMov, Op2::kImm>(kKeepFlags);
      }
      out_.imm = imm12;
      return op == 0 ? put_alu<Alu::kAdd, Op2::kImm>(kKeepFlags)
                     : put_alu<Alu::kSub, Op2::kImm>(kKeepFlags);
    case 4:  // MOVW
      out_.imm = (n << 12) | imm12;
      return put_alu<Alu::kMov, Op2::kImm>(kKeepFlags);
    case 12:  // MOVT
      out_.imm = (n << 12) | imm12;
      return put<&ops::move_top>();
    case 16:
    case 18:
    case 24:
    case 26: {  // SSAT, USAT
      const bool arithmetic = (op & 2U) != 0;
      // Without a shift amount, bit 1 of the opcode means SSAT16 and USAT16: DSP extension.
      if ((arithmetic && low_bit == 0) || is_sp_or_pc(n)) return undefined();
      ra(arithmetic ? 1 : 0);
      extra(low_bit);
      if (op < 20) {
        out_.imm = (1U << width) - 1U;
        return put<&ops::saturate<true>>();
      }
      out_.imm = static_cast<std::uint32_t>((std::uint64_t{1} << width) - 1U);
      return put<&ops::saturate<false>>();
    }
    case 20:
    case 28:  // SBFX, UBFX; `width` is one less than the number of bits
      if (low_bit + width > 31 || is_sp_or_pc(n)) return undefined();
      extra(low_bit);
      out_.imm = width == 31 ? ~0U : (2U << width) - 1U;
      return op == 20 ? put<&ops::bit_field_signed>() : put<&ops::bit_field_unsigned>();
    case 22: {  // BFI, BFC; here `width` is the highest bit
      if (width < low_bit || n == kSp) return undefined();
      const std::uint32_t bits = width - low_bit;
      extra(low_bit);
      out_.imm = bits == 31 ? ~0U : (2U << bits) - 1U;
      return put<&ops::bit_field_insert>();
    }
    default:
      return undefined();
  }
}

// Register operations (A5.3.12): shifts, extensions, reversals of bytes and bits, CLZ.
void Decoder::register_operations(std::uint32_t hw1, std::uint32_t hw2) {
  using ops::Extend;
  using ops::Shift;
  using ops::Unary;
  const std::uint32_t op1 = field(hw1, 4, 4);
  const std::uint32_t op2 = field(hw2, 4, 4);
  rd(field(hw2, 8, 4));
  rn(field(hw1, 0, 4));
  rm(field(hw2, 0, 4));
  if (field(hw2, 12, 4) != 15 || is_sp_or_pc(out_.rd) || is_sp_or_pc(out_.rm)) return undefined();
  if (op1 < 8 && op2 == 0) {  // shift by a register; bit 0 of op1 sets the flags
    if (is_sp_or_pc(out_.rn)) return undefined();
    switch (op1) {
      case 0:
        return put<&ops::shift_by_register<Shift::kLsl, kKeepFlags>>();
      case 1:
        return put<&ops::shift_by_register<Shift::kLsl, kSetFlags>>();
      case 2:
        return put<&ops::shift_by_register<Shift::kLsr, kKeepFlags>>();
      case 3:
        return put<&ops::shift_by_register<Shift::kLsr, kSetFlags>>();
      case 4:
        return put<&ops::shift_by_register<Shift::kAsr, kKeepFlags>>();
      case 5:
        return put<&ops::shift_by_register<Shift::kAsr, kSetFlags>>();
      case 6:
        return put<&ops::shift_by_register<Shift::kRor, kKeepFlags>>();
      default:
        return put<&ops::shift_by_register<Shift::kRor, kSetFlags>>();
    }
  }
  if (op1 < 8 && (op2 & 8U) != 0 && (op2 & 4U) == 0) {  // extensions
    // With a base register these are the DSP extension's extend-and-add.
    if (out_.rn != kPc) return undefined();
    extra(8 * field(hw2, 4, 2));  // the source is rotated by whole bytes
    switch (op1) {
      case 0:
        return put<&ops::extend<Extend::kSxth>>();
      case 1:
        return put<&ops::extend<Extend::kUxth>>();
      case 4:
        return put<&ops::extend<Extend::kSxtb>>();
      case 5:
        return put<&ops::extend<Extend::kUxtb>>();
      default:
        return undefined();
    }
  }
  if (op1 == 9 && (op2 & 0xCU) == 8) {
    // The encoding holds rm twice.
    if (out_.rn != out_.rm) return undefined();
    switch (op2 & 3U) {
      case 0:
        return put<&ops::unary<Unary::kRev>>();
      case 1:
        return put<&ops::unary<Unary::kRev16>>();
      case 2:
        return put<&ops::unary<Unary::kRbit>>();
      default:
        return put<&ops::unary<Unary::kRevsh>>();
    }
  }
  if (op1 == 11 && op2 == 8) {
    if (out_.rn != out_.rm) return undefined();
    return put<&ops::unary<Unary::kClz>>();
  }
  undefined();
}

// MUL, MLA and MLS (A5.3.16); ra = 15 means that nothing is added.
void Decoder::multiply32(std::uint32_t hw1, std::uint32_t hw2) {
  rd(field(hw2, 8, 4));
  rn(field(hw1, 0, 4));
  rm(field(hw2, 0, 4));
  ra(field(hw2, 12, 4));
  if (field(hw1, 4, 3) != 0 || field(hw2, 6, 2) != 0 || is_sp_or_pc(out_.rd) ||
      is_sp_or_pc(out_.rn) || is_sp_or_pc(out_.rm)) {
    return undefined();
  }
  cycles(2);
  const std::uint32_t op = field(hw2, 4, 2);
  if (op == 0 && out_.ra == kPc) {
    cycles(1);
    return put<&ops::multiply<kKeepFlags>>();
  }
  if (op > 1 || is_sp_or_pc(out_.ra)) return undefined();
  op == 0 ? put<&ops::multiply_add>() : put<&ops::multiply_subtract>();
}

// SDIV and UDIV, and multiplications with a result of 64 bits: SMULL (op1 0), UMULL (2), SMLAL (4),
// UMLAL (6). See A5.3.17.
void Decoder::multiply_long32(std::uint32_t hw1, std::uint32_t hw2) {
  const std::uint32_t op1 = field(hw1, 4, 3);
  const std::uint32_t op2 = field(hw2, 4, 4);
  rn(field(hw1, 0, 4));
  rm(field(hw2, 0, 4));
  if (is_sp_or_pc(out_.rn) || is_sp_or_pc(out_.rm)) return undefined();
  if ((op1 == 1 || op1 == 3) && op2 == 15) {
    rd(field(hw2, 8, 4));
    if (field(hw2, 12, 4) != 15 || is_sp_or_pc(out_.rd)) return undefined();
    cycles(2);  // the shortest division; the handler adds the others' cycles
    return op1 == 1 ? put<&ops::divide<true>>() : put<&ops::divide<false>>();
  }
  rd(field(hw2, 12, 4));
  ra(field(hw2, 8, 4));
  if (op2 != 0 || is_sp_or_pc(out_.rd) || is_sp_or_pc(out_.ra) || out_.rd == out_.ra)
    return undefined();
  cycles(op1 >= 4 ? 5 : 4);
  switch (op1) {
    case 0:
      return put<&ops::multiply_long<true, false>>();
    case 2:
      return put<&ops::multiply_long<false, false>>();
    case 4:
      return put<&ops::multiply_long<true, true>>();
    case 6:
      return put<&ops::multiply_long<false, true>>();
    default:
      return undefined();
  }
}

}  // namespace due_emulator
