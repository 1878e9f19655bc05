// Rate of an angle that comes in encoder counts.
#pragma once

#include "control/math.hpp"

namespace heli::control {

// Two first-order low-passes in series; the rate is the slope of the second. Differencing a
// 4096-count angle at 1 kHz gives 0.31 rad/s of noise; two poles at 20 Hz leave about 0.01.
class RateFilter {
 public:
  // `smoothing` is 1 - exp(-2 pi f T), computed once for each change of the cut-off.
  float update(float angle_rad, float smoothing) {
    if (!started_) {
      first_rad_ = angle_rad;
      second_rad_ = angle_rad;
      started_ = true;
    }
    first_rad_ += smoothing * (angle_rad - first_rad_);
    const float step_rad = smoothing * (first_rad_ - second_rad_);
    second_rad_ += step_rad;
    return step_rad * kTickRate_Hz;
  }

  void restart() { started_ = false; }

 private:
  float first_rad_ = 0.0F;
  float second_rad_ = 0.0F;
  bool started_ = false;
};

}  // namespace heli::control
