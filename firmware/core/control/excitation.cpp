#include "control/excitation.hpp"

#include <array>

#include "control/math.hpp"

namespace heli::control {

namespace {

using Kind = link::Excitation;

constexpr float kTurn = 4294967296.0F;  // phase units of one turn
constexpr float kStepPerHz = kTurn / kTickRate_Hz;

// Quarter wave in Q15, 64 steps; with linear interpolation the error stays below 8e-5.
constexpr std::size_t kQuarter = 64;

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
        32767.0 * sine_of_quarter(static_cast<double>(i) / static_cast<double>(kQuarter)) + 0.5);
  }
  table[kQuarter + 1] = table[kQuarter];
  return table;
}

constexpr std::array<std::int32_t, kQuarter + 2> kSine = make_quarter();
constexpr float kPerSine = 1.0F / 32767.0F;

// Sine of a phase in Q15, in integers: sixteen of these a tick would cost 5,600 instructions in
// soft float.
std::int32_t sine(std::uint32_t phase) {
  const bool falling = (phase & 0x40000000U) != 0U;
  const std::uint32_t in_quarter = phase & 0x3fffffffU;
  const std::uint32_t position = falling ? 0x40000000U - in_quarter : in_quarter;
  const std::uint32_t index = position >> 24U;
  const auto fraction = static_cast<std::int32_t>((position >> 9U) & 0x7fffU);
  const std::int32_t low = kSine[index];
  const std::int32_t value = low + (((kSine[index + 1] - low) * fraction) >> 15U);
  return (phase & 0x80000000U) != 0U ? -value : value;
}

// Eight Schroeder-phased tones of unit size peak below 4.6; the sum is scaled to stay within the
// amplitude that was asked for.
constexpr float kToneShare = 1.0F / 4.6F;

std::uint32_t step_of(float frequency_Hz) {
  return static_cast<std::uint32_t>(frequency_Hz * kStepPerHz);
}

}  // namespace

void Exciter::start(const link::ExciteMessage& message) {
  kind_ = static_cast<Kind>(message.kind);
  amplitude_V_[0] = message.front_V;
  amplitude_V_[1] = message.back_V;
  tick_ = 0;
  const auto ticks = static_cast<std::uint32_t>(message.duration_s * kTickRate_Hz + 0.5F);
  duration_ticks_ = ticks == 0U ? 1U : ticks;
  noise_ = message.seed;
  const float spread_Hz = message.stop_Hz - message.start_Hz;
  for (std::size_t motor = 0; motor < 2; ++motor) {
    for (std::size_t tone = 0; tone < kTones; ++tone) {
      const auto place = static_cast<float>(2 * tone + motor) * (1.0F / (2.0F * kTones - 1.0F));
      step_[motor][tone] = step_of(message.start_Hz + place * spread_Hz);
      // Schroeder: phase pi n^2 / N, here in turns n^2 / (2 N).
      phase_[motor][tone] = static_cast<std::uint32_t>(tone * tone) << 28U;
    }
    if (kind_ != Kind::multisine) {
      phase_[motor][0] = 0;
    }
  }
  chirp_step_ = message.start_Hz * kStepPerHz;
  chirp_growth_ = spread_Hz * kStepPerHz * reciprocal(static_cast<float>(duration_ticks_));
  if (kind_ == Kind::prbs) {
    step_[0][0] = step_of(message.stop_Hz);
  }
}

float Exciter::shape(std::size_t motor) {
  switch (kind_) {
    case Kind::step:
      return 1.0F;
    case Kind::doublet:
      return 2U * tick_ < duration_ticks_ ? 1.0F : -1.0F;
    case Kind::chirp:
      return static_cast<float>(sine(phase_[0][0])) * kPerSine;
    case Kind::multisine: {
      std::int32_t sum = 0;
      for (std::size_t tone = 0; tone < kTones; ++tone) {
        sum += sine(phase_[motor][tone]);
        phase_[motor][tone] += step_[motor][tone];
      }
      return clamp(static_cast<float>(sum) * (kPerSine * kToneShare), -1.0F, 1.0F);
    }
    case Kind::prbs:
      // Two bits of one register, far apart: the motors get different sequences.
      return ((noise_ >> (motor * 13U)) & 1U) != 0U ? 1.0F : -1.0F;
    case Kind::none:
      break;
  }
  return 0.0F;
}

ExcitationValue Exciter::next() {
  if (kind_ == Kind::none) {
    return {0.0F, 0.0F};
  }
  if (tick_ >= duration_ticks_) {
    stop();
    return {0.0F, 0.0F};
  }
  const ExcitationValue value{amplitude_V_[0] * shape(0), amplitude_V_[1] * shape(1)};
  if (kind_ == Kind::chirp) {
    phase_[0][0] += static_cast<std::uint32_t>(chirp_step_);
    chirp_step_ += chirp_growth_;
  } else if (kind_ == Kind::prbs) {
    const std::uint32_t before = phase_[0][0];
    phase_[0][0] += step_[0][0];
    if (phase_[0][0] < before) {
      // xorshift32: period 2^32 - 1 for any seed but 0.
      noise_ ^= noise_ << 13U;
      noise_ ^= noise_ >> 17U;
      noise_ ^= noise_ << 5U;
    }
  }
  ++tick_;
  return value;
}

}  // namespace heli::control
