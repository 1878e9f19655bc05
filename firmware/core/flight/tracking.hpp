// Whether the arm does what it is driven to do: following errors, and drives without motion.
//
// Neither an unplugged encoder nor a rotor without thrust makes an illegal transition: the counts
// just stop. The drive shows that they should not have stopped.
#pragma once

#include <cstdint>

#include "board.hpp"
#include "control/fixed.hpp"
#include "control/mixer.hpp"
#include "flight/balance.hpp"
#include "flight/limits.hpp"
#include "flight/observation.hpp"
#include "flight/probe.hpp"
#include "params/params.hpp"

namespace heli::flight {

// Derived from the parameters in the idle loop.
struct TrackingLimits {
  Quantity error_max_rad[kAxisCount];
  // Bounds of drive: volts of lift for elevation (both rotors) and pitch (front minus back), and
  // the pitch angle, in rad, for travel.
  Quantity drive_max[kAxisCount];
  BalanceLimits balance[kAxisCount];
  ProbeLimits probe{};
  std::uint32_t motion_updates = 0;
  std::uint32_t following_updates = 0;
  control::DeadZone dead_zone;
  Quantity table_rad;    // below this elevation the table may carry the arm
  Quantity tilt_rad;     // above this elevation a tilt may ask
  Gain lift_per_rad;     // by which the share of the level arm's lift changes with elevation
  Gain hover_V_per_rad;  // by which the lift changes that carries the arm
  Gain pitch_V_per_rad;  // by which the difference changes that holds a tilt
  Quantity hover_V;      // lift that carries it; up to there nothing need move on the table
};

TrackingLimits tracking_limits_of(const params::Params& params);

// Inputs of the checks, once a tick.
struct Tracked {
  const Observation& seen;
  Quantity setpoint_rad[kAxisCount];  // that the control law followed
  std::uint8_t closed = 0;            // link::axes bits: axes held to a setpoint
  std::uint8_t driven = 0;            // and axes that must move when driven
  bool may_ask = false;   // a tilt may probe: the board's own law holds travel, undisturbed
  bool descends = false;  // a doubt about travel is a fault then: landing would close it
};

class Tracking {
 public:
  // Forgets all motion, because the motors were off.
  void restart() { started_ = 0; }

  // Checks the axis whose turn it is in this tick: whether it moves as it is driven.
  Verdict check(const Tracked& tracked, const TrackingLimits& limits);

  // In a tick that check() does not use. Probes by a tilt whether travel still counts.
  static bool is_turn_to_ask(std::uint32_t tick) { return tick % kTrackingSlots == kAxisCount; }
  Verdict ask(const Tracked& tracked, const TrackingLimits& limits);
  link::Probe news() const { return news_; }
  const Probe& probe() const { return probe_; }
  bool asks() const { return (started_ & kAsks) != 0U && probe_.asks(); }

 private:
  struct Axis {
    std::int32_t count = 0;  // where it was when it last moved
    Quantity average;        // of the drive, over the last half second
    Quantity drive;          // that average when it last moved
    bool forth = false;      // which way it was driven from there
    std::uint32_t driven_updates = 0;
    std::uint32_t error_updates = 0;
    Balance balance;
  };

  static constexpr std::uint8_t kAsks = 1U << kAxisCount;

  // Travel that dry friction may hold is at first only suspected, if a tilt may probe it.
  bool is_motionless(std::size_t i, const Tracked& tracked, const TrackingLimits& limits);

  Axis axes_[kAxisCount];
  bool doubted_ = false;
  Probe probe_;
  link::Probe news_ = link::Probe::none;
  std::int32_t probe_count_ = 0;  // of travel, when it last moved
  Quantity stir_rad_;             // pitch, when it last moved enough to stir the arm
  std::uint8_t started_ = 0;      // link::axes bits, and kAsks
};

}  // namespace heli::flight
