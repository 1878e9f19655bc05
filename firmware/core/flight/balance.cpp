// The disturbance observer of one axis and the motion that its drive must cause; see balance.hpp.
// Runs in the tick, every 4 ms per axis.
#include "flight/balance.hpp"

namespace heli::flight {

using control::magnitude;

namespace {

// After T in one direction the observer has followed a quarter of what friction changed by when the
// direction turned, which is enough to tell a rig with friction from a rig without.
constexpr std::uint32_t kMinOneWay_updates = std::uint32_t{1} << Balance::kShift;
// The range is learned at most this often, 0.128 s: in a fast turn every update has counts.
constexpr std::uint32_t kLearnEvery_updates = 32;
// Share of the half-width, as a shift to the right, that is forgotten in each of these steps: a
// quarter, in 0.5 s of motion.
constexpr int kForgetShift = 2;
// Share of a drive beyond the range, as a shift, that may be an error of thrust or gain: an eighth.
constexpr int kUncertaintyShift = 3;

}  // namespace

void Balance::restart(const BalanceLimits& limits) {
  *this = Balance{};
  half_width_ = limits.half_width;
}

void Balance::update(Quantity angle_rad, Quantity rate_rad_s, Quantity drive,
                     std::int32_t moved_counts, const BalanceLimits& limits) {
  // The observer estimates the drive that would balance the axis. In units of T its state equations
  // are output' = state - 2 balance and state' = drive - balance; a shift by kShift is one update.
  const Quantity angle_as_drive = limits.drive_per_rad * angle_rad;
  if (!running_) {
    // At the start the axis is regarded as balanced by the present drive.
    running_ = true;
    observer_output_ = angle_as_drive + drive;
    observer_state_ = drive + drive;
    restart_integration();
  }
  const Quantity balancing_drive = observer_output_ - angle_as_drive;
  // Parts first: their differences need no saturation.
  observer_output_ += Quantity::from_raw((observer_state_.raw() >> kShift) -
                                         (balancing_drive.raw() >> (kShift - 1)));
  observer_state_ +=
      Quantity::from_raw((drive.raw() >> kShift) - (balancing_drive.raw() >> kShift));
  ++same_way_updates_;

  // Still: integrate the drive. Moving: expect it to coast, and learn the range of friction.
  if (moved_counts == 0) {
    integrate_excess(drive, limits);
    return;
  }
  const bool moving_up = moved_counts > 0;
  restart_integration();
  start_coasting(rate_rad_s, moving_up, limits);
  if (moving_up != moving_up_) {
    moving_up_ = moving_up;
    same_way_updates_ = 0;
    next_learning_update_ = kMinOneWay_updates;
  } else if (same_way_updates_ >= next_learning_update_) {
    next_learning_update_ = same_way_updates_ + kLearnEvery_updates;
    learn_half_width(balancing_drive, moving_up);
  }
}

// An axis cannot stop at once: it continues at the rate that it had, until friction stops it.
void Balance::start_coasting(Quantity rate_rad_s, bool moving_up, const BalanceLimits& limits) {
  const Quantity speed_rad_s = moving_up ? rate_rad_s : -rate_rad_s;
  if (speed_rad_s > limits.noise_rad_s) {
    coasting_ = true;
    const Quantity certain_rate_rad_s = rate_rad_s - rate_rad_s.shifted(kUncertaintyShift);
    expected_rate_ = limits.speed_per_rad_s * certain_rate_rad_s;
  }
}

// Integrates the drive beyond the holding range twice, to the motion that it must have caused.
void Balance::integrate_excess(Quantity drive, const BalanceLimits& limits) {
  const auto [low, high] = holding_range();
  const Quantity above = drive - high;
  const Quantity below = low - drive;
  excess_drive_ = above > below ? above : below;
  if (coasting_) {
    // The largest friction that this rig may have brakes it, not the friction estimated in flight.
    const Quantity braking_drive =
        (limits.half_width > half_width_ ? limits.half_width - half_width_ : Quantity{}) +
        limits.margin;
    const bool expected_up = expected_rate_ > Quantity{};
    expected_rate_ += (expected_up ? above - braking_drive : braking_drive - below).shifted(kShift);
    if ((expected_rate_ > Quantity{}) != expected_up) {
      restart_integration();
    }
  } else {
    // From rest: the part of the excess that is certain accelerates the axis.
    const Quantity certain_excess =
        excess_drive_ - excess_drive_.shifted(kUncertaintyShift) - limits.margin;
    const bool expected_up = above > below;
    if (certain_excess <= Quantity{} ||
        (expected_up ? expected_rate_ < Quantity{} : expected_rate_ > Quantity{})) {
      restart_integration();
    }
    if (certain_excess > Quantity{}) {
      expected_rate_ += (expected_up ? certain_excess : -certain_excess).shifted(kShift);
    }
  }
  expected_motion_ += expected_rate_.shifted(kShift);
}

// Friction shows as the difference of the balancing drives of motion up and motion down. The
// half-width becomes this difference at once if it is larger, and otherwise decays towards it.
void Balance::learn_half_width(Quantity balancing_drive, bool moving_up) {
  balance_when_moved_[moving_up ? 1 : 0] = balancing_drive;
  const Quantity friction_range =
      magnitude(balancing_drive - balance_when_moved_[moving_up ? 0 : 1]);
  const Quantity remembered_half_width = half_width_ - half_width_.shifted(kForgetShift);
  half_width_ = friction_range > remembered_half_width ? friction_range : remembered_half_width;
}

Balance::HoldingRange Balance::holding_range() const {
  const bool in_order = balance_when_moved_[0] < balance_when_moved_[1];
  return {(in_order ? balance_when_moved_[0] : balance_when_moved_[1]) - half_width_,
          (in_order ? balance_when_moved_[1] : balance_when_moved_[0]) + half_width_};
}

}  // namespace heli::flight
