#include "flight/balance.hpp"

namespace heli::flight {

using control::magnitude;

namespace {

// After T in one direction the observer has followed a quarter of what friction changed by when the
// direction turned, which is enough to tell a rig with friction from a rig without.
constexpr std::uint32_t kKnown_updates = std::uint32_t{1} << Balance::kShift;
// Learning is no faster than this, 0.128 s: in a fast turn counts come in each update.
constexpr std::uint32_t kLearnEvery_updates = 32;
// Share of the width that is forgotten in each of these steps: a quarter, in 0.5 s of motion.
constexpr int kForget = 2;
// Share of a drive beyond the range that may be an error of thrust or gain: an eighth.
constexpr int kUncertain = 3;

Quantity part(Quantity value, int shift) { return Quantity::from_raw(value.raw() >> shift); }

}  // namespace

void Balance::restart(const BalanceLimits& limits) {
  *this = Balance{};
  width_ = limits.width;
}

void Balance::update(Quantity angle_rad, Quantity drive, std::int32_t moved_counts,
                     const BalanceLimits& limits) {
  const Quantity turned = limits.drive_per_rad * angle_rad;
  if (!running_) {
    running_ = true;
    fast_ = turned + drive;
    slow_ = drive + drive;
    stay();
  }
  const Quantity balance = fast_ - turned;
  fast_ += part(slow_ - balance - balance, kShift);
  slow_ += part(drive - balance, kShift);
  ++same_way_updates_;
  if (moved_counts != 0) {
    stay();
    const bool up = moved_counts > 0;
    if (up != up_) {
      up_ = up;
      same_way_updates_ = 0;
      next_update_ = kKnown_updates;
    } else if (same_way_updates_ >= next_update_) {
      next_update_ = same_way_updates_ + kLearnEvery_updates;
      learn(balance, up);
    }
    return;
  }
  const Quantity beyond = excess(drive, limits);
  if ((beyond.raw() ^ rate_.raw()) < 0 || beyond == Quantity{}) {
    stay();
  }
  rate_ += part(beyond, kShift);
  moved_ += part(rate_, kShift);
}

void Balance::learn(Quantity balance, bool up) {
  balance_[up ? 1 : 0] = balance;
  const Quantity apart = magnitude(balance - balance_[up ? 0 : 1]);
  const Quantity kept = width_ - part(width_, kForget);
  width_ = apart > kept ? apart : kept;
}

Quantity Balance::excess(Quantity drive, const BalanceLimits& limits) const {
  const bool in_order = balance_[0] < balance_[1];
  const Quantity low = in_order ? balance_[0] : balance_[1];
  const Quantity high = in_order ? balance_[1] : balance_[0];
  const Quantity above = drive - high - width_;
  if (above > Quantity{}) {
    const Quantity sure = above - part(above, kUncertain) - limits.margin;
    return sure > Quantity{} ? sure : Quantity{};
  }
  const Quantity below = low - width_ - drive;
  const Quantity sure = below - part(below, kUncertain) - limits.margin;
  return sure > Quantity{} ? -sure : Quantity{};
}

}  // namespace heli::flight
