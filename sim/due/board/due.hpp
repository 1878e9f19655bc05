// The Arduino Due as the helicopter is wired to it: chip, USB bridge, encoders, drivers, stop
// input.
#pragma once

#include <array>
#include <cstdint>
#include <deque>

#include "board/usb_bridge.hpp"
#include "chip/chip.hpp"

namespace heli_due {

inline constexpr int kEncoders = 3;
inline constexpr int kMotors = 2;

// Pins of the wiring table, by what hangs on them.
struct EncoderPins {
  int a;
  int b;
};
inline constexpr EncoderPins kEncoderPins[kEncoders] = {
    {pin_of('B', 25), pin_of('B', 27)},  // D2, D13: decoder of TC0
    {pin_of('C', 25), pin_of('C', 26)},  // D5, D4: decoder of TC2
    {pin_of('D', 0), pin_of('D', 1)},    // D25, D26: interrupt
};

struct MotorPins {
  int right_pwm;
  int left_pwm;
  int right_enable;
  int left_enable;
};
inline constexpr MotorPins kMotorPins[kMotors] = {
    {pin_of('C', 21), pin_of('C', 22), pin_of('B', 26), pin_of('A', 14)},  // D9, D8, D22, D23
    {pin_of('C', 23), pin_of('C', 24), pin_of('A', 15), pin_of('D', 3)},   // D7, D6, D24, D28
};
inline constexpr int kStopPin = pin_of('D', 6);  // D29, PWMFI2

class Due final : public EventSink {
 public:
  Due();

  void power_on() { chip.power_on(); }
  void power_off() { chip.power_off(); }
  // Program into flash, as a programmer does: power is off or the chip is reset afterwards.
  void load(std::uint32_t address, const std::uint8_t* bytes, std::size_t count);

  BoardTime now() const { return chip.system.board_now(); }
  void run_for(BoardTime duration) { run_until(now() + duration); }
  void run_until(BoardTime until) { chip.run_until(until); }

  // The encoder's lines follow from its count modulo 4: A leads when it counts up.
  void set_encoder(int axis, std::int32_t count);
  std::int32_t encoder(int axis) const { return position_[static_cast<std::size_t>(axis)]; }
  // One step at a later time; times must not go backwards.
  void schedule_step(int axis, int direction, BoardTime when);
  // Both lines of an encoder change at once, which no encoder does.
  void glitch_encoder(int axis);

  // Share of the running PWM period that a pin is high; 0 or 1 for a pin that is no PWM output.
  double pin_duty(int pin) const;
  bool pin(int pin) const { return chip.pins.level(pin); }
  // Signed duty of a motor's bridge, and whether both of its enables are high.
  double motor_duty(int motor) const;
  bool motor_enabled(int motor) const;
  // The stop input hangs on a normally closed switch to ground. Pressed, or with a cut wire, it is
  // open and the chip's pull-up makes it high, which stops.
  void set_stop(bool pressed) {
    const External state = pressed ? External::kOpen : External::kLow;
    chip.pins.set_external(kStopPin, state, chip.system.now());
  }

  void event(std::uint64_t now) override;
  void clock_changed() override { plan(); }

  Chip chip;
  UsbBridge bridge;

 private:
  struct Step {
    BoardTime when;
    int axis;
    int direction;
  };

  void drive_lines(int axis);
  void plan();

  Scheduler::Id id_;
  std::array<std::int32_t, kEncoders> position_{};
  std::deque<Step> steps_;
};

}  // namespace heli_due
