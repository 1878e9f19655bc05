// Notices a program that reads one register over and over, which never changes.
//
// A loop is known by its load: the same place in the program gets the same value from the same
// register, with a few instructions and no other access to a peripheral in between. Handlers that
// interrupt the loop are neither counted nor looked at; each level of nesting has its own loop.
#pragma once

#include <array>
#include <cstdint>

#include "cpu/exceptions.hpp"

namespace due_emulator {

class Cpu;

class WaitLoops {
 public:
  struct Loop {
    std::uint32_t pc = kNone;  // of the load
    std::uint32_t address = 0;
    std::uint32_t value = 0;
    std::uint64_t entry = 0;         // of the handler with the loop: Cpu::entry_of_level()
    std::uint64_t instructions = 0;  // of this level, up to the last read
    std::uint64_t since = 0;         // cycle of the first read
    bool found() const { return pc != kNone; }
  };

  void read(const Cpu& cpu, std::uint32_t address, std::uint32_t value);
  void write(const Cpu& cpu, std::uint32_t address);
  // The loop that the running level of nesting is in, or was in last.
  Loop& at_level_of(const Cpu& cpu);
  // Whether the running level of nesting is still in the loop: its last read was a few instructions
  // ago.
  static bool stands_in(const Cpu& cpu, const Loop& loop);

 private:
  static constexpr std::uint32_t kNone = 1;  // no instruction has an odd address

  std::array<Loop, exc::kCount + 1> loops_{};
};

}  // namespace due_emulator
