// The Due around its chip: power, reset button, encoders and the USB bridge; see due.hpp.
#include "board/due.hpp"

#include <algorithm>
#include <stdexcept>

namespace due_emulator {

namespace {

constexpr std::uint32_t kBootFromFlash = 2;  // GPNVM bit 1

}  // namespace

void Due::load(std::uint32_t address, const std::uint8_t* bytes, std::size_t count) {
  const std::uint32_t offset = address - kFlashBase;
  if (offset >= kFlashSize || count > kFlashSize - offset) {
    throw std::invalid_argument("a program at " + hex(address) + " of " + std::to_string(count) +
                                " bytes does not fit the flash at 0x00080000");
  }
  std::copy_n(bytes, count, chip.system.memory.flash.begin() + offset);
  chip.flash.gpnvm |= kBootFromFlash;
  chip.system.cpu.flush_flash_code();
}

// -- encoders ---------------------------------------------------------------------------------

// See due.hpp.
int Due::attach_encoder(int pin_a, int pin_b) {
  encoders_.push_back({pin_a, pin_b, 0});
  drive_lines(encoders_.back());
  return static_cast<int>(encoders_.size()) - 1;
}

// Puts an encoder's lines at the levels of its count: A is high in phases 1 and 2, B in 2 and 3. An
// open collector pulls low, or lets the resistor pull up.
void Due::drive_lines(const Encoder& encoder) {
  const auto phase = static_cast<unsigned>(encoder.count) & 3U;
  const bool a = phase == 1 || phase == 2;
  const bool b = phase >= 2;
  const std::uint64_t now = chip.system.now();
  chip.pins.set_external(encoder.pin_a, a ? External::kPullUp : External::kLow, now);
  chip.pins.set_external(encoder.pin_b, b ? External::kPullUp : External::kLow, now);
}

void Due::set_encoder(int encoder, std::int32_t count) {
  Encoder& set = encoders_.at(index(encoder));
  set.count = count;
  drive_lines(set);
}

// Two counts further, both lines differ.
void Due::glitch_encoder(int encoder) { set_encoder(encoder, this->encoder(encoder) + 2); }

// Queues a step of +1 or -1 for event(); times must not go backwards.
void Due::schedule_step(int encoder, int direction, BoardTime when) {
  if (index(encoder) >= encoders_.size()) {
    throw std::out_of_range("encoder " + std::to_string(encoder) + " of " +
                            std::to_string(encoders_.size()) + "; attach it first");
  }
  steps_.push_back({when, encoder, direction});
  plan();
}

// Schedules event() for the next encoder step.
void Due::plan() {
  const std::uint64_t when =
      steps_.empty() ? kNever : chip.system.clock.cycle_at(steps_.front().when);
  chip.system.scheduler.set(id_, when);
}

// Moves the encoders by the scheduled steps whose time has come.
void Due::event(std::uint64_t) {
  const BoardTime time = now();
  while (!steps_.empty() && steps_.front().when <= time) {
    const Step step = steps_.front();
    steps_.pop_front();
    Encoder& encoder = encoders_[index(step.encoder)];
    encoder.count += step.direction;
    drive_lines(encoder);
  }
  plan();
}

// -- outputs ----------------------------------------------------------------------------------

// See due.hpp.
double Due::pin_duty(int pin) const {
  const PinSetting& setting = chip.pins.setting(pin);
  const int signal = Pwm::signal_at(pin);
  if (signal >= 0 && setting.given_to_peripheral && setting.peripheral_b) {
    return chip.pwm.duty(signal % Pwm::kLowSide, signal >= Pwm::kLowSide);
  }
  return chip.pins.level(pin) ? 1.0 : 0.0;
}

}  // namespace due_emulator
