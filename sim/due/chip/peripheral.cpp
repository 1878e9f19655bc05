// Checks of each register access before the model sees it; see peripheral.hpp.
#include "chip/peripheral.hpp"

namespace due_emulator {

namespace {

constexpr std::uint16_t kNone = 0xFFFF;

}  // namespace

// The master clock changes: events that stand for board time are scheduled anew, and the processor
// leaves its run loop.
void System::change_mck(std::uint32_t mck_Hz) {
  if (mck_Hz == clock.mck_Hz()) return;
  clock.set_mck(now(), mck_Hz);
  scheduler.clock_changed();
  cpu.interrupt_run();
}

// Indexes the register table by offset, and adds the peripheral to the chip's list and to the bus.
Peripheral::Peripheral(System& system, const char* name, std::uint32_t base, std::uint32_t size,
                       int clock_id, const Register* registers, std::size_t count)
    : system_(system),
      clock_id_(clock_id),
      name_(name),
      base_(base),
      registers_(registers, registers + count),
      index_(size / 4, kNone) {
  for (std::size_t i = 0; i < registers_.size(); ++i) {
    index_[registers_[i].offset / 4U] = static_cast<std::uint16_t>(i);
  }
  system.peripherals.push_back(this);
  system.bus.add(base, size, this);
}

// The table's row of a register; null if there is none.
const Register* Peripheral::find(std::uint32_t offset) const {
  if (offset / 4 >= index_.size() || index_[offset / 4] == kNone) return nullptr;
  return &registers_[index_[offset / 4]];
}

// "TC0 TC_QISR (0x400800d4)"; without a register, the address alone.
std::string Peripheral::describe(std::uint32_t offset) const {
  const Register* reg = find(offset);
  if (reg == nullptr) return std::string(name_) + " " + hex(base_ + offset);
  return std::string(name_) + " " + reg->name + " (" + hex(base_ + offset) + ")";
}

void Peripheral::misuse(std::uint32_t offset, const std::string& text) const {
  system_.diagnostics.report(Trouble::kMisuse, base_ + offset, describe(offset) + ": " + text);
}

void Peripheral::not_modelled(std::uint32_t offset, const std::string& text) const {
  system_.diagnostics.report(Trouble::kUnmodelled, base_ + offset, describe(offset) + ": " + text);
}

// Reports an access to a register whose peripheral clock is off.
void Peripheral::check_clock(std::uint32_t offset, const Register& reg, const char* verb) const {
  const int identifier = clock_of(offset);
  if ((reg.access & access::kUnclocked) != 0 || identifier < 0 || system_.clocked(identifier))
    return;
  system_.diagnostics.report(Trouble::kUnclocked, base_ + offset,
                             std::string(verb) + describe(offset) + " while peripheral clock " +
                                 std::to_string(identifier) + " is off in PMC_PCSR");
}

// Checks an access to a register (`direction`: access::kRead or kWrite). Returns its row, or null
// if the access is reported and, in lenient mode, ignored.
const Register* Peripheral::check(std::uint32_t offset, std::uint8_t direction) {
  const char* verb = direction == access::kRead ? "read of " : "write of ";
  const Register* reg = find(offset);
  if (reg == nullptr) {
    system_.diagnostics.report(Trouble::kUnmodelled, base_ + offset,
                               std::string(verb) + describe(offset) + ": there is no register");
    return nullptr;
  }
  check_clock(offset, *reg, verb);
  if ((reg->access & access::kUnmodelled) != 0) {
    system_.diagnostics.report(Trouble::kUnmodelled, base_ + offset,
                               std::string(verb) + describe(offset) + ": not modelled");
    return nullptr;
  }
  if ((reg->access & direction) == 0) {
    system_.diagnostics.report(
        Trouble::kDirection, base_ + offset,
        std::string(verb) + describe(offset) +
            (direction == access::kRead ? ", which is write-only" : ", which is read-only"));
    return nullptr;
  }
  return reg;
}

// An access that fails a check reads 0 or writes nothing.
std::uint32_t Peripheral::read_register(std::uint32_t address) {
  const std::uint32_t offset = address - base_;
  return check(offset, access::kRead) != nullptr ? read(offset) : 0;
}

// Registers under write protection (kProtected) also need it to be off.
void Peripheral::write_register(std::uint32_t address, std::uint32_t value) {
  const std::uint32_t offset = address - base_;
  const Register* reg = check(offset, access::kWrite);
  if (reg == nullptr) return;
  if ((reg->access & access::kProtected) != 0 && write_protected()) {
    return misuse(offset, "write while write protection is on");
  }
  write(offset, value);
}

}  // namespace due_emulator
