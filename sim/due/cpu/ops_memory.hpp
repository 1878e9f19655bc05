// Handlers of loads and stores. A handler executes the decoded instruction `i` on the processor `c`
// and returns the next instruction. An access that fails throws Fault before a register changes.
#pragma once

#include <cstdint>
#include <cstring>

#include "cpu/cpu.hpp"
#include "cpu/ops_data.hpp"

namespace due_emulator::ops {

// Address: rn + imm, the same with write-back before (pre-indexed) or after the access
// (post-indexed), or rn + (rm << extra).
enum class Mode : std::uint8_t { kOffset, kPre, kPost, kRegister };

// The address of the access; see Mode.
template <Mode kMode>
inline std::uint32_t address_of(const Cpu& c, const Insn* i) {
  if constexpr (kMode == Mode::kPost) return c.r[i->rn];
  if constexpr (kMode == Mode::kRegister) return c.r[i->rn] + (c.r[i->rm] << i->extra);
  return c.r[i->rn] + i->imm;
}

// Gives the base register its new value, in the indexed modes.
template <Mode kMode>
inline void write_back(Cpu& c, const Insn* i) {
  if constexpr (kMode == Mode::kPre || kMode == Mode::kPost) {
    c.r[i->rn] += i->imm;
    if (i->rn == kSp) c.r[kSp] &= ~3U;
  }
}

// Sign extension of a byte or halfword that was loaded.
template <typename T, bool kSigned>
inline std::uint32_t widen(std::uint32_t raw) {
  if constexpr (kSigned && sizeof(T) == 1) {
    return static_cast<std::uint32_t>(static_cast<std::int8_t>(raw));
  }
  if constexpr (kSigned && sizeof(T) == 2) {
    return static_cast<std::uint32_t>(static_cast<std::int16_t>(raw));
  }
  return raw;
}

// LDR, LDRB, LDRH, LDRSB, LDRSH.
template <typename T, bool kSigned, Mode kMode>
const Insn* load(Cpu& c, const Insn* i) {
  const std::uint32_t raw = c.load<T>(address_of<kMode>(c, i));
  write_back<kMode>(c, i);
  c.r[i->rd] = widen<T, kSigned>(raw);
  return next(i);
}

// LDR into PC, which branches.
template <Mode kMode>
const Insn* load_pc(Cpu& c, const Insn* i) {
  const std::uint32_t address = address_of<kMode>(c, i);
  c.require_aligned(address, 4);
  const std::uint32_t target = c.load<std::uint32_t>(address);
  write_back<kMode>(c, i);
  return c.branch_exchange(target);
}

// STR, STRB, STRH.
template <typename T, Mode kMode>
const Insn* store(Cpu& c, const Insn* i) {
  const std::uint32_t value = c.r[i->rd];
  c.store<T>(address_of<kMode>(c, i), value);
  write_back<kMode>(c, i);
  return next(i);
}

// PC-relative loads; the address is known when the instruction is decoded.
template <typename T, bool kSigned>
const Insn* load_literal(Cpu& c, const Insn* i) {
  c.r[i->rd] = widen<T, kSigned>(c.load<T>(i->imm));
  return next(i);
}

inline const Insn* load_literal_pc(Cpu& c, const Insn* i) {
  return c.branch_exchange(c.load<std::uint32_t>(i->imm));
}

// LDRD: two words into rd and ra.
template <Mode kMode>
const Insn* load_double(Cpu& c, const Insn* i) {
  const std::uint32_t address = address_of<kMode>(c, i);
  c.require_aligned(address, 4);
  const std::uint32_t first = c.load<std::uint32_t>(address);
  const std::uint32_t second = c.load<std::uint32_t>(address + 4);
  write_back<kMode>(c, i);
  c.r[i->rd] = first;
  c.r[i->ra] = second;
  return next(i);
}

// LDRD relative to PC.
inline const Insn* load_double_literal(Cpu& c, const Insn* i) {
  const std::uint32_t first = c.load<std::uint32_t>(i->imm);
  c.r[i->ra] = c.load<std::uint32_t>(i->imm + 4);
  c.r[i->rd] = first;
  return next(i);
}

// STRD.
template <Mode kMode>
const Insn* store_double(Cpu& c, const Insn* i) {
  const std::uint32_t address = address_of<kMode>(c, i);
  c.require_aligned(address, 4);
  c.store<std::uint32_t>(address, c.r[i->rd]);
  c.store<std::uint32_t>(address + 4, c.r[i->ra]);
  write_back<kMode>(c, i);
  return next(i);
}

// Register lists are in `imm`, bit n for rn, and their bytes in `extra`. `ra` is 1 when the base
// register is written back.
template <bool kDecrementBefore>
inline void write_back_multiple(Cpu& c, const Insn* i) {
  c.r[i->rn] += kDecrementBefore ? 0U - i->extra : i->extra;
  if (i->rn == kSp) c.r[kSp] &= ~3U;
}

// LDM and POP, in ascending order of registers and addresses. Bit 15 of the list is PC, which
// branches; it comes last.
template <bool kDecrementBefore>
const Insn* load_multiple(Cpu& c, const Insn* i) {
  const std::uint32_t list = i->imm;
  const std::uint32_t bytes = i->extra;
  const std::uint32_t base = c.r[i->rn];
  std::uint32_t address = kDecrementBefore ? base - bytes : base;
  c.require_aligned(address, 4);
  if (const std::uint8_t* from = c.ram_at(address, bytes)) {
    if (i->ra != 0) write_back_multiple<kDecrementBefore>(c, i);
    for (std::uint32_t left = list & 0x7FFFU; left != 0; left &= left - 1) {
      std::memcpy(&c.r[__builtin_ctz(left)], from, 4);
      from += 4;
    }
    if ((list & 0x8000U) == 0) return next(i);
    std::uint32_t target = 0;
    std::memcpy(&target, from, 4);
    return c.branch_exchange(target);
  }
  // Elsewhere a load may fault: nothing is written before all are done.
  std::uint32_t values[16];
  unsigned count = 0;
  for (std::uint32_t left = list; left != 0; left &= left - 1) {
    values[count++] = c.load<std::uint32_t>(address);
    address += 4;
  }
  if (i->ra != 0) write_back_multiple<kDecrementBefore>(c, i);
  count = 0;
  for (std::uint32_t left = list & 0x7FFFU; left != 0; left &= left - 1) {
    c.r[__builtin_ctz(left)] = values[count++];
  }
  if ((list & 0x8000U) != 0) return c.branch_exchange(values[count]);
  return next(i);
}

// STM and PUSH. The usual case is SRAM that holds no decoded code, and is copied directly.
template <bool kDecrementBefore>
const Insn* store_multiple(Cpu& c, const Insn* i) {
  const std::uint32_t base = c.r[i->rn];
  std::uint32_t address = kDecrementBefore ? base - i->extra : base;
  c.require_aligned(address, 4);
  if (std::uint8_t* to = c.ram_without_code(address, i->extra)) {
    for (std::uint32_t left = i->imm; left != 0; left &= left - 1) {
      std::memcpy(to, &c.r[__builtin_ctz(left)], 4);
      to += 4;
    }
  } else {
    for (std::uint32_t left = i->imm; left != 0; left &= left - 1) {
      c.store<std::uint32_t>(address, c.r[__builtin_ctz(left)]);
      address += 4;
    }
  }
  if (i->ra != 0) write_back_multiple<kDecrementBefore>(c, i);
  return next(i);
}

// LDREX and the like: notes the address in the local monitor.
template <typename T>
const Insn* load_exclusive(Cpu& c, const Insn* i) {
  const std::uint32_t address = c.r[i->rn] + i->imm;
  c.require_aligned(address, sizeof(T));
  c.r[i->rd] = c.load<T>(address);
  c.exclusive = true;
  c.exclusive_address = address;
  return next(i);
}

// STREX and the like: stores only if the monitor still holds this address. `ra` takes the result: 0
// if the store was done, otherwise 1.
template <typename T>
const Insn* store_exclusive(Cpu& c, const Insn* i) {
  const std::uint32_t address = c.r[i->rn] + i->imm;
  c.require_aligned(address, sizeof(T));
  const bool pass = c.exclusive && c.exclusive_address == address;
  if (pass) c.store<T>(address, c.r[i->rd]);
  c.exclusive = false;
  c.r[i->ra] = pass ? 0U : 1U;
  return next(i);
}

inline const Insn* clear_exclusive(Cpu& c, const Insn* i) {
  c.exclusive = false;
  return next(i);
}

}  // namespace due_emulator::ops
