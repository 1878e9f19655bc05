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

}  // namespace

Pio::Pio(System& system, Pins& pins, int port, const char* name, std::uint32_t base)
    : Peripheral(system, name, base, 0x200, id::kPioA + port, kRegisters),
      pins_(pins),
      port_(port) {
  pins.set_port_listener(port, this);
}

void Pio::reset() {
  pio_ = ~0U;
  output_ = filter_ = data_ = interrupts_ = status_ = open_drain_ = no_pull_up_ = 0;
  select_b_ = direct_ = additional_ = on_level_ = rising_high_ = 0;
  apply(~0U);
  status_ = 0;
  update_irq();
}

void Pio::apply(std::uint32_t changed) {
  for (std::uint32_t left = changed; left != 0; left &= left - 1) {
    const int bit = __builtin_ctz(left);
    const auto has = [bit](std::uint32_t mask) { return ((mask >> bit) & 1U) != 0; };
    PinSetting setting;
    setting.given_to_peripheral = !has(pio_);
    setting.peripheral_b = has(select_b_);
    setting.output = has(output_);
    setting.open_drain = has(open_drain_);
    setting.high = has(data_);
    setting.pull_up = !has(no_pull_up_);
    pins_.set_setting(port_ * 32 + bit, setting, system_.now());
  }
}

std::uint32_t Pio::levels() const {
  std::uint32_t value = pins_.seen(port_);
  // Only outputs of running peripherals can differ from what was last told.
  for (std::uint32_t left = ~pio_; left != 0; left &= left - 1) {
    const int bit = __builtin_ctz(left);
    const std::uint32_t mask = 1U << bit;
    value = pins_.level(port_ * 32 + bit) ? value | mask : value & ~mask;
  }
  return value;
}

void Pio::pin_changed(int bit, bool level, std::uint64_t) {
  if (!system_.clocked(clock_id_)) return;
  const std::uint32_t mask = 1U << bit;
  // Level modes depend on the level alone and are looked at when the status is read.
  const bool chosen = (additional_ & mask) != 0;
  if (!chosen || ((on_level_ & mask) == 0 && ((rising_high_ & mask) != 0) == level)) {
    status_ |= mask;
  }
  if ((interrupts_ & mask) != 0) update_irq();
}

void Pio::update_irq() {
  const std::uint32_t by_level = additional_ & on_level_;
  const std::uint32_t active = by_level != 0 ? by_level & ~(levels() ^ rising_high_) : 0;
  system_.set_irq(clock_id_, ((status_ | active) & interrupts_) != 0);
}

std::uint32_t Pio::read(std::uint32_t offset) {
  switch (offset) {
    case 0x08:
      return pio_;
    case 0x18:
      return output_;
    case 0x28:
      return filter_;
    case 0x38:
      return data_;
    case 0x3C:
      return levels();
    case 0x48:
      return interrupts_;
    case 0x4C: {
      const std::uint32_t by_level = additional_ & on_level_;
      const std::uint32_t value =
          status_ | (by_level != 0 ? by_level & ~(levels() ^ rising_high_) : 0U);
      status_ = 0;
      update_irq();
      return value;
    }
    case 0x58:
      return open_drain_;
    case 0x68:
      return no_pull_up_;
    case 0x70:
      return select_b_;
    case 0xA8:
      return direct_;
    case 0xB8:
      return additional_;
    case 0xC8:
      return on_level_;
    case 0xD8:
      return rising_high_;
    default:
      return 0;
  }
}

void Pio::write(std::uint32_t offset, std::uint32_t value) {
  switch (offset) {
    case 0x00:
      pio_ |= value;
      return apply(value);
    case 0x04:
      pio_ &= ~value;
      return apply(value);
    case 0x10:
      output_ |= value;
      return apply(value);
    case 0x14:
      output_ &= ~value;
      return apply(value);
    // The glitch filter drops pulses below half a clock; nothing here is that short.
    case 0x20:
      filter_ |= value;
      return;
    case 0x24:
      filter_ &= ~value;
      return;
    case 0x30:
      data_ |= value;
      return apply(value);
    case 0x34:
      data_ &= ~value;
      return apply(value);
    case 0x38: {
      const std::uint32_t before = data_;
      data_ = (data_ & ~direct_) | (value & direct_);
      return apply(before ^ data_);
    }
    case 0x40:
      interrupts_ |= value;
      return update_irq();
    case 0x44:
      interrupts_ &= ~value;
      return update_irq();
    case 0x50:
      open_drain_ |= value;
      return apply(value);
    case 0x54:
      open_drain_ &= ~value;
      return apply(value);
    case 0x60:
      no_pull_up_ |= value;
      return apply(value);
    case 0x64:
      no_pull_up_ &= ~value;
      return apply(value);
    case 0x70: {
      const std::uint32_t changed = select_b_ ^ value;
      select_b_ = value;
      return apply(changed);
    }
    case 0xA0:
      direct_ |= value;
      return;
    case 0xA4:
      direct_ &= ~value;
      return;
    case 0xB0:
      additional_ |= value;
      return update_irq();
    case 0xB4:
      additional_ &= ~value;
      return update_irq();
    case 0xC0:
      on_level_ &= ~value;
      return update_irq();
    case 0xC4:
      on_level_ |= value;
      return update_irq();
    case 0xD0:
      rising_high_ &= ~value;
      return update_irq();
    case 0xD4:
      rising_high_ |= value;
      return update_irq();
    default:
      return;
  }
}

}  // namespace due_emulator
