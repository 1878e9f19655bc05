// Digital-to-analog converter (section 44): two channels behind a queue of four values.
#pragma once

#include <array>
#include <deque>

#include "chip/peripheral.hpp"

namespace due_emulator {

class Dacc final : public Peripheral {
 public:
  static constexpr int kChannels = 2;

  explicit Dacc(System& system);

  // The voltage at an output of the Due; 0 while its channel is off.
  double output_V(int channel) const;
  void reset() override;
  void event(std::uint64_t now) override;

 protected:
  std::uint32_t read(std::uint32_t offset) override;
  void write(std::uint32_t offset, std::uint32_t value) override;

 private:
  void queue(std::uint32_t half_word);
  std::uint32_t flags() const;
  void update() { system_.set_irq(id::kDacc, (flags() & interrupts_) != 0); }

  struct Value {
    std::size_t channel;
    std::uint32_t code;
  };

  Scheduler::Id id_;
  std::deque<Value> waiting_;  // the first one is under conversion
  std::array<std::uint32_t, kChannels> code_{};
  std::uint32_t mode_ = 0;        // MR
  std::uint32_t channels_ = 0;    // CHSR
  std::uint32_t interrupts_ = 0;  // IMR
  std::uint32_t analog_ = 0;      // ACR
  bool complete_ = false;         // EOC
};

}  // namespace due_emulator
