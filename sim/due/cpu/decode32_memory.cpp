// 32-bit Thumb encodings of loads, stores, branches and control (ARMv7-M A5.3).
#include "cpu/decoder.hpp"

namespace due_emulator {

using ops::Mode;

namespace {

std::uint32_t field(std::uint32_t w, unsigned low, unsigned bits) {
  return (w >> low) & ((1U << bits) - 1U);
}

std::uint32_t sign_extend(std::uint32_t value, unsigned bits) {
  const std::uint32_t sign = 1U << (bits - 1);
  return (value ^ sign) - sign;
}

bool bad(std::uint32_t reg) { return reg == 13 || reg == 15; }

}  // namespace

void Decoder::decode32(std::uint32_t a, std::uint32_t b) {
  const std::uint32_t op1 = field(a, 11, 2);
  if (op1 == 1) {
    if (field(a, 9, 2) == 0) return field(a, 6, 1) == 0 ? multiple32(a, b) : double_exclusive(a, b);
    if (field(a, 9, 2) == 1) return shifted_register(a, b);
    return put<&ops::no_coprocessor>();
  }
  if (op1 == 2) {
    if (field(b, 15, 1) != 0) return branches(a, b);
    return field(a, 9, 1) == 0 ? modified_immediate(a, b) : plain_immediate(a, b);
  }
  if (field(a, 10, 1) != 0) return put<&ops::no_coprocessor>();
  if (field(a, 9, 1) == 0) return load_store32(a, b);
  if (field(a, 8, 1) == 0) return register_operations(a, b);
  return field(a, 7, 1) == 0 ? multiply32(a, b) : multiply_long32(a, b);
}

void Decoder::multiple32(std::uint32_t a, std::uint32_t b) {
  const std::uint32_t op = field(a, 7, 2);
  const bool is_load = field(a, 4, 1) != 0;
  const bool write_back = field(a, 5, 1) != 0;
  rn(field(a, 0, 4));
  ra(write_back ? 1 : 0);
  const bool base_in_list = ((b >> out_.rn) & 1U) != 0;
  const bool with_pc = (b & 0x8000U) != 0;
  const bool single = (b & (b - 1U)) == 0;
  registers(b, 1U + (with_pc ? taken_cycles(~0U) : 0U));
  if ((op != 1 && op != 2) || out_.rn == 15 || single || (b & 0x2000U) != 0 ||
      (write_back && base_in_list)) {
    return undefined();
  }
  if (is_load ? (b & 0xC000U) == 0xC000U : with_pc) return undefined();
  if (with_pc && in_it() && !last_in_it()) return undefined();
  if (is_load) {
    return op == 1 ? put<&ops::load_multiple<false>>() : put<&ops::load_multiple<true>>();
  }
  op == 1 ? put<&ops::store_multiple<false>>() : put<&ops::store_multiple<true>>();
}

void Decoder::double_exclusive(std::uint32_t a, std::uint32_t b) {
  const std::uint32_t op1 = field(a, 7, 2);
  const std::uint32_t op2 = field(a, 4, 2);
  const bool is_load = (op2 & 1U) != 0;
  rn(field(a, 0, 4));
  rd(field(b, 12, 4));
  if ((op1 & 2U) != 0 || (op2 & 2U) != 0) {
    // LDRD and STRD; P is bit 8, U bit 7, W bit 5 of the first halfword.
    const std::uint32_t offset = field(b, 0, 8) * 4;
    const bool add = field(a, 7, 1) != 0;
    const bool pre = field(a, 8, 1) != 0;
    const bool write = field(a, 5, 1) != 0;
    ra(field(b, 8, 4));
    cycles(3);
    if (bad(out_.rd) || bad(out_.ra)) return undefined();
    if (write && (out_.rn == out_.rd || out_.rn == out_.ra || out_.rn == 15)) return undefined();
    if (is_load && out_.rd == out_.ra) return undefined();
    if (out_.rn == 15) {
      out_.imm = (pc() & ~3U) + (add ? offset : 0U - offset);
      return is_load ? put<&ops::load_double_literal>() : undefined();
    }
    out_.imm = add ? offset : 0U - offset;
    if (!pre) {
      return is_load ? put<&ops::load_double<Mode::kPost>>()
                     : put<&ops::store_double<Mode::kPost>>();
    }
    if (write) {
      return is_load ? put<&ops::load_double<Mode::kPre>>() : put<&ops::store_double<Mode::kPre>>();
    }
    return is_load ? put<&ops::load_double<Mode::kOffset>>()
                   : put<&ops::store_double<Mode::kOffset>>();
  }
  cycles(2);
  if (op1 == 0) {
    out_.imm = field(b, 0, 8) * 4;
    if (out_.rn == 15 || bad(out_.rd)) return undefined();
    if (is_load) {
      return field(b, 8, 4) == 15 ? put<&ops::load_exclusive<std::uint32_t>>() : undefined();
    }
    ra(field(b, 8, 4));
    if (bad(out_.ra) || out_.ra == out_.rd || out_.ra == out_.rn) return undefined();
    return put<&ops::store_exclusive<std::uint32_t>>();
  }
  const std::uint32_t op3 = field(b, 4, 4);
  if (op3 <= 1) {
    if (!is_load || out_.rn == 13 || field(b, 8, 8) != 0xF0U) return undefined();
    rm(field(b, 0, 4));
    if (bad(out_.rm) || (in_it() && !last_in_it())) return undefined();
    out_.imm = pc();
    cycles(2U + taken_cycles(~0U));
    return op3 == 0 ? put<&ops::table_branch<std::uint8_t>>()
                    : put<&ops::table_branch<std::uint16_t>>();
  }
  if ((op3 != 4 && op3 != 5) || field(b, 8, 4) != 15 || out_.rn == 15 || bad(out_.rd)) {
    return undefined();
  }
  if (is_load) {
    if (field(b, 0, 4) != 15) return undefined();
    return op3 == 4 ? put<&ops::load_exclusive<std::uint8_t>>()
                    : put<&ops::load_exclusive<std::uint16_t>>();
  }
  ra(field(b, 0, 4));
  if (bad(out_.ra) || out_.ra == out_.rd || out_.ra == out_.rn) return undefined();
  op3 == 4 ? put<&ops::store_exclusive<std::uint8_t>>()
           : put<&ops::store_exclusive<std::uint16_t>>();
}

void Decoder::load_store32(std::uint32_t a, std::uint32_t b) {
  const std::uint32_t size_field = field(a, 5, 2);
  const bool is_load = field(a, 4, 1) != 0;
  const bool sign = field(a, 8, 1) != 0;
  const std::uint32_t size = 1U << size_field;
  if (size_field == 3 || (sign && (!is_load || size == 4))) return undefined();
  rd(field(b, 12, 4));
  rn(field(a, 0, 4));
  // A byte or halfword load into PC is a hint: PLD, PLI or a reserved one.
  const bool hint = is_load && size != 4 && out_.rd == 15;
  if (out_.rn == 15) {
    if (!is_load) return undefined();
    const std::uint32_t offset = field(b, 0, 12);
    if (hint) return put<&ops::nop>();
    if (out_.rd == 13 && size != 4) return undefined();
    if (out_.rd == 15 && in_it() && !last_in_it()) return undefined();
    return literal(size, sign, (pc() & ~3U) + (field(a, 7, 1) != 0 ? offset : 0U - offset));
  }
  if (!is_load && out_.rd == 15) return undefined();
  if (out_.rd == 13 && size != 4) return undefined();
  if (is_load && out_.rd == 15 && size == 4 && in_it() && !last_in_it()) return undefined();
  if (field(a, 7, 1) != 0) {
    out_.imm = field(b, 0, 12);
    return hint ? put<&ops::nop>() : put_load_store<Mode::kOffset>(size, sign, is_load);
  }
  if (field(b, 11, 1) == 0) {
    if (field(b, 6, 5) != 0) return undefined();
    rm(field(b, 0, 4));
    extra(field(b, 4, 2));
    if (bad(out_.rm)) return undefined();
    return hint ? put<&ops::nop>() : put_load_store<Mode::kRegister>(size, sign, is_load);
  }
  const bool pre = field(b, 10, 1) != 0;
  const bool add = field(b, 9, 1) != 0;
  const bool write = field(b, 8, 1) != 0;
  if (!pre && !write) return undefined();
  const std::uint32_t offset = field(b, 0, 8);
  out_.imm = add ? offset : 0U - offset;
  if (write) {
    if (out_.rn == out_.rd || hint) return undefined();
    return pre ? put_load_store<Mode::kPre>(size, sign, is_load)
               : put_load_store<Mode::kPost>(size, sign, is_load);
  }
  if (hint) return put<&ops::nop>();
  // P = U = 1 with W = 0 is the unprivileged form (LDRT, STRT).
  if (add && bad(out_.rd)) return undefined();
  put_load_store<Mode::kOffset>(size, sign, is_load);
}

void Decoder::branches(std::uint32_t a, std::uint32_t b) {
  const std::uint32_t s = field(a, 10, 1);
  const std::uint32_t j1 = field(b, 13, 1);
  const std::uint32_t j2 = field(b, 11, 1);
  const bool wide = field(b, 12, 1) != 0;
  const bool link = field(b, 14, 1) != 0;
  if (wide) {
    const std::uint32_t i1 = 1U ^ (j1 ^ s);
    const std::uint32_t i2 = 1U ^ (j2 ^ s);
    const std::uint32_t offset =
        (s << 24) | (i1 << 23) | (i2 << 22) | (field(a, 0, 10) << 12) | (field(b, 0, 11) << 1);
    if (in_it() && !last_in_it()) return undefined();
    return branch_to(pc() + sign_extend(offset, 25), link);
  }
  if (link) return undefined();  // BLX to ARM code, or permanently undefined
  if (field(a, 7, 3) == 7) return control(a, b);
  const std::uint32_t offset =
      (s << 20) | (j2 << 19) | (j1 << 18) | (field(a, 0, 6) << 12) | (field(b, 0, 11) << 1);
  branch_to_if(field(a, 6, 4), pc() + sign_extend(offset, 21));
}

void Decoder::control(std::uint32_t a, std::uint32_t b) {
  switch (field(a, 4, 7)) {
    case 0x38:
    case 0x39:
    case 0x3E:
    case 0x3F:
      return special_register(a, b);
    case 0x3A:
      if (field(b, 8, 3) != 0 || field(a, 0, 4) != 15) return undefined();
      switch (field(b, 0, 8)) {
        case 2:
          return put<&ops::wait_for_event>();
        case 3:
          return put<&ops::wait_for_interrupt>();
        case 4:
          return put<&ops::send_event>();
        default:
          return put<&ops::nop>();
      }
    case 0x3B:
      switch (field(b, 4, 4)) {
        case 2:
          return put<&ops::clear_exclusive>();
        case 4:
        case 5:
        case 6:
          cycles(3);
          return put<&ops::nop>();
        default:
          return undefined();
      }
    default:
      return undefined();
  }
}

void Decoder::special_register(std::uint32_t a, std::uint32_t b) {
  out_.imm = field(b, 0, 8);
  cycles(2);
  if (field(a, 5, 2) == 3) {
    rd(field(b, 8, 4));
    if (bad(out_.rd) || field(a, 0, 4) != 15) return undefined();
    return put<&ops::move_from_special>();
  }
  rn(field(a, 0, 4));
  ra(field(b, 8, 4));
  if (bad(out_.rn)) return undefined();
  put<&ops::move_to_special>();
}

}  // namespace due_emulator
