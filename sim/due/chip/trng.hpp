// True random number generator (section 42): 32 bits every 84 cycles of MCK. Here they follow from
// a seed, so that a simulation repeats; every start goes on in the sequence.
#pragma once

#include "chip/peripheral.hpp"

namespace due_emulator {

class Trng final : public Peripheral {
 public:
  static constexpr std::uint64_t kCycles = 84;

  explicit Trng(System& system);

  void seed(std::uint64_t seed) { state_ = seed; }
  void reset() override;
  void event(std::uint64_t now) override;

 protected:
  std::uint32_t read(std::uint32_t offset) override;
  void write(std::uint32_t offset, std::uint32_t value) override;

 private:
  void enable(bool on);
  // Makes the values of the time that has passed.
  void catch_up();
  void update();

  Scheduler::Id id_;
  std::uint64_t state_ = 1;
  bool enabled_ = false;
  bool masked_ = true;
  bool ready_ = false;
  std::uint64_t next_ = 0;  // cycle at which the next value is complete
  std::uint32_t value_ = 0;
};

}  // namespace due_emulator
