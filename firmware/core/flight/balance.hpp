// The drive that would hold an axis where it is, and how far the axis must have moved without it.
//
// Computes how far an axis must have moved while its encoder does not count.
//
// A dead encoder reads like an arm at rest. An arm at rest is balanced: its drive cancels all other
// torques on it. While counts come, a disturbance observer estimates the drive that would balance
// the axis. Dry friction makes that drive depend on the direction of motion, so a range of drives
// can hold the axis. While no counts come, the drive beyond that range is integrated twice.
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
  Gain drive_per_rad;   // acceleration as drive: this drive changes the rate by 1 rad/T in T
  Quantity half_width;  // half of the range of drives that may hold it, before it has moved
  Quantity margin;      // added to that range: noise of the observer, variation of friction
  Quantity expected_motion_max;  // bound of expected_motion(): drive times T squared
  Gain speed_per_rad_s;          // converts a rate to an integrated drive (drive times T)
  Quantity noise_rad_s;          // a measured rate up to here may come from single counts
};

class Balance {
 public:
  // T, the time constant of the observer and the unit of time: 256 updates, 1.024 s. Shorter, the
  // quantisation of the encoder shows as friction; longer, a turn of travel ends before its
  // friction has shown.
  static constexpr int kShift = 8;
  static constexpr float kTime_s = 256.0F * static_cast<float>(kTrackingSlots) * 0.001F;

  // Forgets all estimates of the axis.
  void restart(const BalanceLimits& limits);
  // The axis cannot move freely, such as on the table; earlier estimates stay valid.
  void pause() {
    running_ = false;
    restart_integration();
  }
  // The drive since the last count does not show that it has moved; earlier estimates stay valid.
  void restart_integration() {
    coasting_ = false;
    expected_rate_ = Quantity{};
    expected_motion_ = Quantity{};
  }
  // `moved_counts` since the last update with a motion: 0 while the axis is still.
  void update(Quantity angle_rad, Quantity rate_rad_s, Quantity drive, std::int32_t moved_counts,
              const BalanceLimits& limits);
  // How far the axis must have moved since it last counted, as `expected_motion_max`.
  Quantity expected_motion() const { return control::magnitude(expected_motion_); }
  // Whether expected_motion() follows from the rate at which it last moved.
  bool is_coasting() const { return coasting_; }
  // The last drive beyond the range that may hold the axis.
  Quantity excess_drive() const { return excess_drive_; }

 private:
  // Drives that may hold the axis.
  struct HoldingRange {
    Quantity low;
    Quantity high;
  };

  void start_coasting(Quantity rate_rad_s, bool moving_up, const BalanceLimits& limits);
  void learn_half_width(Quantity balancing_drive, bool moving_up);
  void integrate_excess(Quantity drive, const BalanceLimits& limits);
  HoldingRange holding_range() const;

  // The observer: a second-order low-pass with two poles at -1/T.
  Quantity observer_output_;        // angle as a drive, plus the balancing drive
  Quantity observer_state_;         // its derivative in units of T, plus twice that drive
  Quantity balance_when_moved_[2];  // the balancing drive when the axis last moved down and up
  Quantity half_width_;             // of the holding range, learned in flight
  Quantity expected_rate_;          // excess drive, integrated once: drive times T
  Quantity expected_motion_;
  Quantity excess_drive_;
  std::uint32_t same_way_updates_ = 0;
  std::uint32_t next_learning_update_ = 0;
  bool coasting_ = false;
  bool moving_up_ = false;
  bool running_ = false;
};

}  // namespace heli::flight
