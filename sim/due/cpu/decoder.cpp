// What all encodings share: branches, literals, shifts, and their place in the cycle model.
#include "cpu/decoder.hpp"

#include <array>
#include <utility>

namespace due_emulator {

using ops::Alu;
using ops::Op2;

namespace {

// Pipeline refill after a taken branch: 1 to 3 cycles in the reference manual.
constexpr std::uint32_t kRefill = 2;

}  // namespace

// Decodes the instruction at `address` in the window's bytes.
Decoder::Decoder(const Cpu& cpu, const CodeWindow& window, std::uint32_t address, std::uint8_t it)
    : cpu_(cpu), window_(window), address_(address), it_(it) {
  const std::uint8_t* bytes = window.bytes() + (address - window.base());
  const auto first = static_cast<std::uint32_t>(bytes[0] | (bytes[1] << 8));
  out_.it = it;
  out_.length = 1;
  out_.cycles = 1;
  // Halfwords from 0xE800 on begin a 32-bit instruction (ARMv7-M A5.1).
  if (first < 0xE800U) {
    decode16(first);
    return;
  }
  out_.length = 2;
  if (window.holds(address + 2)) {
    decode32(first, static_cast<std::uint32_t>(bytes[2] | (bytes[3] << 8)));
  } else {
    undefined();
  }
}

void Decoder::undefined() { put<&ops::undefined>(); }

bool Decoder::near(std::uint32_t target) const {
  // The two flash planes are programmed independently, so a branch across them goes the long way.
  const bool same_plane =
      (target - kFlashBase) / kPlaneSize == (address_ - kFlashBase) / kPlaneSize;
  return window_.holds(target) && (same_plane || !window_.holds(kFlashBase));
}

// Cycles that a taken branch costs on top of one; kUnknownTarget is in another line.
// They are the refill, and the wait states of a flash line that is not being read anyhow.
std::uint8_t Decoder::taken_cycles(std::uint32_t target) const {
  std::uint32_t count = kRefill;
  const bool in_flash = window_.bytes() != nullptr && window_.size() == kFlashSize;
  if (in_flash && (target >> 4) != (address_ >> 4)) count += cpu_.flash_wait_states();
  return static_cast<std::uint8_t>(count);
}

// Notes a register list; see decoder.hpp.
void Decoder::registers(std::uint32_t list, std::uint32_t more) {
  const auto count = static_cast<std::uint32_t>(__builtin_popcount(list));
  out_.imm = list;
  extra(4U * count);
  cycles(count + more);
}

// Notes the target as an address and as a distance in halfwords.
void Decoder::set_target(std::uint32_t target) {
  out_.imm = target;
  out_.step = static_cast<std::int32_t>(target - address_) / 2;
}

// B, or BL with `link`.
void Decoder::branch_to(std::uint32_t target, bool link) {
  set_target(target);
  cycles(1U + taken_cycles(target));
  if (link) {
    if (!near(target)) return put<&ops::branch_link_far>();
    out_.imm = (address_ + 4) | 1U;
    put<&ops::branch_link_near>();
  } else {
    near(target) ? put<&ops::branch_near>() : put<&ops::branch_far>();
  }
}

// The handlers of B<c> by condition. Each condition has a handler of its own, which needs no
// switch.
template <bool kNear, std::size_t... kConditions>
static constexpr std::array<Handler, sizeof...(kConditions)> branches_of(
    std::index_sequence<kConditions...>) {
  return {&ops::branch_if<kConditions, kNear>...};
}

// Conditional branches are not allowed in an IT block. Conditions 14 and 15 are other instructions.
void Decoder::branch_to_if(std::uint32_t condition, std::uint32_t target) {
  constexpr auto kNearBranches = branches_of<true>(std::make_index_sequence<14>{});
  constexpr auto kFarBranches = branches_of<false>(std::make_index_sequence<14>{});
  if (in_it()) return undefined();
  set_target(target);
  extra(taken_cycles(target));
  out_.run = near(target) ? kNearBranches[condition] : kFarBranches[condition];
}

// DecodeImmShift (A7.4.2): an amount of 0 means none for LSL, 32 for LSR and ASR, and RRX for ROR.
Op2 Decoder::immediate_shift(std::uint32_t type, std::uint32_t amount) {
  extra(amount);
  switch (type) {
    case 0:
      return amount == 0 ? Op2::kReg : Op2::kLsl;
    case 1:
      extra(amount == 0 ? 32 : amount);
      return Op2::kLsr;
    case 2:
      extra(amount == 0 ? 32 : amount);
      return Op2::kAsr;
    default:
      return amount == 0 ? Op2::kRrx : Op2::kRor;
  }
}

// LDR (literal) and its narrow forms. A word in flash becomes a constant of the instruction.
void Decoder::literal(Access access, std::uint32_t address) {
  cycles(2);
  out_.imm = address;
  if (access == Access::kWord && out_.rd == kPc) {
    cycles(2U + taken_cycles(kUnknownTarget));
    return put<&ops::load_literal_pc>();
  }
  const bool in_flash = window_.size() == kFlashSize;
  if (access == Access::kWord && in_flash && near(address) && (address & 3U) == 0) {
    // Flash only changes by programming, which empties the decoded copies.
    const std::uint8_t* bytes = window_.bytes() + (address - window_.base());
    std::memcpy(&out_.imm, bytes, 4);
    return put_alu<Alu::kMov, Op2::kImm>(kKeepFlags);
  }
  switch (access) {
    case Access::kByte:
      return put_rd<&ops::load_literal<std::uint8_t, false>>();
    case Access::kSignedByte:
      return put_rd<&ops::load_literal<std::uint8_t, true>>();
    case Access::kHalf:
      return put_rd<&ops::load_literal<std::uint16_t, false>>();
    case Access::kSignedHalf:
      return put_rd<&ops::load_literal<std::uint16_t, true>>();
    case Access::kWord:
      return put_rd<&ops::load_literal<std::uint32_t, false>>();
  }
}

}  // namespace due_emulator
