// PIO controller (datasheet, section 31): direction, pull-ups, peripheral choice, input edges.
#pragma once

#include "chip/peripheral.hpp"
#include "chip/pins.hpp"

namespace due_emulator {

class Pio final : public Peripheral, public PinListener {
 public:
  Pio(System& system, Pins& pins, int port, const char* name, std::uint32_t base);

  void reset() override;
  void pin_changed(int bit, bool level, std::uint64_t now) override;

 protected:
  std::uint32_t read(std::uint32_t offset) override;
  void write(std::uint32_t offset, std::uint32_t value) override;
  // PDSR and ISR follow the pins.
  std::uint32_t from_outside(std::uint32_t offset) const override {
    return offset == 0x3C || offset == 0x4C ? ~0U : 0;
  }

 private:
  void apply(std::uint32_t changed);
  void update_irq();
  std::uint32_t levels() const;
  void enable_interrupts(std::uint32_t value);

  Pins& pins_;
  int port_;
  std::uint32_t pio_controls_ = ~0U;      // PSR
  std::uint32_t is_output_ = 0;           // OSR
  std::uint32_t has_filter_ = 0;          // IFSR
  std::uint32_t output_level_ = 0;        // ODSR
  std::uint32_t interrupts_ = 0;          // IMR
  std::uint32_t status_ = 0;              // ISR
  std::uint32_t is_open_drain_ = 0;       // MDSR
  std::uint32_t no_pull_up_ = 0;          // PUSR
  std::uint32_t select_b_ = 0;            // ABSR
  std::uint32_t may_write_directly_ = 0;  // OWSR
  std::uint32_t uses_chosen_mode_ = 0;    // AIMMR: 1 uses the modes below, 0 both edges
  std::uint32_t on_level_ = 0;            // ELSR
  std::uint32_t rising_or_high_ = 0;      // FRLHSR
};

}  // namespace due_emulator
