// What the PWM outputs do over time: the comparator's waveform, overrides, faults, mean duty.
#include <algorithm>

#include "chip/pwm.hpp"

namespace due_emulator {

namespace {

// PWM_CMR
constexpr std::uint32_t kPolarity = 1U << 9;     // CPOL
constexpr std::uint32_t kInvertHigh = 1U << 17;  // DTHI
constexpr std::uint32_t kInvertLow = 1U << 18;   // DTLI

}  // namespace

// Cycles of MCK per count, by CPRE: a power of 2, or clock A (11) or B (12) of PWM_CLK, which
// divides by DIVA or DIVB times a power of 2.
std::uint64_t Pwm::step_cycles(int channel) const {
  const std::uint32_t prescaler = counter_of(channel).mode & 0xFU;
  if (prescaler <= 10) return std::uint64_t{1} << prescaler;
  const std::uint32_t half = prescaler == 11 ? clock_ & 0xFFFFU : clock_ >> 16;
  const std::uint32_t divider = half & 0xFFU;
  return divider == 0 ? 0 : std::uint64_t{divider} << std::min((half >> 8) & 0xFU, 10U);
}

// Period in cycles; a centre-aligned counter runs up and down in it.
std::uint64_t Pwm::period_of(int channel) const {
  const std::uint64_t counts = counter_of(channel).period;
  return counts * step_cycles(channel) * (center(channel) ? 2 : 1);
}

std::uint32_t Pwm::period_cycles(int channel) const {
  return static_cast<std::uint32_t>(period_of(channel));
}

// Whether the channel's counter runs.
bool Pwm::counts(int channel) const {
  return channels_[index(channel)].enabled && period_of(channel) != 0 && system_.clocked(clock_id_);
}

// Level of the comparator output. With CPOL = 0 it is low while the counter is below CDTY; with
// CPOL = 1 it is high there.
bool Pwm::comparator_level(int channel, std::uint64_t now) const {
  const Channel& state = channels_[index(channel)];
  const bool start_level = (state.mode & kPolarity) != 0;
  if (!counts(channel)) return start_level;
  const std::uint64_t whole = period_of(channel);
  const std::uint64_t phase = (now - counter_of(channel).origin) % whole;
  // The counter reaches CDTY at `edge`; centre-aligned, it falls below it again at `back`.
  const std::uint64_t edge = std::min(state.duty * step_cycles(channel), whole);
  const std::uint64_t back = center(channel) ? whole - std::min(edge, whole) : whole;
  const bool beyond = phase >= edge && phase < back;
  return beyond != start_level;
}

// Cycles in [from, to) during which the comparator output is high.
std::uint64_t Pwm::comparator_high(int channel, std::uint64_t from, std::uint64_t to) const {
  const Channel& state = channels_[index(channel)];
  const bool start_level = (state.mode & kPolarity) != 0;
  if (!counts(channel)) return start_level ? to - from : 0;
  const std::uint64_t whole = period_of(channel);
  const std::uint64_t edge = std::min(state.duty * step_cycles(channel), whole);
  const std::uint64_t back = center(channel) ? whole - edge : whole;
  const std::uint64_t width = back > edge ? back - edge : 0;
  const std::uint64_t origin = counter_of(channel).origin;
  // Cycles from the origin to `time` with the counter at or above CDTY.
  const auto beyond_until = [&](std::uint64_t time) {
    const std::uint64_t since = time - origin;
    const std::uint64_t phase = since % whole;
    const std::uint64_t part = phase > edge ? std::min(phase - edge, width) : 0;
    return since / whole * width + part;
  };
  const std::uint64_t beyond = beyond_until(to) - beyond_until(from);
  return start_level ? (to - from) - beyond : beyond;
}

std::uint32_t Pwm::faults_active(int channel) const {
  // Synchronous channels take the enable bits of channel 0 instead of their own.
  return faults_ & fault_enable_[synchronous(channel) ? 0 : index(channel)];
}

// Whether a fault or an override (which has less priority) holds the output; `level` is where.
bool Pwm::forced(int channel, bool low_side, bool& level) const {
  const unsigned bit = static_cast<unsigned>(channel) + (low_side ? 16U : 0U);
  if (faults_active(channel) != 0) {
    level = ((fault_values_ >> bit) & 1U) != 0;
    return true;
  }
  if (((override_ >> bit) & 1U) != 0) {
    level = ((override_value_ >> bit) & 1U) != 0;
    return true;
  }
  return false;
}

// Level of an output now: PWML is the complement of PWMH.
bool Pwm::level(int signal) const {
  const int channel = signal % kLowSide;
  const bool low_side = signal >= kLowSide;
  bool value = false;
  if (forced(channel, low_side, value)) return value;
  const std::uint32_t mode = channels_[index(channel)].mode;
  const bool inverted = (mode & (low_side ? kInvertLow : kInvertHigh)) != 0;
  return (comparator_level(channel, system_.now()) != low_side) != inverted;
}

// Counts the cycles up to `until` in which each output of the channel was high. Everything that
// changes an output calls this first.
void Pwm::integrate(int channel, std::uint64_t until) {
  Channel& state = channels_[index(channel)];
  if (until <= state.counted) return;
  const std::uint64_t span = until - state.counted;
  const std::uint64_t high = comparator_high(channel, state.counted, until);
  for (const bool low_side : {false, true}) {
    bool value = false;
    const bool inverted = (state.mode & (low_side ? kInvertLow : kInvertHigh)) != 0;
    if (forced(channel, low_side, value)) {
      state.high[low_side] += value ? span : 0;
    } else {
      state.high[low_side] += low_side != inverted ? span - high : high;
    }
  }
  state.counted = until;
}

void Pwm::integrate_all(std::uint64_t until) {
  for (int channel = 0; channel < kPwmChannels; ++channel) integrate(channel, until);
}

std::uint64_t Pwm::high_cycles(int channel, bool low_side) {
  integrate(channel, system_.now());
  return channels_[index(channel)].high[low_side];
}

// See pwm.hpp: the mean over one whole period with the values that act now.
double Pwm::duty(int channel, bool low_side) const {
  bool value = false;
  if (forced(channel, low_side, value)) return value ? 1.0 : 0.0;
  const Channel& state = channels_[index(channel)];
  const bool inverted = (state.mode & (low_side ? kInvertLow : kInvertHigh)) != 0;
  const bool complement = low_side != inverted;
  if (!counts(channel)) return ((state.mode & kPolarity) != 0) != complement ? 1.0 : 0.0;
  const std::uint64_t origin = counter_of(channel).origin;
  const std::uint64_t whole = period_of(channel);
  const std::uint64_t high = comparator_high(channel, origin, origin + whole);
  return static_cast<double>(complement ? whole - high : high) / static_cast<double>(whole);
}

// The cycle after `after` at which the channel's next period begins.
std::uint64_t Pwm::next_period(int channel, std::uint64_t after) const {
  const std::uint64_t whole = period_of(channel);
  const std::uint64_t origin = counter_of(channel).origin;
  if (after < origin) return origin;
  return origin + ((after - origin) / whole + 1) * whole;
}

}  // namespace due_emulator
