#include "board/due.hpp"

#include <algorithm>
#include <stdexcept>

namespace heli_due {

namespace {

constexpr std::uint32_t kBootFromFlash = 2;  // GPNVM bit 1

// PWM outputs of the driver pins: channel of PWML on peripheral B of PIOC.
int pwm_channel(int pin) {
  if (pin >= pin_of('C', 21) && pin <= pin_of('C', 24)) return 4 + pin - pin_of('C', 21);
  return -1;
}

}  // namespace

Due::Due() : bridge(chip), id_(chip.system.scheduler.add(this)) {
  for (const MotorPins& motor : kMotorPins) {
    chip.pins.set_external(motor.right_enable, External::kPullDown, 0);
    chip.pins.set_external(motor.left_enable, External::kPullDown, 0);
  }
  for (int axis = 0; axis < kEncoders; ++axis) drive_lines(axis);
  set_stop(false);
}

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

void Due::drive_lines(int axis) {
  const auto phase = static_cast<unsigned>(position_[static_cast<std::size_t>(axis)]) & 3U;
  const bool a = phase == 1 || phase == 2;
  const bool b = phase >= 2;
  const std::uint64_t now = chip.system.now();
  // Open collectors with resistors to 3.3 V.
  chip.pins.set_external(kEncoderPins[axis].a, a ? External::kPullUp : External::kLow, now);
  chip.pins.set_external(kEncoderPins[axis].b, b ? External::kPullUp : External::kLow, now);
}

void Due::set_encoder(int axis, std::int32_t count) {
  position_[static_cast<std::size_t>(axis)] = count;
  drive_lines(axis);
}

void Due::glitch_encoder(int axis) { set_encoder(axis, encoder(axis) + 2); }

void Due::schedule_step(int axis, int direction, BoardTime when) {
  steps_.push_back({when, axis, direction});
  plan();
}

void Due::plan() {
  const std::uint64_t when =
      steps_.empty() ? kNever : chip.system.clock.cycle_at(steps_.front().when);
  chip.system.scheduler.set(id_, when);
}

void Due::event(std::uint64_t) {
  const BoardTime time = now();
  while (!steps_.empty() && steps_.front().when <= time) {
    const Step step = steps_.front();
    steps_.pop_front();
    position_[static_cast<std::size_t>(step.axis)] += step.direction;
    drive_lines(step.axis);
  }
  plan();
}

// -- motors -----------------------------------------------------------------------------------

double Due::pin_duty(int pin) const {
  const PinSetting& setting = chip.pins.setting(pin);
  const int channel = pwm_channel(pin);
  if (channel >= 0 && setting.given_to_peripheral && setting.peripheral_b) {
    return chip.pwm.duty(channel, true);
  }
  return chip.pins.level(pin) ? 1.0 : 0.0;
}

double Due::motor_duty(int motor) const {
  return pin_duty(kMotorPins[motor].right_pwm) - pin_duty(kMotorPins[motor].left_pwm);
}

bool Due::motor_enabled(int motor) const {
  return chip.pins.level(kMotorPins[motor].right_enable) &&
         chip.pins.level(kMotorPins[motor].left_enable);
}

}  // namespace heli_due
