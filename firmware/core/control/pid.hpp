// One PID loop: derivative of the measurement, and an integrator that stops at the output's limits.
#pragma once

#include <cstdint>

#include "control/fixed.hpp"
#include "control/math.hpp"

namespace heli::control {

struct PidGains {
  Gain kp;                // output per rad
  Share ki_per_tick;      // output per rad and tick
  Gain kd;                // output per rad/s
  Quantity integral_max;  // bound of the integrator's share of the output
};

class Pid {
 public:
  // The unit of the output is the loop's: volts, or rad of pitch.
  Quantity output(const PidGains& gains, Quantity error_rad, Quantity rate_rad_s) const {
    // Summed before anything saturates: with large gains each term alone may exceed 128 while they
    // all but cancel. 2048 * 128, twice, is a quarter of what 64 bits hold with 44 behind the
    // point.
    const std::int64_t sum = exact_product(gains.kp, error_rad) -
                             exact_product(gains.kd, rate_rad_s) +
                             (integral_ >> (kIntegralBits - kGainBits));
    return Quantity::from_raw(shortened<kGainBits>(sum));
  }

  // `excess` is wanted minus achieved output. The integrator stands still while it would only
  // push further into the limit, and moves freely out of it.
  void integrate(const PidGains& gains, Quantity error_rad, Quantity excess) {
    const bool same_sign = (excess.raw() ^ error_rad.raw()) >= 0;
    if (same_sign && excess != Quantity{} && error_rad != Quantity{}) {
      return;
    }
    const std::int64_t integral_max_raw =
        gains.integral_max.raw() * (std::int64_t{1} << kIntegralBits);
    const std::int64_t step = exact_product(gains.ki_per_tick, error_rad);
    integral_ = clamp(integral_ + step, -integral_max_raw, integral_max_raw);
  }

  void reset() { integral_ = 0; }

 private:
  // Bits of the integral behind those of the output: those of a Share, so that each product is
  // added whole. A tick's share of a small error is below the resolution of the output.
  static constexpr int kIntegralBits = 30;
  // Bits of the integral behind those of a Gain.
  static constexpr int kGainBits = 20;

  std::int64_t integral_ = 0;
};

}  // namespace heli::control
