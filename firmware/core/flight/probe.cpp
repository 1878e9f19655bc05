// The stages of a probing tilt: wait for a silence, tilt to one side, tilt to the other; see
// probe.hpp. Runs in the tick, every 4 ms.
#include "flight/probe.hpp"

#include "control/math.hpp"
#include "flight/balance.hpp"

namespace heli::flight {

using Answer = link::Probe;

namespace {

// An arm that dry friction holds is tilted again after 2.5 s, 5 s and then every 10 s; an arm that
// moves by itself, after 2.5 s.
constexpr std::uint8_t kMaxSilenceDoublings = 2;
// Counts within this time, 3 s, are regarded as caused by the tilt.
constexpr std::uint32_t kTiltEffect_updates = 750;
// Longest tilt to one side, 2 s: twice what pitch needs to follow. Longer, a dead axis turns by
// more than 30 degrees.
constexpr std::uint32_t kTiltMax_updates = 500;
// Pitch that has moved by kStirringPitch_rad (tracking.cpp) stirs the arm for so long, 1 s.
// Whatever turns travel shows in pitch first, also a travel loop that winds up. Where pitch is
// still, as in a simulation without disturbances, silence shows nothing, and a tilt would only
// disturb the flight. Longer: a step that settles in calm ends in a tilt. Shorter: a dead axis
// under weak disturbances is probed late.
constexpr std::uint32_t kPitchStillMax_updates = 250;
// The pitch at which the arm was still, over half a second.
constexpr int kPitchAveraging = 7;

// Returns `from`, moved towards `to` by at most `step`.
Quantity towards(Quantity from, Quantity to, Quantity step) {
  return from + control::clamp(to - from, -step, step);
}

}  // namespace

Answer Probe::update(const ProbeInput& axis, const ProbeLimits& limits) {
  if (stage_ == Stage::waits) {
    balance_rad_ += (axis.pitch_rad - balance_rad_).shifted(kPitchAveraging);
    return wait_for_silence(axis, limits);
  }
  return axis.is_held ? tilt(axis, limits) : end(Answer::stopped);
}

Answer Probe::wait_for_silence(const ProbeInput& axis, const ProbeLimits& limits) {
  // Counts long after the last probe were not caused by it: the encoder works, so the next probe
  // again follows after a short silence.
  ++since_probe_updates_;
  if (axis.moved && since_probe_updates_ > kTiltEffect_updates) {
    silence_doublings_ = 0;
  }
  // Silence only counts while pitch counts: without any motion, a working encoder is silent too.
  pitch_still_updates_ = axis.pitch_moved ? 0U : pitch_still_updates_ + 1U;
  if (axis.moved || !axis.is_held) {
    silent_updates_ = 0;
  } else if (pitch_still_updates_ < kPitchStillMax_updates) {
    ++silent_updates_;
  }
  const bool silent = silent_updates_ >= limits.silence_updates << silence_doublings_;
  const bool steady = control::magnitude(axis.pitch_rad - balance_rad_) < limits.steady_rad &&
                      control::magnitude(balance_rad_) < limits.pitch_max_rad;
  if (limits.silence_updates == 0U || !axis.may_begin || !steady || !(silent || axis.suspected)) {
    return Answer::none;
  }
  // Begin a probe: both sides start at rest.
  for (std::size_t side = 0; side < 2; ++side) {
    expected_rate_[side] = {};
    expected_travel_[side] = {};
    expected_travel_max_[side] = {};
  }
  // The first tilt is opposed to the loop, whose error may be what turns an arm that it cannot see.
  // A first tilt towards the setpoint suits an arm that friction holds, but then the error of arms
  // with a dead encoder was larger by a half.
  side_ = axis.error_rad > Quantity{} ? 1 : 0;
  tilt_updates_ = 0;
  tilt_rad_ = {};
  stage_ = Stage::first;
  return Answer::asked;
}

// One update of a tilt. A count ends the probe; otherwise the tilt that pitch has really followed
// is integrated twice, less the tilt that friction holds, to the travel that it must have caused.
Answer Probe::tilt(const ProbeInput& axis, const ProbeLimits& limits) {
  if (axis.moved) {
    silence_doublings_ = silence_doublings_ < kMaxSilenceDoublings
                             ? static_cast<std::uint8_t>(silence_doublings_ + 1U)
                             : silence_doublings_;
    return end(Answer::counts);
  }
  const Quantity tilt_from_balance_rad = axis.lift * (axis.pitch_rad - balance_rad_);
  integrate_motion(0, tilt_from_balance_rad - limits.friction_rad);
  integrate_motion(1, -tilt_from_balance_rad - limits.friction_rad);
  // Enough expected travel to this side: change sides, or report a silent encoder.
  if (expected_travel_max_[side_] > limits.expected_travel_min) {
    if (stage_ == Stage::second) {
      return end(Answer::silent);
    }
    stage_ = Stage::second;
    side_ ^= 1U;
    tilt_updates_ = 0;
  } else if (++tilt_updates_ > kTiltMax_updates) {
    return end(Answer::stopped);
  }
  tilt_rad_ = towards(tilt_rad_, side_ == 0U ? limits.tilt_rad : -limits.tilt_rad, limits.step_rad);
  return Answer::none;
}

Answer Probe::end(Answer answer) {
  silent_updates_ = 0;
  since_probe_updates_ = 0;
  stage_ = Stage::waits;
  return answer;
}

// Integrates the motion to one side from rest; friction stops the axis when the tilt does not drive
// it.
void Probe::integrate_motion(std::size_t side, Quantity excess_rad) {
  expected_rate_[side] += excess_rad.shifted(Balance::kShift);
  if (expected_rate_[side] < Quantity{}) {
    expected_rate_[side] = {};
    expected_travel_[side] = {};
  }
  expected_travel_[side] += expected_rate_[side].shifted(Balance::kShift);
  expected_travel_max_[side] = expected_travel_[side] > expected_travel_max_[side]
                                   ? expected_travel_[side]
                                   : expected_travel_max_[side];
}

}  // namespace heli::flight
