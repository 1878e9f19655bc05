// Pins of encoders, motor drivers and stop input on the emulated Due; see wiring.hpp.
#include "wiring.hpp"

#include <array>

namespace heli_sim {

namespace {

using due_emulator::External;
using due_emulator::pin_of;

struct EncoderPins {
  int a;
  int b;
};
constexpr EncoderPins kEncoderPins[kEncoders] = {
    {pin_of('B', 25), pin_of('B', 27)},  // D2, D13: decoder of TC0
    {pin_of('C', 25), pin_of('C', 26)},  // D5, D4: decoder of TC2
    {pin_of('D', 0), pin_of('D', 1)},    // D25, D26: interrupt
};

// An H bridge with two half bridges: each has a PWM input and an enable input.
struct MotorPins {
  int right_pwm;
  int left_pwm;
  int right_enable;
  int left_enable;
};
constexpr std::array<MotorPins, kMotors> kMotorPins = {{
    {pin_of('C', 21), pin_of('C', 22), pin_of('B', 26), pin_of('A', 14)},  // D9, D8, D22, D23
    {pin_of('C', 23), pin_of('C', 24), pin_of('A', 15), pin_of('D', 3)},   // D7, D6, D24, D28
}};
constexpr int kStopPin = pin_of('D', 6);  // D29, PWMFI2

const MotorPins& pins_of(int motor) { return kMotorPins.at(static_cast<std::size_t>(motor)); }

}  // namespace

// See wiring.hpp.
void wire(due_emulator::Due& due) {
  const std::uint64_t now = due.chip.system.now();
  for (const EncoderPins& encoder : kEncoderPins) due.attach_encoder(encoder.a, encoder.b);
  for (const MotorPins& motor : kMotorPins) {
    due.chip.pins.set_external(motor.right_enable, External::kPullDown, now);
    due.chip.pins.set_external(motor.left_enable, External::kPullDown, now);
  }
  set_stop(due, false);
}

double motor_duty(const due_emulator::Due& due, int motor) {
  return due.pin_duty(pins_of(motor).right_pwm) - due.pin_duty(pins_of(motor).left_pwm);
}

bool motor_enabled(const due_emulator::Due& due, int motor) {
  return due.pin(pins_of(motor).right_enable) && due.pin(pins_of(motor).left_enable);
}

void set_stop(due_emulator::Due& due, bool pressed) {
  const External state = pressed ? External::kOpen : External::kLow;
  due.chip.pins.set_external(kStopPin, state, due.chip.system.now());
}

}  // namespace heli_sim
