// The signals of an excitation, sample by sample, in fixed point: step, doublet, chirp, multisine,
// PRBS. start() and next() run in the tick.
#include "control/excitation.hpp"

#include <array>

#include "control/math.hpp"

namespace heli::control {

namespace {

using Kind = link::Excitation;

constexpr float kTurn = 4294967296.0F;  // phase units of one turn
constexpr float kStepPerHz = kTurn / kTickRate_Hz;

// Quarter wave with 15 bits behind the point, 64 steps; with linear interpolation the error stays
// below 8e-5.
constexpr std::size_t kQuarter = 64;

// Sine of x quarter turns, for x from 0 to 1, by its series; at compile time only.
constexpr double sine_of_quarter(double x) {
  const double angle = x * 1.5707963267948966;
  const double square = angle * angle;
  double term = angle;
  double sum = angle;
  for (int n = 1; n < 10; ++n) {
    term *= -square / ((2.0 * n) * (2.0 * n + 1.0));
    sum += term;
  }
  return sum;
}

constexpr std::array<std::int32_t, kQuarter + 2> make_quarter() {
  std::array<std::int32_t, kQuarter + 2> table{};
  for (std::size_t i = 0; i <= kQuarter; ++i) {
    table[i] = static_cast<std::int32_t>(
        32768.0 * sine_of_quarter(static_cast<double>(i) / static_cast<double>(kQuarter)) + 0.5);
  }
  table[kQuarter + 1] = table[kQuarter];
  return table;
}

constexpr std::array<std::int32_t, kQuarter + 2> kSine = make_quarter();
constexpr Share kOne = Share::of(1.0F);

// Sine of a phase (2^32 is one turn), with 15 bits behind the point. The two top bits are the
// quadrant. In fixed point, because sixteen of these per tick would cost 5,600 instructions in soft
// float.
std::int32_t sine_Q15(std::uint32_t phase) {
  const bool falling = (phase & 0x40000000U) != 0U;
  const std::uint32_t in_quarter = phase & 0x3fffffffU;
  const std::uint32_t position = falling ? 0x40000000U - in_quarter : in_quarter;
  const std::uint32_t index = position >> 24U;
  const auto fraction = static_cast<std::int32_t>((position >> 9U) & 0x7fffU);
  const std::int32_t low = kSine[index];
  const std::int32_t value = low + (((kSine[index + 1] - low) * fraction) >> 15U);
  return (phase & 0x80000000U) != 0U ? -value : value;
}

// The sum of eight tones of unit size with Schroeder's phases peaks below 4.6 (evaluated); it is
// scaled to stay within the requested amplitude.
constexpr Share kToneShare = Share::of(1.0F / 4.6F);

// Tones of both motors lie evenly between start and stop, in turns; 2^32 is the whole spread.
constexpr std::uint32_t kTonePosition = 0xffffffffU / (2U * Exciter::kTones - 1U);

std::uint32_t step_of(float frequency_Hz) {
  return static_cast<std::uint32_t>(frequency_Hz * kStepPerHz);
}

}  // namespace

void Exciter::start(const link::ExciteMessage& message) {
  kind_ = static_cast<Kind>(message.kind);
  amplitude_V_[0] = quantity_of(message.front_V);
  amplitude_V_[1] = quantity_of(message.back_V);
  tick_ = 0;
  const auto ticks = static_cast<std::uint32_t>(message.duration_s * kTickRate_Hz + 0.5F);
  duration_ticks_ = ticks == 0U ? 1U : ticks;
  prbs_register_ = message.seed;
  const float spread_Hz = message.stop_Hz - message.start_Hz;
  switch (kind_) {
    case Kind::chirp:
      phase_[0][0] = 0;
      chirp_step_ = message.start_Hz * kStepPerHz;
      chirp_growth_ = spread_Hz * kStepPerHz * reciprocal(static_cast<float>(duration_ticks_));
      break;
    case Kind::multisine:
      start_tones(step_of(message.start_Hz), step_of(spread_Hz));
      break;
    case Kind::prbs:
      phase_[0][0] = 0;
      step_[0][0] = step_of(message.stop_Hz);
      break;
    default:
      break;
  }
}

// Tones alternate between the motors: front, back, front ... from the lowest frequency upwards.
void Exciter::start_tones(std::uint32_t start, std::uint32_t spread) {
  for (std::uint32_t tone = 0; tone < kTones; ++tone) {
    for (std::uint32_t motor = 0; motor < 2; ++motor) {
      const std::uint64_t position = (2U * tone + motor) * kTonePosition;
      step_[motor][tone] = start + static_cast<std::uint32_t>((position * spread) >> 32U);
      // Schroeder: phase pi n^2 / N, here in turns n^2 / (2 N).
      phase_[motor][tone] = (tone * tone) << 28U;
    }
  }
}

Share Exciter::unit_amplitude(std::size_t motor) {
  switch (kind_) {
    case Kind::step:
      return kOne;
    case Kind::doublet:
      return 2U * tick_ < duration_ticks_ ? kOne : -kOne;
    case Kind::chirp:
      return Share::from_raw(sine_Q15(phase_[0][0]) * 0x8000);
    case Kind::multisine: {
      std::int32_t sum = 0;
      for (std::size_t tone = 0; tone < kTones; ++tone) {
        sum += sine_Q15(phase_[motor][tone]);
        phase_[motor][tone] += step_[motor][tone];
      }
      return clamp(product<30>(Fixed<15>::from_raw(sum), kToneShare), -kOne, kOne);
    }
    case Kind::prbs:
      // Two bits of one register, far apart: the motors get different sequences.
      return ((prbs_register_ >> (motor * 13U)) & 1U) != 0U ? kOne : -kOne;
    case Kind::none:
      break;
  }
  return {};
}

ExcitationValue Exciter::next() {
  if (kind_ == Kind::none) {
    return {};
  }
  if (tick_ >= duration_ticks_) {
    stop();
    return {};
  }
  const ExcitationValue value{unit_amplitude(0) * amplitude_V_[0],
                              unit_amplitude(1) * amplitude_V_[1]};
  if (kind_ == Kind::chirp) {
    phase_[0][0] += static_cast<std::uint32_t>(chirp_step_);
    chirp_step_ += chirp_growth_;
  } else if (kind_ == Kind::prbs) {
    const std::uint32_t before = phase_[0][0];
    phase_[0][0] += step_[0][0];
    if (phase_[0][0] < before) {
      // xorshift32: period 2^32 - 1 for any seed but 0.
      prbs_register_ ^= prbs_register_ << 13U;
      prbs_register_ ^= prbs_register_ >> 17U;
      prbs_register_ ^= prbs_register_ << 5U;
    }
  }
  ++tick_;
  return value;
}

}  // namespace heli::control
