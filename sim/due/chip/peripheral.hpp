// Base of all peripheral models: a table of registers with the datasheet's names, and the checks of
// each access. In strict mode a failed check stops the simulation, in lenient mode it is a warning.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "bus/scheduler.hpp"
#include "chip/system.hpp"

namespace due_emulator {

// How a register may be used.
namespace access {
inline constexpr std::uint8_t kRead = 1;
inline constexpr std::uint8_t kWrite = 2;
inline constexpr std::uint8_t kBoth = 3;
inline constexpr std::uint8_t kUnmodelled = 4;  // the chip has it, the model has not
inline constexpr std::uint8_t kUnclocked = 8;   // works without the peripheral's clock
inline constexpr std::uint8_t kProtected = 16;  // refused while write protection is on
}  // namespace access

// A field of a register: `width` bits from bit `low` on.
struct Field {
  unsigned low;
  unsigned width;
  constexpr std::uint32_t of(std::uint32_t bits) const {
    return (bits >> low) & ((1U << width) - 1);
  }
};

// Whether a bit of a register is 1, such as that of a channel or a pin.
template <typename Number>
constexpr bool has_bit(std::uint32_t bits, Number number) {
  return ((bits >> number) & 1U) != 0;
}

struct Register {
  std::uint16_t offset;
  const char* name;
  std::uint8_t access;
};

class Peripheral : public Device, public EventSink {
 public:
  static constexpr int kAlwaysClocked = -1;

  // `size` in bytes; `clock_id` is the PMC identifier, or kAlwaysClocked.
  template <std::size_t kCount>
  Peripheral(System& system, const char* name, std::uint32_t base, std::uint32_t size, int clock_id,
             const Register (&registers)[kCount])
      : Peripheral(system, name, base, size, clock_id, registers, kCount) {}
  Peripheral(const Peripheral&) = delete;
  Peripheral& operator=(const Peripheral&) = delete;

  const char* name() const { return name_; }
  std::uint32_t base() const { return base_; }
  const std::vector<Register>& registers() const { return registers_; }

  std::uint32_t read_register(std::uint32_t address) final;
  void write_register(std::uint32_t address, std::uint32_t value) final;

  virtual void reset() = 0;
  void event(std::uint64_t) override {}
  std::string name_of(std::uint32_t address) const final { return describe(address - base_); }
  std::uint32_t outside_bits(std::uint32_t address) const final {
    return from_outside(address - base_);
  }

 protected:
  // Accesses that have passed the checks; `offset` is in bytes from the base address.
  virtual std::uint32_t read(std::uint32_t offset) = 0;
  virtual void write(std::uint32_t offset, std::uint32_t value) = 0;
  // The PMC identifier that clocks the register at `offset`.
  virtual int clock_of(std::uint32_t) const { return clock_id_; }
  virtual bool write_protected() const { return false; }
  // Bits of the register at `offset` that follow pins, serial lines, voltages or a time that the
  // program chose: a program that waits for one of them makes no mistake.
  virtual std::uint32_t from_outside(std::uint32_t) const { return 0; }

  // Report what a program does wrong, or what the model lacks, with the register's name.
  void misuse(std::uint32_t offset, const std::string& text) const;
  void not_modelled(std::uint32_t offset, const std::string& text) const;
  // "TC0 TC_QISR (0x400800d4)"
  std::string describe(std::uint32_t offset) const;

  System& system_;
  int clock_id_;

 private:
  Peripheral(System& system, const char* name, std::uint32_t base, std::uint32_t size, int clock_id,
             const Register* registers, std::size_t count);
  const Register* find(std::uint32_t offset) const;
  const Register* check(std::uint32_t offset, std::uint8_t direction);
  void check_clock(std::uint32_t offset, const Register& reg, const char* verb) const;

  const char* name_;
  std::uint32_t base_;
  std::vector<Register> registers_;
  std::vector<std::uint16_t> index_;  // by word offset; 0xFFFF: no register
};

}  // namespace due_emulator
