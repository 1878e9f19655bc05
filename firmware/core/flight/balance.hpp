// The drive that would hold an axis where it is, and how far the axis must have moved without it.
//
// A dead encoder reads like an arm at rest. An arm at rest is balanced: its drive cancels what else
// acts on it. While counts come, a disturbance observer estimates the drive that would balance the
// axis. Dry friction makes that drive depend on the way the axis moves, so a range of drives can
// hold it. While no counts come, the drive beyond that range is integrated twice.
#pragma once

#include <cstdint>

#include "control/fixed.hpp"

namespace heli::flight {

using control::Gain;
using control::Quantity;

// Ticks between two updates of one axis: each tick looks at one axis, and the fourth rests.
inline constexpr std::uint32_t kTrackingSlots = 4;

// A drive is in volts of lift for elevation and pitch, and in rad of pitch for travel.
struct BalanceLimits {
  Gain drive_per_rad;    // the drive that turns the axis by one radian in T squared
  Quantity width;        // half of the range of drives that may hold it, before it has moved
  Quantity margin;       // of that range: noise of the observer, and what friction varies by
  Quantity moved_max;    // excess drive, integrated twice over the time in units of T
  Gain speed_per_rad_s;  // of the integrated drive, per rate of the axis
  Quantity noise_rad_s;  // of a measured rate: what one count shows
};

class Balance {
 public:
  // T, the time constant of the observer and the unit of time: 256 updates, 1.024 s. Shorter, the
  // quantisation of the encoder shows as friction; longer, a turn of travel ends before its
  // friction has shown.
  static constexpr int kShift = 8;
  static constexpr float kTime_s = 256.0F * static_cast<float>(kTrackingSlots) * 0.001F;

  // Forgets all that was estimated for the axis.
  void restart(const BalanceLimits& limits);
  // The axis cannot move freely, such as on the table; earlier estimates stay valid.
  void pause() {
    running_ = false;
    stay();
  }
  // The drive since the last count does not show that it has moved; earlier estimates stay valid.
  void stay() {
    coasts_ = false;
    rate_ = Quantity{};
    moved_ = Quantity{};
  }
  // `moved_counts` since the last update with a motion: 0 while the axis is still.
  void update(Quantity angle_rad, Quantity rate_rad_s, Quantity drive, std::int32_t moved_counts,
              const BalanceLimits& limits);
  // How far the axis must have moved since it last counted, as `moved_max`.
  Quantity moved() const { return control::magnitude(moved_); }
  // Whether moved_max follows from the rate at which it last moved.
  bool coasts() const { return coasts_; }
  // The last drive beyond the range that may hold the axis.
  Quantity beyond() const { return beyond_; }

 private:
  // Drives that may hold the axis.
  struct Range {
    Quantity low;
    Quantity high;
  };

  void coast(Quantity rate_rad_s, bool up, const BalanceLimits& limits);
  void learn(Quantity balance, bool up);
  void integrate(Quantity drive, const BalanceLimits& limits);
  Range range() const;

  // The observer: a second-order low-pass with two poles at -1/T.
  Quantity fast_;
  Quantity slow_;
  Quantity balance_[2];  // the balancing drive when the axis last moved down and up
  Quantity width_;
  Quantity rate_;
  Quantity moved_;
  Quantity beyond_;
  std::uint32_t same_way_updates_ = 0;
  std::uint32_t next_update_ = 0;
  bool coasts_ = false;
  bool up_ = false;
  bool running_ = false;
};

}  // namespace heli::flight
