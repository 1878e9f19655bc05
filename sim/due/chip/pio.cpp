// Registers of a parallel port, and its pin interrupts; see pio.hpp.
#include "chip/pio.hpp"

namespace due_emulator {

namespace {

using access::kBoth;
using access::kRead;
using access::kUnclocked;
using access::kUnmodelled;
using access::kWrite;

constexpr std::uint8_t kSet = kWrite | kUnclocked;
constexpr std::uint8_t kGet = kRead | kUnclocked;

// Only reading the pins and their edges needs the peripheral clock.
constexpr Register kRegisters[] = {
    {0x00, "PIO_PER", kSet},
    {0x04, "PIO_PDR", kSet},
    {0x08, "PIO_PSR", kGet},
    {0x10, "PIO_OER", kSet},
    {0x14, "PIO_ODR", kSet},
    {0x18, "PIO_OSR", kGet},
    {0x20, "PIO_IFER", kSet},
    {0x24, "PIO_IFDR", kSet},
    {0x28, "PIO_IFSR", kGet},
    {0x30, "PIO_SODR", kSet},
    {0x34, "PIO_CODR", kSet},
    {0x38, "PIO_ODSR", kBoth | kUnclocked},
    {0x3C, "PIO_PDSR", kRead},
    {0x40, "PIO_IER", kWrite},
    {0x44, "PIO_IDR", kSet},
    {0x48, "PIO_IMR", kGet},
    {0x4C, "PIO_ISR", kRead},
    {0x50, "PIO_MDER", kSet},
    {0x54, "PIO_MDDR", kSet},
    {0x58, "PIO_MDSR", kGet},
    {0x60, "PIO_PUDR", kSet},
    {0x64, "PIO_PUER", kSet},
    {0x68, "PIO_PUSR", kGet},
    {0x70, "PIO_ABSR", kBoth | kUnclocked},
    {0x80, "PIO_SCIFSR", kSet},
    {0x84, "PIO_DIFSR", kSet | kUnmodelled},
    {0x88, "PIO_IFDGSR", kGet},
    {0x8C, "PIO_SCDR", kBoth | kUnclocked},
    {0xA0, "PIO_OWER", kSet},
    {0xA4, "PIO_OWDR", kSet},
    {0xA8, "PIO_OWSR", kGet},
    {0xB0, "PIO_AIMER", kSet},
    {0xB4, "PIO_AIMDR", kSet},
    {0xB8, "PIO_AIMMR", kGet},
    {0xC0, "PIO_ESR", kSet},
    {0xC4, "PIO_LSR", kSet},
    {0xC8, "PIO_ELSR", kGet},
    {0xD0, "PIO_FELLSR", kSet},
    {0xD4, "PIO_REHLSR", kSet},
    {0xD8, "PIO_FRLHSR", kGet},
    {0xE0, "PIO_LOCKSR", kGet},
    {0xE4, "PIO_WPMR", kBoth | kUnmodelled},
    {0xE8, "PIO_WPSR", kGet | kUnmodelled},
};

// Offsets of the registers that the code below names.
constexpr std::uint32_t kPer = 0x00;
constexpr std::uint32_t kPdr = 0x04;
constexpr std::uint32_t kPsr = 0x08;
constexpr std::uint32_t kOer = 0x10;
constexpr std::uint32_t kOdr = 0x14;
constexpr std::uint32_t kOsr = 0x18;
constexpr std::uint32_t kIfer = 0x20;
constexpr std::uint32_t kIfdr = 0x24;
constexpr std::uint32_t kIfsr = 0x28;
constexpr std::uint32_t kSodr = 0x30;
constexpr std::uint32_t kCodr = 0x34;
constexpr std::uint32_t kOdsr = 0x38;
constexpr std::uint32_t kPdsr = 0x3C;
constexpr std::uint32_t kIer = 0x40;
constexpr std::uint32_t kIdr = 0x44;
constexpr std::uint32_t kImr = 0x48;
constexpr std::uint32_t kIsr = 0x4C;
constexpr std::uint32_t kMder = 0x50;
constexpr std::uint32_t kMddr = 0x54;
constexpr std::uint32_t kMdsr = 0x58;
constexpr std::uint32_t kPudr = 0x60;
constexpr std::uint32_t kPuer = 0x64;
constexpr std::uint32_t kPusr = 0x68;
constexpr std::uint32_t kAbsr = 0x70;
constexpr std::uint32_t kOwer = 0xA0;
constexpr std::uint32_t kOwdr = 0xA4;
constexpr std::uint32_t kOwsr = 0xA8;
constexpr std::uint32_t kAimer = 0xB0;
constexpr std::uint32_t kAimdr = 0xB4;
constexpr std::uint32_t kAimmr = 0xB8;
constexpr std::uint32_t kEsr = 0xC0;
constexpr std::uint32_t kLsr = 0xC4;
constexpr std::uint32_t kElsr = 0xC8;
constexpr std::uint32_t kFellsr = 0xD0;
constexpr std::uint32_t kRehlsr = 0xD4;
constexpr std::uint32_t kFrlhsr = 0xD8;

}  // namespace

// One port of 32 pins; it follows the edges of all of them.
Pio::Pio(System& system, Pins& pins, int port, const char* name, std::uint32_t base)
    : Peripheral(system, name, base, 0x200, id::kPioA + port, kRegisters),
      pins_(pins),
      port_(port) {
  pins.set_port_listener(port, this);
}

// After reset all pins are inputs of the PIO with pull-ups.
void Pio::reset() {
  pio_controls_ = ~0U;
  is_output_ = has_filter_ = output_level_ = interrupts_ = status_ = is_open_drain_ = no_pull_up_ =
      0;
  select_b_ = may_write_directly_ = uses_chosen_mode_ = on_level_ = rising_or_high_ = 0;
  apply(~0U);
  status_ = 0;
  update_irq();
}

// Gives the pins whose bits are set in `changed` the setting that the registers describe.
void Pio::apply(std::uint32_t changed) {
  for (std::uint32_t left = changed; left != 0; left &= left - 1) {
    const int bit = __builtin_ctz(left);
    const auto has = [bit](std::uint32_t mask) { return ((mask >> bit) & 1U) != 0; };
    PinSetting setting;
    setting.given_to_peripheral = !has(pio_controls_);
    setting.peripheral_b = has(select_b_);
    setting.output = has(is_output_);
    setting.open_drain = has(is_open_drain_);
    setting.high = has(output_level_);
    setting.pull_up = !has(no_pull_up_);
    pins_.set_setting(port_ * 32 + bit, setting, system_.now());
  }
}

// PIO_PDSR: the levels at the pins now.
std::uint32_t Pio::levels() const {
  std::uint32_t value = pins_.seen(port_);
  // Only outputs of running peripherals can differ from what was last told.
  for (std::uint32_t left = ~pio_controls_; left != 0; left &= left - 1) {
    const int bit = __builtin_ctz(left);
    const std::uint32_t mask = 1U << bit;
    value = pins_.level(port_ * 32 + bit) ? value | mask : value & ~mask;
  }
  return value;
}

// An edge at a pin sets its bit in PIO_ISR: any edge, or with PIO_AIMMR the chosen one.
void Pio::pin_changed(int bit, bool level, std::uint64_t) {
  if (!system_.clocked(clock_id_)) return;
  const std::uint32_t mask = 1U << bit;
  // Level modes depend on the level alone and are looked at when the status is read.
  const bool chosen = (uses_chosen_mode_ & mask) != 0;
  if (!chosen || ((on_level_ & mask) == 0 && ((rising_or_high_ & mask) != 0) == level)) {
    status_ |= mask;
  }
  if ((interrupts_ & mask) != 0) update_irq();
}

// The port's interrupt line: any enabled bit of PIO_ISR, where pins in level mode count while their
// level is the chosen one.
void Pio::update_irq() {
  const std::uint32_t by_level = uses_chosen_mode_ & on_level_;
  const std::uint32_t active = by_level != 0 ? by_level & ~(levels() ^ rising_or_high_) : 0;
  system_.set_irq(clock_id_, ((status_ | active) & interrupts_) != 0);
}

// Status registers: one bit per pin. Only reading PIO_ISR has an effect.
std::uint32_t Pio::read(std::uint32_t offset) {
  switch (offset) {
    case kPsr:
      return pio_controls_;
    case kOsr:
      return is_output_;
    case kIfsr:
      return has_filter_;
    case kOdsr:
      return output_level_;
    case kPdsr:
      return levels();
    case kImr:
      return interrupts_;
    case kIsr: {  // reading clears it
      const std::uint32_t by_level = uses_chosen_mode_ & on_level_;
      const std::uint32_t value =
          status_ | (by_level != 0 ? by_level & ~(levels() ^ rising_or_high_) : 0U);
      status_ = 0;
      update_irq();
      return value;
    }
    case kMdsr:
      return is_open_drain_;
    case kPusr:
      return no_pull_up_;
    case kAbsr:
      return select_b_;
    case kOwsr:
      return may_write_directly_;
    case kAimmr:
      return uses_chosen_mode_;
    case kElsr:
      return on_level_;
    case kFrlhsr:
      return rising_or_high_;
    default:
      return 0;
  }
}

// Most registers come in pairs: a 1 in the first sets a pin's bit of the status register, in the
// second clears it.
void Pio::write(std::uint32_t offset, std::uint32_t value) {
  switch (offset) {
    case kPer:
      pio_controls_ |= value;
      return apply(value);
    case kPdr:
      pio_controls_ &= ~value;
      return apply(value);
    case kOer:
      is_output_ |= value;
      return apply(value);
    case kOdr:
      is_output_ &= ~value;
      return apply(value);
    // The glitch filter drops pulses below half a clock; nothing here is that short.
    case kIfer:
      has_filter_ |= value;
      return;
    case kIfdr:
      has_filter_ &= ~value;
      return;
    case kSodr:
      output_level_ |= value;
      return apply(value);
    case kCodr:
      output_level_ &= ~value;
      return apply(value);
    case kOdsr: {  // only bits that PIO_OWSR allows
      const std::uint32_t before = output_level_;
      output_level_ = (output_level_ & ~may_write_directly_) | (value & may_write_directly_);
      return apply(before ^ output_level_);
    }
    case kIer:
      interrupts_ |= value;
      return update_irq();
    case kIdr:
      interrupts_ &= ~value;
      return update_irq();
    case kMder:
      is_open_drain_ |= value;
      return apply(value);
    case kMddr:
      is_open_drain_ &= ~value;
      return apply(value);
    case kPudr:
      no_pull_up_ |= value;
      return apply(value);
    case kPuer:
      no_pull_up_ &= ~value;
      return apply(value);
    case kAbsr: {
      const std::uint32_t changed = select_b_ ^ value;
      select_b_ = value;
      return apply(changed);
    }
    case kOwer:
      may_write_directly_ |= value;
      return;
    case kOwdr:
      may_write_directly_ &= ~value;
      return;
    case kAimer:
      uses_chosen_mode_ |= value;
      return update_irq();
    case kAimdr:
      uses_chosen_mode_ &= ~value;
      return update_irq();
    case kEsr:
      on_level_ &= ~value;
      return update_irq();
    case kLsr:
      on_level_ |= value;
      return update_irq();
    case kFellsr:
      rising_or_high_ &= ~value;
      return update_irq();
    case kRehlsr:
      rising_or_high_ |= value;
      return update_irq();
    default:
      return;
  }
}

}  // namespace due_emulator
