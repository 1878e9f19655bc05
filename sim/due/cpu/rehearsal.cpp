// What a program would do if a register read differently, without doing it.
#include <algorithm>
#include <array>
#include <set>
#include <tuple>
#include <vector>

#include "cpu/cpu.hpp"

namespace due_emulator {

namespace {

constexpr int kMaxInstructions = 256;  // a longer way to the next read is no wait loop

}  // namespace

// Runs the program from the load at ip_, which reads the value `polled`, to its next read of a
// peripheral. With `record`, notes the addresses in `loop`; returns whether there is a loop.
// Without, returns whether the program stayed in the loop that was recorded. The caller restores
// the state.
bool Cpu::follow(std::uint32_t polled, std::set<std::uint32_t>& loop, bool record) {
  bus_.rehearse(polled);
  try {
    for (int i = 0; i < kMaxInstructions; ++i) {
      if (record) {
        loop.insert(pc());
      } else if (loop.count(pc()) == 0) {
        return false;
      }
      ip_ = ip_->run(*this, ip_);
    }
  } catch (const RehearsalEnds&) {
    return true;
  } catch (const Fault&) {
  } catch (const Stop&) {
  }
  return !record;
}

// See cpu.hpp. Runs the loop once with the value that the register has, and then once per bit with
// that bit inverted; after each run the state is restored.
std::uint32_t Cpu::deciding_bits(std::uint32_t value) {
  const auto members = [this] {
    return std::tie(n_src, z_src, carry, v_src, q_flag, exclusive, exclusive_address, cfsr, hfsr,
                    mmfar, bfar, ip_, cycles_, stop_at_, leave_, sleeping_, waiting_for_event_,
                    halt_, ipsr_, other_sp_, spsel_, uses_psp_, unprivileged_thread_, thumb_,
                    bad_pc_, step_over_);
  };
  const auto state =
      std::apply([](const auto&... member) { return std::make_tuple(member...); }, members());
  std::array<std::uint32_t, 16> registers{};
  std::copy_n(r, 16, registers.begin());
  const std::vector<std::uint8_t> ram = memory_.ram;
  const auto restore = [&] {
    members() = state;
    std::copy_n(registers.begin(), 16, r);
    std::copy(ram.begin(), ram.end(), memory_.ram.begin());
  };
  std::set<std::uint32_t> loop;
  std::uint32_t bits = 0;
  const bool closes = follow(value, loop, true);
  restore();
  for (unsigned bit = 0; closes && bit < 32; ++bit) {
    if (!follow(value ^ (1U << bit), loop, false)) bits |= 1U << bit;
    restore();
  }
  bus_.end_rehearsal();
  return bits;
}

}  // namespace due_emulator
