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
// stand on an edge: a single count is no motion.
constexpr std::uint32_t kStill_counts = 1;

// Above its rest the arm may still stand on the table: zero and rest are known to about a degree.
constexpr Quantity kTable_rad = Quantity::of(2.0F * kRadPerDeg);

// What the drive did on average before the axis came to rest, over 512 ticks: where a swing turns
// round, the drive of a single tick may be anything.
constexpr int kAveraging = 9;

Quantity averaged(Quantity average, Quantity now) {
  return Quantity::from_raw(average.raw() +
                            ((now.raw() >> kAveraging) - (average.raw() >> kAveraging)));
}

// Of counters that may wrap.
std::uint32_t distance(std::int32_t a, std::int32_t b) {
  const auto way = static_cast<std::uint32_t>(a) - static_cast<std::uint32_t>(b);
  return way < 0x80000000U ? way : 0U - way;
}

}  // namespace

TrackingLimits tracking_limits_of(const params::Params& params) {
  const auto rad = [&params](Param p) { return Quantity::of(params.get(p) * kRadPerDeg); };
  TrackingLimits l{};
  l.error_max_rad[kElevation] = rad(Param::elevation_following_max_deg);
  l.error_max_rad[kPitch] = rad(Param::pitch_following_max_deg);
  l.error_max_rad[kTravel] = rad(Param::travel_following_max_deg);
  l.following_ticks = ticks_of(params.get(Param::following_s));
  l.drive_max[kElevation] = Quantity::of(params.get(Param::elevation_motion_V));
  l.drive_max[kPitch] = Quantity::of(params.get(Param::pitch_motion_V));
  l.drive_max[kTravel] = rad(Param::travel_motion_deg);
  const std::uint32_t motion_ticks = ticks_of(params.get(Param::motion_s));
  l.motion_ticks[kElevation] = motion_ticks;
  l.motion_ticks[kPitch] = motion_ticks;
  l.motion_ticks[kTravel] = ticks_of(params.get(Param::travel_motion_s));
  l.dead_zone = control::DeadZone::of(params.get(Param::dead_zone_V));
  l.table_rad = rad(Param::elevation_rest_deg) + kTable_rad;
  l.hover_V = Quantity::of(params.get(Param::hover_V));
  return l;
}

Verdict Tracking::check(const Tracked& tracked, const TrackingLimits& limits) {
  const Observation& seen = tracked.seen;
  const Quantity front_V = lift_from_motor_V(seen.acted.front_V, limits.dead_zone);
  const Quantity back_V = lift_from_motor_V(seen.acted.back_V, limits.dead_zone);
  const Quantity drive[kAxisCount] = {front_V + back_V, front_V - back_V, seen.angle_rad[kPitch]};
  Verdict verdict{Fault::none, 0.0F};
  const bool on_table = seen.angle_rad[kElevation] < limits.table_rad;
  for (std::size_t i = 0; i < kAxisCount; ++i) {
    Axis& axis = axes_[i];
    // A tilt turns the arm only by the lift that it tilts.
    const bool lifts = i != kTravel || (!on_table && drive[kElevation] > limits.hover_V.half());
    const bool driven = lifts && (tracked.driven & (1U << i)) != 0U;
    const bool still = started_ && driven && distance(seen.count[i], axis.count) <= kStill_counts;
    axis.average = started_ ? averaged(axis.average, drive[i]) : drive[i];
    if (!still) {
      axis.count = seen.count[i];
      axis.drive = axis.average;
    }
    const Quantity apart = drive[i] - axis.drive;
    const Quantity change =
        i == kElevation && on_table ? drive[i] - limits.hover_V : magnitude(apart);
    // What is driven to and fro need not move.
    const bool forth = apart > Quantity{};
    axis.driven_ticks =
        still && change > limits.drive_max[i] && forth == axis.forth ? axis.driven_ticks + 1U : 0U;
    axis.forth = forth;
    const Quantity error_rad = magnitude(tracked.setpoint_rad[i] - seen.angle_rad[i]);
    const bool astray = (tracked.closed & (1U << i)) != 0U && error_rad > limits.error_max_rad[i];
    axis.error_ticks = astray && started_ ? axis.error_ticks + 1U : 0U;
    if (verdict.fault != Fault::none) {
      continue;
    }
    if (axis.driven_ticks > limits.motion_ticks[i]) {
      verdict = {kMotionless[i], i == kTravel ? change.to_float() * kDegPerRad : change.to_float()};
    } else if (axis.error_ticks > limits.following_ticks) {
      verdict = {kFollowing[i], error_rad.to_float() * kDegPerRad};
    }
  }
  started_ = true;
  return verdict;
}

}  // namespace heli::flight
