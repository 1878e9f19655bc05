// One PID loop: derivative on the measurement, integrator that knows what the actuator achieved.
#pragma once

#include "control/math.hpp"

namespace heli::control {

struct PidGains {
  float kp;            // output per rad
  float ki_per_tick;   // output per rad and tick
  float kd;            // output per rad/s
  float integral_max;  // bound of the integrator's share of the output
};

class Pid {
 public:
  float output(const PidGains& gains, float error_rad, float rate_rad_s) const {
    return gains.kp * error_rad + integral_ - gains.kd * rate_rad_s;
  }

  // `excess` is wanted minus achieved output. The integrator stands still while it would only
  // push further into the limit, and moves freely out of it.
  void integrate(const PidGains& gains, float error_rad, float excess) {
    if (excess * error_rad > 0.0F) {
      return;
    }
    integral_ =
        clamp(integral_ + gains.ki_per_tick * error_rad, -gains.integral_max, gains.integral_max);
  }

  void reset() { integral_ = 0.0F; }
  float integral() const { return integral_; }

 private:
  float integral_ = 0.0F;
};

}  // namespace heli::control
