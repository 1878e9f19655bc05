// Rate of an angle that comes in encoder counts.
#pragma once

#include "control/fixed.hpp"

namespace heli::control {

// Two first-order low-passes in series; the rate is the slope of the second. Differencing a
// 4096-count angle at 1 kHz gives 0.31 rad/s of noise; two poles at 20 Hz leave about 0.01.
class RateFilter {
 public:
  // `smoothing` is 1 - exp(-2 pi f T), computed once for each change of the cut-off.
  Quantity update(Quantity angle_rad, Share smoothing) {
    if (!started_) {
      first_rad_ = angle_rad;
      second_rad_ = angle_rad;
      started_ = true;
    }
    first_rad_ += smoothing * (angle_rad - first_rad_);
    const Quantity step_rad = smoothing * (first_rad_ - second_rad_);
    second_rad_ += step_rad;
    return kTickRate * step_rad;
  }

  void restart() { started_ = false; }

 private:
  static constexpr Gain kTickRate = Gain::of(1000.0F);

  Quantity first_rad_;
  Quantity second_rad_;
  bool started_ = false;
};

}  // namespace heli::control
