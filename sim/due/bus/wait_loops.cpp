// Finds a program that waits for a register that never changes; see wait_loops.hpp.
#include "bus/wait_loops.hpp"

#include <algorithm>

#include "cpu/cpu.hpp"

namespace due_emulator {

namespace {

// A loop that takes more instructions than this does work: it does not only wait.
constexpr std::uint64_t kMaxInstructions = 64;
// WDT_CR: a loop that waits may restart the watchdog meanwhile.
constexpr std::uint32_t kWatchdogRestart = 0x400E1A50;

}  // namespace

WaitLoops::Loop& WaitLoops::at_level_of(const Cpu& cpu) {
  return loops_[std::min(cpu.nesting(), loops_.size() - 1)];
}

bool WaitLoops::stands_in(const Cpu& cpu, const Loop& loop) {
  return loop.found() && loop.entry == cpu.entry_of_level() &&
         cpu.instructions_of_level() - loop.instructions <= kMaxInstructions;
}

// A load from a peripheral: it continues the loop of this level, or may begin one.
void WaitLoops::read(const Cpu& cpu, std::uint32_t address, std::uint32_t value) {
  Loop& loop = at_level_of(cpu);
  const std::uint32_t pc = cpu.pc();
  const std::uint64_t instructions = cpu.instructions_of_level();
  const bool again =
      loop.pc == pc && loop.address == address && loop.value == value && stands_in(cpu, loop);
  if (!again) loop = {pc, address, value, cpu.entry_of_level(), 0, cpu.cycles()};
  loop.instructions = instructions;
}

// A store to a peripheral: a program that does that in its loop does not only wait.
void WaitLoops::write(const Cpu& cpu, std::uint32_t address) {
  if (address != kWatchdogRestart) at_level_of(cpu).pc = kNone;
}

}  // namespace due_emulator
