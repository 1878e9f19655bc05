// Parts of a control loop: PID, the rate of an angle that comes in counts, bumpless transfer.
#pragma once

#include <cstdint>

#include "control/fixed.hpp"
#include "control/math.hpp"
#include "params/params.hpp"

// One PID loop: derivative of the measurement, and an integrator that stops at the output's limits.
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

// Rate of an angle that comes in encoder counts.

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

// Bumpless transfer from one source of a signal to another.

// The difference at the moment of the change is added to the new source and decays to zero.
class BumplessTransfer {
 public:
  Quantity apply(Quantity fresh, Quantity previous, bool changed, Share keep) {
    jump_ = changed ? previous - fresh : shrunk(jump_, keep);
    return fresh + jump_;
  }

  // As if the previous output had been larger by this much.
  void shift(Quantity by) { jump_ += by; }

  void clear() { jump_ = {}; }

 private:
  Quantity jump_;
};

// Share of a jump that remains after one tick. Divides, so for the idle loop only.
inline Share bumpless_keep_of(const params::Params& params) {
  return Share::of(1.0F - one_minus_exp(kTick_s / params.get(link::Param::bumpless_s)));
}

}  // namespace heli::control
