// Checks in flight that the arm moves as it is driven: following errors, and drives without motion.
//
// Neither an unplugged encoder nor a rotor without thrust makes an illegal transition: the counts
// just stop. The drive shows that they should not have stopped.
#pragma once

#include <cstdint>

#include "board.hpp"
#include "control/fixed.hpp"
#include "control/mixer.hpp"
#include "flight/balance.hpp"
#include "flight/blind_descent.hpp"
#include "flight/limits.hpp"
#include "flight/observation.hpp"
#include "flight/probe.hpp"
#include "flight/sign_check.hpp"
#include "params/params.hpp"

namespace heli::flight {

// Derived from the parameters in the idle loop.
struct TrackingLimits {
  Quantity error_max_rad[kAxisCount];  // following error
  // Change of drive that must move the axis: volts of lift for elevation (both rotors) and pitch
  // (front minus back). Unused for travel.
  Quantity drive_max[kAxisCount];
  BalanceLimits balance[kAxisCount];
  SignLimits sign[kAxisCount];  // unused for elevation: the table shows its sign
  ProbeLimits probe{};
  // An update of one axis takes place every kTrackingSlots ticks, 4 ms.
  std::uint32_t motion_updates = 0;     // for so long a driven axis may stay still
  std::uint32_t following_updates = 0;  // for so long an error may exceed error_max_rad
  control::DeadZone dead_zone;
  Quantity table_rad;    // below this elevation the table may carry the arm
  Quantity tilt_rad;     // above this elevation a probing tilt may begin
  Gain lift_per_rad;     // change of the hover lift with elevation, as a share of the level arm's
  Gain hover_V_per_rad;  // change of the hover lift with elevation
  Gain pitch_V_per_rad;  // front minus back that holds a tilt, per rad of pitch
  Quantity hover_V;      // lift of both rotors that carries the level arm
  Quantity lift_max_V;   // and that carries it at its highest elevation
};

TrackingLimits tracking_limits_of(const params::Params& params);

// Inputs of the checks, once a tick.
struct TrackingInput {
  const Observation& observation;
  Quantity setpoint_rad[kAxisCount];  // that the control law followed
  std::uint8_t closed = 0;            // link::axes bits: axes with a closed loop
  std::uint8_t driven = 0;            // and axes that must move when driven
  bool may_probe = false;  // a tilt may test travel: a compiled controller holds it, undisturbed
  bool descends = false;   // the arm lands: a suspicion about travel is then a fault
};

// Called by the supervisor in the tick; nothing here is called from the idle loop.
class Tracking {
 public:
  // Forgets all motion, because the motors were off.
  void restart() { started_ = 0; }

  // Checks the axis whose turn it is in this tick: whether it moves as it is driven.
  Verdict check(const TrackingInput& input, const TrackingLimits& limits);

  // For a tick that check() does not use: tests by a tilt whether travel's encoder still counts.
  static bool is_turn_to_probe(std::uint32_t tick) { return tick % kTrackingSlots == kAxisCount; }
  Verdict probe_travel(const TrackingInput& input, const TrackingLimits& limits);
  link::Probe probe_event() const { return probe_event_; }
  const Probe& probe() const { return probe_; }
  // The descent from the last hover of which the encoders knew, within this time.
  // `lifted_off`: elevation has counted in this flight.
  BlindDescent blind_descent(bool lifted_off, std::uint32_t duration_ticks,
                             const TrackingLimits& limits) const;
  // Whether the voltages lift the arm noticeably.
  static bool lifts(const Observation& observation, const TrackingLimits& limits);
  bool is_probing() const { return (started_ & kProbeStarted) != 0U && probe_.is_tilting(); }

 private:
  struct Axis {
    std::int32_t count = 0;            // at the last motion
    Quantity drive_average;            // over the last half second
    Quantity drive;                    // drive_average at the last motion
    bool driven_up = false;            // sign of the drive's change since then
    std::uint32_t driven_updates = 0;  // consecutive updates driven but still
    std::uint32_t error_updates = 0;   // consecutive updates with a following error too large
    Balance balance;
    SignCheck sign;
  };

  static constexpr std::uint8_t kProbeStarted = 1U << kAxisCount;

  // Whether the integrated drive should have moved the axis. Dry friction may hold travel, so
  // travel is at first only suspected, if a tilt may test it.
  bool is_motionless(std::size_t i, const TrackingInput& input, const TrackingLimits& limits);

  Axis axes_[kAxisCount];
  bool travel_suspected_ = false;  // from is_motionless() to the next probe_travel()
  Probe probe_;
  link::Probe probe_event_ = link::Probe::none;
  std::int32_t probe_count_ = 0;  // of travel, at its last motion
  Quantity stirred_pitch_rad_;    // pitch, when it last moved enough to disturb the arm
  std::uint8_t started_ = 0;      // link::axes bits, and kAsks
};

}  // namespace heli::flight
