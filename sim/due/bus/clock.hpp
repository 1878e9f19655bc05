// Board time and processor cycles. Peripherals and the processor count cycles of MCK; oscillators,
// encoders and the USB bridge live in board time, which goes on at its own pace when MCK changes.
#pragma once

#include <cstdint>

namespace due_emulator {

// Board time in 1/65536 of a cycle at 84 MHz; exact for 84, 12 and 4 MHz, 40 days in 48 bits.
using BoardTime = std::uint64_t;
inline constexpr std::uint32_t kFull_Hz = 84000000;
inline constexpr BoardTime kOneCycle = 1U << 16;
inline constexpr BoardTime kOneMs = BoardTime{kFull_Hz / 1000} * kOneCycle;
inline constexpr BoardTime kOneUs = BoardTime{kFull_Hz / 1000000} * kOneCycle;

class Clock {
 public:
  std::uint32_t mck_Hz() const { return mck_Hz_; }

  // From `cycle` on, the master clock has this frequency; the anchor is the time of that cycle.
  void set_mck(std::uint64_t cycle, std::uint32_t mck_Hz) {
    anchor_ = time_at(cycle);
    anchor_cycle_ = cycle;
    mck_Hz_ = mck_Hz;
    per_cycle_ = (BoardTime{kFull_Hz} * kOneCycle + mck_Hz / 2) / mck_Hz;
  }

  BoardTime time_at(std::uint64_t cycle) const {
    return anchor_ + (cycle - anchor_cycle_) * per_cycle_;
  }
  // First cycle whose time is not before `time`; times in the past give the anchor.
  std::uint64_t cycle_at(BoardTime time) const {
    if (time <= anchor_) return anchor_cycle_;
    return anchor_cycle_ + (time - anchor_ + per_cycle_ - 1) / per_cycle_;
  }

 private:
  BoardTime anchor_ = 0;
  std::uint64_t anchor_cycle_ = 0;
  // After reset MCK is the RC oscillator at 4 MHz.
  BoardTime per_cycle_ = BoardTime{kFull_Hz / 4000000} * kOneCycle;
  std::uint32_t mck_Hz_ = 4000000;
};

}  // namespace due_emulator
