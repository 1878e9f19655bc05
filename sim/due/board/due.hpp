// The Arduino Due: the chip, its USB bridge, and incremental encoders that are attached to pins.
#pragma once

#include <cstdint>
#include <deque>
#include <vector>

#include "board/usb_bridge.hpp"
#include "chip/chip.hpp"

namespace due_emulator {

class Due final : public EventSink {
 public:
  Due() : bridge(chip), id_(chip.system.scheduler.add(this)) {}

  void power_on() { chip.power_on(); }
  void power_off() { chip.power_off(); }
  // Writes a program into flash, as a programmer does, and makes the chip boot from flash. The
  // power is off, or the caller resets the chip afterwards.
  void load(std::uint32_t address, const std::uint8_t* bytes, std::size_t count);

  BoardTime now() const { return chip.system.board_now(); }
  void run_for(BoardTime duration) { run_until(now() + duration); }
  void run_until(BoardTime until) { chip.run_until(until); }

  // Puts the lines of an incremental encoder, at count 0, on two pins: open collectors with
  // resistors to 3.3 V. Returns the encoder's number, from 0.
  int attach_encoder(int pin_a, int pin_b);
  // The lines follow from the count modulo 4: A leads when it counts up.
  void set_encoder(int encoder, std::int32_t count);
  std::int32_t encoder(int encoder) const { return encoders_.at(index(encoder)).count; }
  // One step at a later time; times must not go backwards.
  void schedule_step(int encoder, int direction, BoardTime when);
  // Both lines of an encoder change at once, which no encoder does.
  void glitch_encoder(int encoder);

  // Share of the running PWM period that a pin is high; 0 or 1 for a pin that no PWM output drives.
  double pin_duty(int pin) const;
  bool pin(int pin) const { return chip.pins.level(pin); }

  void event(std::uint64_t now) override;
  void clock_changed() override { plan(); }

  Chip chip;
  UsbBridge bridge;

 private:
  struct Encoder {
    int pin_a;
    int pin_b;
    std::int32_t count;
  };
  struct Step {
    BoardTime when;
    int encoder;
    int direction;
  };

  static std::size_t index(int encoder) { return static_cast<std::size_t>(encoder); }
  void drive_lines(const Encoder& encoder);
  void plan();

  Scheduler::Id id_;
  std::vector<Encoder> encoders_;
  std::deque<Step> steps_;
};

}  // namespace due_emulator
