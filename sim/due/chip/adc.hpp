// Analog-to-digital converter (section 43): sequences of channels, started by software or freely.
//
// What lies at the inputs is set from outside, in volts; the reference is the Due's 3.3 V.
#pragma once

#include <array>

#include "chip/peripheral.hpp"

namespace due_emulator {

class Adc final : public Peripheral {
 public:
  static constexpr int kChannels = 16;  // AD0 to AD14, and the chip's thermometer
  static constexpr double kReference_V = 3.3;

  explicit Adc(System& system);

  // The voltage at an input; one beyond the reference reads as its end.
  void set_input(int channel, double volts) {
    input_V_.at(static_cast<std::size_t>(channel)) = volts;
  }
  void reset() override;
  void event(std::uint64_t now) override;

 protected:
  std::uint32_t read(std::uint32_t offset) override;
  void write(std::uint32_t offset, std::uint32_t value) override;
  // LCDR and the channels' CDR follow the voltages.
  std::uint32_t from_outside(std::uint32_t offset) const override {
    return offset == 0x20 || (offset >= 0x50 && offset <= 0x8C) ? ~0U : 0;
  }

 private:
  void start();
  // Plans the end of the conversion of the first enabled channel from `channel` on, `wait` periods
  // of the converter's clock later than that alone takes; false: there is none.
  bool convert_from(int channel, std::uint64_t wait);
  void finish();
  void move();  // by the PDC
  std::uint64_t period() const;
  std::uint32_t flags() const;
  void update() { system_.set_irq(id::kAdc, (flags() & interrupts_) != 0); }
  void write_mode(std::uint32_t value);

  struct Transfer {
    std::uint32_t pointer = 0;
    std::uint32_t count = 0;
    std::uint32_t next_pointer = 0;
    std::uint32_t next_count = 0;
    bool enabled = false;
    bool ended = false;  // ENDRX
    bool full = false;   // RXBUFF
  };

  Scheduler::Id id_;
  std::array<double, kChannels> input_V_{};
  std::array<std::uint32_t, kChannels> data_{};  // CDR
  std::uint32_t mode_ = 0;                       // MR
  std::uint32_t channels_ = 0;                   // CHSR
  std::uint32_t complete_ = 0;                   // EOC of each channel
  std::uint32_t overruns_ = 0;                   // OVER
  std::uint32_t interrupts_ = 0;                 // IMR
  std::uint32_t extended_ = 0;                   // EMR
  std::uint32_t last_ = 0;                       // LCDR
  std::uint32_t window_ = 0;                     // CWR
  std::uint32_t analog_ = 0;                     // ACR
  Transfer transfer_;
  bool ready_ = false;    // DRDY
  bool overrun_ = false;  // GOVRE
  bool awake_ = false;    // the start-up time has been spent
  int running_ = -1;      // channel under conversion
};

}  // namespace due_emulator
