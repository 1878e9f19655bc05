// Reports of firmware that does something for which the chip promises no result.
//
// Strict: a report stops the emulation. Lenient: it is a warning, once for each place in the
// program, and the emulation goes on with what the chip would most likely do.
#pragma once

#include <cstdint>
#include <exception>
#include <set>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

namespace due_emulator {

enum class Trouble : std::uint8_t {
  kUnmapped,    // no memory and no peripheral there
  kUnmodelled,  // the chip has it, the emulator has not
  kUnclocked,   // the PMC clock of the peripheral is off
  kUnaligned,   // not a multiple of the access size
  kNarrow,      // byte or halfword access to a 32-bit register
  kDirection,   // write of a read-only register or read of a write-only one
  kMisuse,      // a value or an order that the datasheet forbids
  kContention,  // two strong drivers on one wire
  kLockup,      // the processor gave up; stops in lenient mode too, unless this check is off
  kWait,  // half a second in a loop on a register that never changes; stops in lenient mode only
};
inline constexpr int kTroubleCount = 10;

// Name as the command line and the messages use it.
const char* trouble_name(Trouble kind);

// The emulation cannot go on. what() is one line.
class Stop : public std::exception {
 public:
  explicit Stop(std::string message) : message_(std::move(message)) {}
  const char* what() const noexcept override { return message_.c_str(); }

 private:
  std::string message_;
};

// Function names of the ELF, for messages and profiles.
class Symbols {
 public:
  void add(std::uint32_t address, std::uint32_t size, std::string name);
  // "name()+0x12", or "" when no function is there.
  std::string describe(std::uint32_t address) const;

 private:
  struct Entry {
    std::uint32_t address;
    std::uint32_t size;
    std::string name;
    bool operator<(const Entry& other) const { return address < other.address; }
  };
  std::vector<Entry> entries_;
};

class Diagnostics {
 public:
  void set_all_strict(bool strict) { strict_mask_ = strict ? kStrict : kLenient; }
  void set_strict(Trouble kind, bool strict);
  bool strict(Trouble kind) const {
    return ((strict_mask_ >> static_cast<unsigned>(kind)) & 1U) != 0;
  }

  // Throws Stop when `kind` is strict; otherwise notes a warning.
  void report(Trouble kind, std::uint32_t address, const std::string& text);
  std::vector<std::string> take_warnings();

  // Gives the program counter when called with pc_source; the Cpu sets both.
  std::uint32_t (*pc_of)(const void*) = nullptr;
  const void* pc_source = nullptr;

  Symbols symbols;

 private:
  static constexpr std::uint32_t kWaitBit = 1U << static_cast<unsigned>(Trouble::kWait);
  static constexpr std::uint32_t kLenient =
      kWaitBit | 1U << static_cast<unsigned>(Trouble::kLockup);
  static constexpr std::uint32_t kStrict = ((1U << kTroubleCount) - 1U) & ~kWaitBit;

  std::uint32_t strict_mask_ = kStrict;
  std::set<std::tuple<Trouble, std::uint32_t, std::uint32_t>> seen_;
  std::vector<std::string> warnings_;
};

// "0x400e0a04"
std::string hex(std::uint32_t value);

}  // namespace due_emulator
