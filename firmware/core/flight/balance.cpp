#include "flight/balance.hpp"

namespace heli::flight {

using control::magnitude;

namespace {

// After T in one direction the observer has followed a quarter of what friction changed by when the
// direction turned, which is enough to tell a rig with friction from a rig without.
constexpr std::uint32_t kKnown_updates = std::uint32_t{1} << Balance::kShift;
// The range is learned at most this often, 0.128 s: in a fast turn every update has counts.
constexpr std::uint32_t kLearnEvery_updates = 32;
// Share of the width that is forgotten in each of these steps: a quarter, in 0.5 s of motion.
constexpr int kForget = 2;
// Share of a drive beyond the range that may be an error of thrust or gain: an eighth.
constexpr int kUncertain = 3;

}  // namespace

void Balance::restart(const BalanceLimits& limits) {
  *this = Balance{};
  width_ = limits.width;
}

void Balance::update(Quantity angle_rad, Quantity rate_rad_s, Quantity drive,
                     std::int32_t moved_counts, const BalanceLimits& limits) {
  const Quantity turned = limits.drive_per_rad * angle_rad;
  if (!running_) {
    running_ = true;
    fast_ = turned + drive;
    slow_ = drive + drive;
    stay();
  }
  const Quantity balance = fast_ - turned;
  // Parts first: their differences need no saturation.
  fast_ += Quantity::from_raw((slow_.raw() >> kShift) - (balance.raw() >> (kShift - 1)));
  slow_ += Quantity::from_raw((drive.raw() >> kShift) - (balance.raw() >> kShift));
  ++same_way_updates_;
  if (moved_counts == 0) {
    integrate(drive, limits);
    return;
  }
  const bool up = moved_counts > 0;
  stay();
  coast(rate_rad_s, up, limits);
  if (up != up_) {
    up_ = up;
    same_way_updates_ = 0;
    next_update_ = kKnown_updates;
  } else if (same_way_updates_ >= next_update_) {
    next_update_ = same_way_updates_ + kLearnEvery_updates;
    learn(balance, up);
  }
}

// An axis cannot stop at once: it continues at the rate that it had, until friction stops it.
void Balance::coast(Quantity rate_rad_s, bool up, const BalanceLimits& limits) {
  const Quantity forth_rad_s = up ? rate_rad_s : -rate_rad_s;
  if (forth_rad_s > limits.noise_rad_s) {
    coasts_ = true;
    const Quantity sure_rad_s = rate_rad_s - rate_rad_s.shifted(kUncertain);
    rate_ = limits.speed_per_rad_s * sure_rad_s;
  }
}

void Balance::integrate(Quantity drive, const BalanceLimits& limits) {
  const auto [low, high] = range();
  const Quantity above = drive - high;
  const Quantity below = low - drive;
  beyond_ = above > below ? above : below;
  if (coasts_) {
    // The largest friction that this rig may have brakes it, not the friction estimated in flight.
    const Quantity brake =
        (limits.width > width_ ? limits.width - width_ : Quantity{}) + limits.margin;
    const bool forth = rate_ > Quantity{};
    rate_ += (forth ? above - brake : brake - below).shifted(kShift);
    if ((rate_ > Quantity{}) != forth) {
      stay();
    }
  } else {
    const Quantity sure = beyond_ - beyond_.shifted(kUncertain) - limits.margin;
    const bool forth = above > below;
    if (sure <= Quantity{} || (forth ? rate_ < Quantity{} : rate_ > Quantity{})) {
      stay();
    }
    if (sure > Quantity{}) {
      rate_ += (forth ? sure : -sure).shifted(kShift);
    }
  }
  moved_ += rate_.shifted(kShift);
}

void Balance::learn(Quantity balance, bool up) {
  balance_[up ? 1 : 0] = balance;
  const Quantity apart = magnitude(balance - balance_[up ? 0 : 1]);
  const Quantity kept = width_ - width_.shifted(kForget);
  width_ = apart > kept ? apart : kept;
}

Balance::Range Balance::range() const {
  const bool in_order = balance_[0] < balance_[1];
  return {(in_order ? balance_[0] : balance_[1]) - width_,
          (in_order ? balance_[1] : balance_[0]) + width_};
}

}  // namespace heli::flight
