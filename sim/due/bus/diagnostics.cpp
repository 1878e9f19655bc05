// Reports of misuse with the place in the program, as error or warning; see diagnostics.hpp.
#include "bus/diagnostics.hpp"

#include <cxxabi.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <cstdlib>

namespace due_emulator {

const char* trouble_name(Trouble kind) {
  static constexpr std::array<const char*, kTroubleCount> kNames = {
      "unmapped",  "unmodelled", "unclocked",  "unaligned", "narrow",
      "direction", "misuse",     "contention", "lockup",    "wait"};
  return kNames[static_cast<std::size_t>(kind)];
}

std::string hex(std::uint32_t value) {
  char text[16];
  std::snprintf(text, sizeof text, "0x%08x", static_cast<unsigned>(value));
  return text;
}

// Adds a function of the program; C++ names become readable, and the list stays sorted.
void Symbols::add(std::uint32_t address, std::uint32_t size, std::string name) {
  int status = 0;
  if (char* plain = abi::__cxa_demangle(name.c_str(), nullptr, nullptr, &status)) {
    name = plain;
    std::free(plain);
  } else {
    name += "()";
  }
  const Entry entry{address & ~1U, size, std::move(name)};
  entries_.insert(std::upper_bound(entries_.begin(), entries_.end(), entry), entry);
}

// See diagnostics.hpp. A function of size 0 reaches to the next one.
std::string Symbols::describe(std::uint32_t address) const {
  const auto after = std::upper_bound(entries_.begin(), entries_.end(), Entry{address, 0, {}});
  if (after == entries_.begin()) return {};
  const Entry& entry = *(after - 1);
  const std::uint32_t offset = address - entry.address;
  if (entry.size != 0 && offset >= entry.size) return {};
  char text[16];
  std::snprintf(text, sizeof text, "+0x%x", static_cast<unsigned>(offset));
  return entry.name + text;
}

// Chooses for one kind whether it stops the emulation or is a warning.
void Diagnostics::set_strict(Trouble kind, bool strict) {
  const std::uint32_t bit = 1U << static_cast<unsigned>(kind);
  strict_mask_ = strict ? strict_mask_ | bit : strict_mask_ & ~bit;
}

// See diagnostics.hpp. A warning appears once for each kind, address and place in the program.
void Diagnostics::report(Trouble kind, std::uint32_t address, const std::string& text) {
  const std::uint32_t pc = pc_of != nullptr ? pc_of(pc_source) : 0;
  if (!strict(kind) && !seen_.insert({kind, address, pc}).second) return;
  std::string message = std::string(trouble_name(kind)) + ": " + text + "; at pc " + hex(pc);
  const std::string function = symbols.describe(pc);
  if (!function.empty()) message += " in " + function;
  if (strict(kind)) throw Stop(message);
  warnings_.push_back(std::move(message));
}

// The warnings since the last call.
std::vector<std::string> Diagnostics::take_warnings() { return std::exchange(warnings_, {}); }

}  // namespace due_emulator
