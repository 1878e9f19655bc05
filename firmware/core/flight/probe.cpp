#include "flight/probe.hpp"

#include "control/math.hpp"
#include "flight/balance.hpp"

namespace heli::flight {

using Answer = link::Probe;

namespace {

// An arm that dry friction holds is tilted again after 2.5 s, 5 s and then every 10 s; an arm that
// moves by itself, after 2.5 s.
constexpr std::uint8_t kMostPatience = 2;
// Counts within this time, 3 s, are regarded as caused by the tilt.
constexpr std::uint32_t kAftermath_updates = 750;
// Longest tilt to one side, 2 s: twice what pitch needs to follow. Longer, a dead axis turns by
// more than 30 degrees.
constexpr std::uint32_t kLongest_updates = 500;
// Pitch that has moved by kStir_rad (tracking.cpp) stirs the arm for so long, 1 s. Whatever turns
// travel shows in pitch first, also a travel loop that winds up. Where pitch is still, as in a
// simulation without disturbances, silence shows nothing, and a tilt would only disturb the flight.
// Longer: a step that settles in calm ends in a tilt. Shorter: a dead axis under weak disturbances
// is probed late.
constexpr std::uint32_t kStirred_updates = 250;
// The pitch at which the arm was still, over half a second.
constexpr int kPitchAveraging = 7;

Quantity towards(Quantity from, Quantity to, Quantity step) {
  return from + control::clamp(to - from, -step, step);
}

}  // namespace

Answer Probe::update(const Asked& axis, const ProbeLimits& limits) {
  if (stage_ == Stage::listens) {
    balance_rad_ += (axis.pitch_rad - balance_rad_).shifted(kPitchAveraging);
    return listen(axis, limits);
  }
  return axis.held ? tilt(axis, limits) : end(Answer::stopped);
}

Answer Probe::listen(const Asked& axis, const ProbeLimits& limits) {
  // Counts long after the last probe were not caused by it: the encoder works, so the next probe
  // again follows after a short silence.
  ++calm_updates_;
  if (axis.moved && calm_updates_ > kAftermath_updates) {
    patience_ = 0;
  }
  // Silence only counts while pitch counts: without any motion, a working encoder is silent too.
  still_updates_ = axis.stirred ? 0U : still_updates_ + 1U;
  if (axis.moved || !axis.held) {
    silent_updates_ = 0;
  } else if (still_updates_ < kStirred_updates) {
    ++silent_updates_;
  }
  const bool silent = silent_updates_ >= limits.silence_updates << patience_;
  const bool steady = control::magnitude(axis.pitch_rad - balance_rad_) < limits.steady_rad &&
                      control::magnitude(balance_rad_) < limits.most_rad;
  if (limits.silence_updates == 0U || !axis.may_begin || !steady || !(silent || axis.doubted)) {
    return Answer::none;
  }
  for (std::size_t side = 0; side < 2; ++side) {
    rate_[side] = {};
    turned_[side] = {};
    most_[side] = {};
  }
  // Against the loop first: its error may be what turns an arm that it cannot see. Towards the
  // setpoint, which suits an arm that friction holds, dead axes were off by half as much again.
  side_ = axis.error_rad > Quantity{} ? 1 : 0;
  tilted_updates_ = 0;
  tilt_rad_ = {};
  stage_ = Stage::first;
  return Answer::asked;
}

Answer Probe::tilt(const Asked& axis, const ProbeLimits& limits) {
  if (axis.moved) {
    patience_ = patience_ < kMostPatience ? static_cast<std::uint8_t>(patience_ + 1U) : patience_;
    return end(Answer::counts);
  }
  const Quantity away_rad = axis.lift * (axis.pitch_rad - balance_rad_);
  integrate(0, away_rad - limits.friction_rad);
  integrate(1, -away_rad - limits.friction_rad);
  if (most_[side_] > limits.moved_least) {
    if (stage_ == Stage::second) {
      return end(Answer::silent);
    }
    stage_ = Stage::second;
    side_ ^= 1U;
    tilted_updates_ = 0;
  } else if (++tilted_updates_ > kLongest_updates) {
    return end(Answer::stopped);
  }
  tilt_rad_ = towards(tilt_rad_, side_ == 0U ? limits.tilt_rad : -limits.tilt_rad, limits.step_rad);
  return Answer::none;
}

Answer Probe::end(Answer answer) {
  silent_updates_ = 0;
  calm_updates_ = 0;
  stage_ = Stage::listens;
  return answer;
}

// Motion from rest; friction stops the axis when the tilt does not drive it.
void Probe::integrate(std::size_t side, Quantity beyond) {
  rate_[side] += beyond.shifted(Balance::kShift);
  if (rate_[side] < Quantity{}) {
    rate_[side] = {};
    turned_[side] = {};
  }
  turned_[side] += rate_[side].shifted(Balance::kShift);
  most_[side] = turned_[side] > most_[side] ? turned_[side] : most_[side];
}

}  // namespace heli::flight
