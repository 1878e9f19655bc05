#include "flight/tracking.hpp"

#include "control/math.hpp"

namespace heli::flight {

using control::kDegPerRad;
using control::kRadPerDeg;
using control::lift_from_motor_V;
using control::ticks_of;
using link::Fault;
using link::Param;

namespace {

constexpr Fault kFollowing[kAxisCount] = {Fault::elevation_following, Fault::pitch_following,
                                          Fault::travel_following};
constexpr Fault kMotionless[kAxisCount] = {Fault::elevation_motionless, Fault::pitch_motionless,
                                           Fault::travel_motionless};

// One of an encoder's two lines may still toggle when the other is broken, and an arm at rest may
// stand on an edge: a single count does not show a motion.
constexpr std::int32_t kStill_counts = 1;

// Above its rest the arm may still stand on the table: zero and rest are known to about a degree.
constexpr Quantity kTable_rad = Quantity::of(2.0F * kRadPerDeg);

// Above its rest the short arm may tilt without touching the table.
constexpr Quantity kTilt_rad = Quantity::of(8.0F * kRadPerDeg);

// What the drive did on average before the axis came to rest, over 512 ticks: where a swing turns
// round, the drive of a single tick may be anything.
constexpr int kAveraging = 7;
// A change of pitch that should move travel. Lower: a step that settles in calm air ends in a tilt,
// because pitch is still moving when travel is silent. Higher: weak disturbances turn a dead axis
// before it is probed. Moderate ones change the pitch of the paper's rig by 0.7 degrees in 0.55 s.
constexpr Quantity kStir_rad = Quantity::of(0.7F * kRadPerDeg);

// Shares of the drive that must move an axis.
struct Shares {
  float width;   // half of the range that may hold it before the flight has shown more
  float margin;  // noise of the observer, and variation of a rig's own friction
};
// Set on 133 healthy flights of 19 rigs, of which the worst stays at 0.8 of the limit (an encoder
// with play) and 0.7 on elevation. Travel with margins twice as wide misses dead encoders in calm
// flight; with two thirds of it, a rig with 5 mN m of dry friction is landed. Elevation and pitch
// with margins twice as wide let the arm reach its stop.
constexpr Shares kShares[kAxisCount] = {{1.0F, 0.08F}, {1.0F, 0.1F}, {0.375F, 0.02F}};

Quantity averaged(Quantity average, Quantity now) {
  return Quantity::from_raw(average.raw() +
                            ((now.raw() >> kAveraging) - (average.raw() >> kAveraging)));
}

// The probing tilt relative to the one that must move travel: 12 degrees to 8 on the paper's rig.
// It must exceed dry friction.
constexpr float kProbeTilt = 1.5F;
// Time to reach that tilt: about the lag of pitch. In a shorter time, pitch overshoots.
constexpr float kProbeRise_s = 0.4F;
// The tilt that dry friction may hold, likewise: 4 degrees or 28 mN m on the paper's rig.
constexpr float kFrictionTilt = 0.5F;
// Pitch is steady within this of its average: 1.2 degrees. Beyond, the loop drives the arm already.
constexpr float kSteadyTilt = 0.15F;
// Travel by which the tilt must have turned the arm: the play of an encoder, and two counts.
constexpr float kAnswer_rad = 0.8F * kRadPerDeg;

// Difference of two counts; counters may wrap.
std::int32_t way(std::int32_t from, std::int32_t to) {
  return static_cast<std::int32_t>(static_cast<std::uint32_t>(to) -
                                   static_cast<std::uint32_t>(from));
}

bool within_count(std::int32_t moved) { return moved >= -kStill_counts && moved <= kStill_counts; }

std::uint32_t updates_of(float seconds) {
  return (ticks_of(seconds) + kTrackingSlots - 1U) / kTrackingSlots;
}

struct Names {
  Param gain;
  Param motion;
  Param motion_s;
};
constexpr Names kNames[kAxisCount] = {
    {Param::elevation_gain, Param::elevation_motion_V, Param::motion_s},
    {Param::pitch_gain, Param::pitch_motion_V, Param::motion_s},
    {Param::travel_gain, Param::travel_motion_deg, Param::travel_motion_s}};

// A rate jumps at each count by the count times the filter's bandwidth, here in counts per turn.
// Two such jumps in a row are a motion.
constexpr float kRateNoise = 2.0F * 2.0F * control::kPi * 2.0F * control::kPi;

// The drive that must move the axis, held for motion_s, integrates twice to half of their product
// with motion_s.
BalanceLimits balance_limits_of(const params::Params& params, std::size_t axis) {
  const Names& name = kNames[axis];
  const float unit = axis == kTravel ? kRadPerDeg : 1.0F;
  const float most = params.get(name.motion) * unit;
  const float times = params.get(name.motion_s) / Balance::kTime_s;
  const float drive_per_rad = 1.0F / (params.get(name.gain) * Balance::kTime_s * Balance::kTime_s);
  BalanceLimits limits{};
  limits.drive_per_rad = Gain::of(drive_per_rad);
  limits.width = Quantity::of(kShares[axis].width * most);
  limits.margin = Quantity::of(kShares[axis].margin * most);
  limits.moved_max = Quantity::of(0.5F * most * times * times);
  limits.speed_per_rad_s = Gain::of(drive_per_rad * Balance::kTime_s);
  // Only travel coasts, because nothing pulls it back. On the others a large drive shows the fault.
  if (axis == kTravel) {
    limits.noise_rad_s = Quantity::of(kRateNoise * params.get(Param::travel_filter_Hz) /
                                      control::magnitude(params.get(Param::travel_counts_per_rev)));
  } else {
    limits.noise_rad_s = Quantity::from_raw(INT32_MAX);
  }
  return limits;
}

ProbeLimits probe_limits_of(const params::Params& params) {
  const float most_rad = params.get(Param::travel_motion_deg) * kRadPerDeg;
  const float silence_s = params.get(Param::travel_silence_s);
  const float drive_per_rad =
      1.0F / (params.get(Param::travel_gain) * Balance::kTime_s * Balance::kTime_s);
  ProbeLimits limits{};
  // A tilt that the loop's limits reduce would show nothing.
  const float room_rad =
      params.get(Param::pitch_setpoint_max_deg) * kRadPerDeg - kProbeTilt * most_rad;
  const bool possible = room_rad > 0.0F;
  limits.most_rad = Quantity::of(room_rad);
  limits.silence_updates = possible ? updates_of(silence_s) : 0U;
  limits.tilt_rad = Quantity::of(kProbeTilt * most_rad);
  limits.step_rad =
      Quantity::of(kProbeTilt * most_rad / static_cast<float>(updates_of(kProbeRise_s)));
  limits.steady_rad = Quantity::of(kSteadyTilt * most_rad);
  limits.friction_rad = Quantity::of(kFrictionTilt * most_rad);
  limits.moved_least = Quantity::of(kAnswer_rad * drive_per_rad);
  return limits;
}

// The share of the lift that carries the arm at this elevation. A lower arm may need less.
control::Share lift_at(Quantity elevation_rad, Gain lift_per_rad) {
  constexpr Quantity kOne = Quantity::of(1.0F);
  const Quantity lift = control::clamp(kOne + lift_per_rad * elevation_rad, Quantity{}, kOne);
  return control::Share::from_raw(lift.raw() * (1 << (30 - 24)));
}

// Values for the event: volts, and the angle in degrees by which travel must have turned.
float seen_of(std::size_t axis, Quantity drive, Quantity moved, const BalanceLimits& limits) {
  if (axis != kTravel) {
    return magnitude(drive).to_float();
  }
  const float drive_per_rad = limits.drive_per_rad.to_float();
  return moved.to_float() * control::reciprocal(drive_per_rad) * kDegPerRad;
}

}  // namespace

TrackingLimits tracking_limits_of(const params::Params& params) {
  const auto rad = [&params](Param p) { return Quantity::of(params.get(p) * kRadPerDeg); };
  TrackingLimits l{};
  l.error_max_rad[kElevation] = rad(Param::elevation_following_max_deg);
  l.error_max_rad[kPitch] = rad(Param::pitch_following_max_deg);
  l.error_max_rad[kTravel] = rad(Param::travel_following_max_deg);
  l.following_updates = updates_of(params.get(Param::following_s));
  l.drive_max[kElevation] = Quantity::of(params.get(Param::elevation_motion_V));
  l.drive_max[kPitch] = Quantity::of(params.get(Param::pitch_motion_V));
  l.motion_updates = updates_of(params.get(Param::motion_s));
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    l.balance[axis] = balance_limits_of(params, axis);
  }
  l.probe = probe_limits_of(params);
  l.dead_zone = control::DeadZone::of(params.get(Param::dead_zone_V));
  l.table_rad = rad(Param::elevation_rest_deg) + kTable_rad;
  l.tilt_rad = rad(Param::elevation_rest_deg) + kTilt_rad;
  l.hover_V = Quantity::of(params.get(Param::hover_V));
  l.lift_per_rad =
      Gain::of(params.get(Param::hover_slope) * kDegPerRad / params.get(Param::hover_V));
  l.hover_V_per_rad = Gain::of(params.get(Param::hover_slope) * kDegPerRad);
  l.pitch_V_per_rad = Gain::of(params.get(Param::pitch_hold_ff) * kDegPerRad);
  return l;
}

Verdict Tracking::check(const Tracked& tracked, const TrackingLimits& limits) {
  const Observation& seen = tracked.seen;
  // One axis per tick, in turn: this spreads the work; see kTrackingSlots.
  const std::size_t i = seen.tick % kTrackingSlots;
  const auto bit = static_cast<std::uint8_t>(1U << i);
  Axis& axis = axes_[i];
  if ((started_ & bit) == 0U) {
    axis = Axis{};
    axis.balance.restart(limits.balance[i]);
  }
  const Quantity front_V = lift_from_motor_V(seen.acted.front_V, limits.dead_zone);
  const Quantity back_V = lift_from_motor_V(seen.acted.back_V, limits.dead_zone);
  const Quantity lift_V = front_V + back_V;
  const bool on_table = seen.angle_rad[kElevation] < limits.table_rad;
  // A tilt turns the arm only by the lift that it tilts.
  const bool lifts = !on_table && (i == kElevation || lift_V > limits.hover_V.half());
  const bool driven = (tracked.driven & bit) != 0U;
  // What drives the axis: lift beyond hover [V], difference of the lifts [V], or pitch [rad].
  const Quantity drive = i == kElevation ? lift_V - limits.hover_V
                         : i == kPitch   ? front_V - back_V
                                         : seen.angle_rad[kPitch];
  const bool started = (started_ & bit) != 0U;
  started_ |= bit;
  const std::int32_t moved = way(axis.count, seen.count[i]);
  const bool still = started && driven && within_count(moved);

  if (lifts && driven) {
    const Quantity free = i == kElevation ? drive - limits.hover_V_per_rad * seen.angle_rad[i]
                          : i == kPitch   ? drive - limits.pitch_V_per_rad * seen.angle_rad[i]
                                          : drive;
    axis.balance.update(seen.angle_rad[i], seen.rate_rad_s[i], free, still ? 0 : moved,
                        limits.balance[i]);
  } else {
    axis.balance.pause();
  }
  if (i == kTravel && asks()) {
    // A probing tilt is not judged by its drive: it ends level, and without speed.
    axis.balance.stay();
  }
  if (i != kTravel) {
    axis.average = started ? averaged(axis.average, drive) : drive;
    if (!still) {
      axis.drive = axis.average;
    }
    const Quantity apart = drive - axis.drive;
    const Quantity change = i == kElevation && on_table ? drive : magnitude(apart);
    // An axis that is driven in alternating directions need not move.
    const bool forth = apart > Quantity{};
    axis.driven_updates = still && change > limits.drive_max[i] && forth == axis.forth
                              ? axis.driven_updates + 1U
                              : 0U;
    axis.forth = forth;
  }
  if (!still) {
    axis.count = seen.count[i];
  }
  const Quantity error_rad = magnitude(tracked.setpoint_rad[i] - seen.angle_rad[i]);
  const bool astray = (tracked.closed & bit) != 0U && error_rad > limits.error_max_rad[i];
  axis.error_updates = astray && started ? axis.error_updates + 1U : 0U;
  if (axis.driven_updates > limits.motion_updates || is_motionless(i, tracked, limits)) {
    return {kMotionless[i], seen_of(i, drive, axis.balance.moved(), limits.balance[i])};
  }
  if (axis.error_updates > limits.following_updates) {
    return {kFollowing[i], error_rad.to_float() * kDegPerRad};
  }
  return {Fault::none, 0.0F};
}

bool Tracking::is_motionless(std::size_t i, const Tracked& tracked, const TrackingLimits& limits) {
  const Balance& balance = axes_[i].balance;
  const Quantity most = limits.balance[i].moved_max;
  if (i != kTravel) {
    return balance.moved() > most;
  }
  if (!tracked.may_ask || limits.probe.silence_updates == 0U || balance.coasts() ||
      balance.beyond() > limits.probe.friction_rad) {
    return balance.moved() > (tracked.descends ? most.half() : most);
  }
  doubted_ = balance.moved() > most;
  return balance.moved() > most + most + most;
}

Verdict Tracking::ask(const Tracked& tracked, const TrackingLimits& limits) {
  const Observation& seen = tracked.seen;
  if ((started_ & kAsks) == 0U) {
    started_ |= kAsks;
    probe_.restart();
    probe_count_ = seen.count[kTravel];
    stir_rad_ = seen.angle_rad[kPitch];
  }
  const bool stirred = magnitude(seen.angle_rad[kPitch] - stir_rad_) > kStir_rad;
  if (stirred) {
    stir_rad_ = seen.angle_rad[kPitch];
  }
  const bool moved = !within_count(way(probe_count_, seen.count[kTravel]));
  if (moved) {
    probe_count_ = seen.count[kTravel];
  }
  const Quantity elevation_rad = seen.angle_rad[kElevation];
  news_ = probe_.update(
      {tracked.may_ask && elevation_rad > limits.table_rad, elevation_rad > limits.tilt_rad,
       doubted_, moved, stirred, tracked.setpoint_rad[kTravel] - seen.angle_rad[kTravel],
       seen.angle_rad[kPitch], lift_at(elevation_rad, limits.lift_per_rad)},
      limits.probe);
  doubted_ = false;
  if (news_ == link::Probe::silent) {
    return {Fault::travel_motionless,
            seen_of(kTravel, {}, probe_.turned(), limits.balance[kTravel])};
  }
  return {Fault::none, 0.0F};
}

}  // namespace heli::flight
