// Thresholds and checks of "driven, but no motion" and of the following error; see tracking.hpp.
// All of it runs in the tick (timer interrupt), except tracking_limits_of() and its helpers, which
// run in the idle loop.
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
// Elevation's sign is checked at take-off, by the table; see update_floor().
constexpr Fault kSign[kAxisCount] = {Fault::none, Fault::pitch_sign, Fault::travel_sign};
constexpr Fault kMotionless[kAxisCount] = {Fault::elevation_motionless, Fault::pitch_motionless,
                                           Fault::travel_motionless};

// One of an encoder's two lines may still toggle when the other is broken, and an arm at rest may
// stand on an edge: a single count does not show a motion.
constexpr std::int32_t kStillMax_counts = 1;

// Above its rest the arm may still stand on the table: zero and rest are known to about a degree.
constexpr Quantity kTable_rad = Quantity::of(2.0F * kRadPerDeg);

// Above its rest the short arm may tilt without touching the table.
constexpr Quantity kTilt_rad = Quantity::of(8.0F * kRadPerDeg);

// What the drive did on average before the axis came to rest, over 512 ticks: where a swing turns
// round, the drive of a single tick may be anything.
constexpr int kAverageShift = 7;
// A change of pitch that should move travel. Lower: a step that settles in calm air ends in a tilt,
// because pitch is still moving when travel is silent. Higher: weak disturbances turn a dead axis
// before it is probed. Moderate ones change the pitch of the paper's rig by 0.7 degrees in 0.55 s.
constexpr Quantity kStirringPitch_rad = Quantity::of(0.7F * kRadPerDeg);

// Shares of the drive that must move an axis (parameters elevation_motion_V and the like).
struct Shares {
  float half_width;  // half of the range that may hold it before the flight has shown more
  float margin;      // noise of the observer, and variation of a rig's own friction
};
// Set on 133 healthy flights of 19 rigs, of which the worst stays at 0.8 of the limit (an encoder
// with play) and 0.7 on elevation. Travel with margins twice as wide misses dead encoders in calm
// flight; with two thirds of it, a rig with 5 mN m of dry friction is landed. Elevation and pitch
// with margins twice as wide let the arm reach its stop.
constexpr Shares kShares[kAxisCount] = {{1.0F, 0.08F}, {1.0F, 0.1F}, {0.375F, 0.02F}};

// First-order low-pass: moves the average by 1/128 of its distance to `now`, per update of 4 ms.
Quantity low_pass(Quantity drive_average, Quantity now) {
  return Quantity::from_raw(drive_average.raw() + ((now.raw() >> kAverageShift) -
                                                   (drive_average.raw() >> kAverageShift)));
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

// A sign is judged by drives that must move the axis, after the rate's filter has settled, and for
// so long that they change the rate by more than two counts do. On the paper's rig these are 17
// degrees per second of pitch and 2.4 of travel. A torque on the axis must exceed 1.5 times the
// drive to be taken for a wrong sign.
constexpr float kSignSettles_s[kAxisCount] = {0.0F, 0.04F, 0.25F};
constexpr float kSignTime_s[kAxisCount] = {0.0F, 0.2F, 0.6F};
// Pitch this far against a drive that must move it: the rotors' difference, which may be a third of
// the lift of a hover, turns it by 3 degrees. Travel is turned farther by cables.
constexpr float kSignError_rad[kAxisCount] = {0.0F, 5.0F * kRadPerDeg, 100.0F};
constexpr Quantity kSignTurned_rad = Quantity::of(1.0F * kRadPerDeg);

// Returns `to` minus `from` in counts; counters may wrap.
std::int32_t count_difference(std::int32_t from, std::int32_t to) {
  return static_cast<std::int32_t>(static_cast<std::uint32_t>(to) -
                                   static_cast<std::uint32_t>(from));
}

bool is_still(std::int32_t moved) {
  return moved >= -kStillMax_counts && moved <= kStillMax_counts;
}

// Updates of one axis in this time, rounded up.
std::uint32_t updates_of(float seconds) {
  return (ticks_of(seconds) + kTrackingSlots - 1U) / kTrackingSlots;
}

// The parameters of one axis: [drive / (rad/s2)], [drive], and [s].
struct AxisParams {
  Param gain;
  Param motion;
  Param motion_s;
};
constexpr AxisParams kAxisParams[kAxisCount] = {
    {Param::elevation_gain, Param::elevation_motion_V, Param::motion_s},
    {Param::pitch_gain, Param::pitch_motion_V, Param::motion_s},
    {Param::travel_gain, Param::travel_motion_deg, Param::travel_motion_s}};

// A rate jumps at each count by the count times the filter's bandwidth, here in counts per turn.
// Two such jumps in a row are a motion.
constexpr float kRateNoise = 2.0F * 2.0F * control::kPi * 2.0F * control::kPi;

// The drive that must move the axis, held for motion_s, integrates twice to half of their product
// with motion_s.
BalanceLimits balance_limits_of(const params::Params& params, std::size_t axis) {
  const AxisParams& axis_params = kAxisParams[axis];
  const float drive_unit = axis == kTravel ? kRadPerDeg : 1.0F;
  const float motion_drive = params.get(axis_params.motion) * drive_unit;
  const float time_ratio = params.get(axis_params.motion_s) / Balance::kTime_s;
  const float drive_per_rad =
      1.0F / (params.get(axis_params.gain) * Balance::kTime_s * Balance::kTime_s);
  BalanceLimits limits{};
  limits.drive_per_rad = Gain::of(drive_per_rad);
  limits.half_width = Quantity::of(kShares[axis].half_width * motion_drive);
  limits.margin = Quantity::of(kShares[axis].margin * motion_drive);
  limits.expected_motion_max = Quantity::of(0.5F * motion_drive * time_ratio * time_ratio);
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

SignLimits sign_limits_of(const params::Params& params, std::size_t axis) {
  const float drive_unit = axis == kTravel ? kRadPerDeg : 1.0F;
  const float drive_min = params.get(kAxisParams[axis].motion) * drive_unit;
  SignLimits limits{};
  limits.drive_min = Quantity::of(drive_min);
  limits.impulse_min = Quantity::of(drive_min * kSignTime_s[axis] / Balance::kTime_s);
  limits.settle_updates = updates_of(kSignSettles_s[axis]);
  limits.error_max_rad = Quantity::of(kSignError_rad[axis]);
  limits.turned_min_rad = kSignTurned_rad;
  return limits;
}

// The tilts are shares of travel_motion_deg, the tilt that must move travel.
ProbeLimits probe_limits_of(const params::Params& params) {
  const float pitch_max_rad = params.get(Param::travel_motion_deg) * kRadPerDeg;
  const float silence_s = params.get(Param::travel_silence_s);
  const float drive_per_rad =
      1.0F / (params.get(Param::travel_gain) * Balance::kTime_s * Balance::kTime_s);
  ProbeLimits limits{};
  // A tilt that the loop's limits reduce would show nothing.
  const float room_rad =
      params.get(Param::pitch_setpoint_max_deg) * kRadPerDeg - kProbeTilt * pitch_max_rad;
  const bool possible = room_rad > 0.0F;
  limits.pitch_max_rad = Quantity::of(room_rad);
  limits.silence_updates = possible ? updates_of(silence_s) : 0U;
  limits.tilt_rad = Quantity::of(kProbeTilt * pitch_max_rad);
  limits.step_rad =
      Quantity::of(kProbeTilt * pitch_max_rad / static_cast<float>(updates_of(kProbeRise_s)));
  limits.steady_rad = Quantity::of(kSteadyTilt * pitch_max_rad);
  limits.friction_rad = Quantity::of(kFrictionTilt * pitch_max_rad);
  limits.expected_travel_min = Quantity::of(kAnswer_rad * drive_per_rad);
  return limits;
}

// The share of the lift that carries the arm at this elevation. A lower arm may need less.
control::Share lift_at(Quantity elevation_rad, Gain lift_per_rad) {
  constexpr Quantity kOne = Quantity::of(1.0F);
  const Quantity lift = control::clamp(kOne + lift_per_rad * elevation_rad, Quantity{}, kOne);
  return control::Share::from_raw(lift.raw() * (1 << (30 - 24)));
}

// Values for the event: volts, and the angle in degrees by which travel must have turned.
float event_value(std::size_t axis, Quantity drive, Quantity moved, const BalanceLimits& limits) {
  if (axis != kTravel) {
    return magnitude(drive).to_float();
  }
  const float drive_per_rad = limits.drive_per_rad.to_float();
  return moved.to_float() * control::reciprocal(drive_per_rad) * kDegPerRad;
}

}  // namespace

TrackingLimits tracking_limits_of(const params::Params& params) {
  const auto rad = [&params](Param p) { return Quantity::of(params.get(p) * kRadPerDeg); };
  TrackingLimits limits{};
  limits.error_max_rad[kElevation] = rad(Param::elevation_following_max_deg);
  limits.error_max_rad[kPitch] = rad(Param::pitch_following_max_deg);
  limits.error_max_rad[kTravel] = rad(Param::travel_following_max_deg);
  limits.following_updates = updates_of(params.get(Param::following_s));
  limits.drive_max[kElevation] = Quantity::of(params.get(Param::elevation_motion_V));
  limits.drive_max[kPitch] = Quantity::of(params.get(Param::pitch_motion_V));
  limits.motion_updates = updates_of(params.get(Param::motion_s));
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    limits.balance[axis] = balance_limits_of(params, axis);
    limits.sign[axis] = sign_limits_of(params, axis);
  }
  limits.probe = probe_limits_of(params);
  limits.dead_zone = control::DeadZone::of(params.get(Param::dead_zone_V));
  limits.table_rad = rad(Param::elevation_rest_deg) + kTable_rad;
  limits.tilt_rad = rad(Param::elevation_rest_deg) + kTilt_rad;
  limits.hover_V = Quantity::of(params.get(Param::hover_V));
  limits.lift_max_V =
      Quantity::of(params.get(Param::hover_V) +
                   params.get(Param::hover_slope) * params.get(Param::elevation_max_deg));
  limits.lift_per_rad =
      Gain::of(params.get(Param::hover_slope) * kDegPerRad / params.get(Param::hover_V));
  limits.hover_V_per_rad = Gain::of(params.get(Param::hover_slope) * kDegPerRad);
  limits.pitch_V_per_rad = Gain::of(params.get(Param::pitch_hold_ff) * kDegPerRad);
  return limits;
}

Verdict Tracking::check(const TrackingInput& input, const TrackingLimits& limits) {
  const Observation& observation = input.observation;
  // One axis per tick, in turn: this spreads the work; see kTrackingSlots.
  // The caller uses the fourth slot for probe_travel(), so `i` is an axis.
  const std::size_t i = observation.tick % kTrackingSlots;
  const auto bit = static_cast<std::uint8_t>(1U << i);
  Axis& axis = axes_[i];
  if ((started_ & bit) == 0U) {
    axis = Axis{};
    axis.balance.restart(limits.balance[i]);
  }

  // The drive, computed from the voltages that were applied in the previous tick.
  const Quantity front_V = lift_from_motor_V(observation.applied.front_V, limits.dead_zone);
  const Quantity back_V = lift_from_motor_V(observation.applied.back_V, limits.dead_zone);
  const Quantity lift_V = front_V + back_V;
  const bool on_table = observation.angle_rad[kElevation] < limits.table_rad;
  // A tilt turns the arm only by the lift that it tilts.
  const bool rotors_lift = !on_table && (i == kElevation || lift_V > limits.hover_V.half());
  const bool driven = (input.driven & bit) != 0U;
  // What drives the axis: lift beyond hover [V], difference of the lifts [V], or pitch [rad].
  const Quantity drive = i == kElevation ? lift_V - limits.hover_V
                         : i == kPitch   ? front_V - back_V
                                         : observation.angle_rad[kPitch];
  const bool was_started = (started_ & bit) != 0U;
  started_ |= bit;
  const std::int32_t moved = count_difference(axis.count, observation.count[i]);
  const bool still = was_started && driven && is_still(moved);

  // First check: the drive in excess of what may hold the axis, integrated twice (balance.hpp).
  if (rotors_lift && driven) {
    const Quantity net_drive =
        i == kElevation ? drive - limits.hover_V_per_rad * observation.angle_rad[i]
        : i == kPitch   ? drive - limits.pitch_V_per_rad * observation.angle_rad[i]
                        : drive;
    axis.balance.update(observation.angle_rad[i], observation.rate_rad_s[i], net_drive,
                        still ? 0 : moved, limits.balance[i]);
  } else {
    axis.balance.pause();
  }
  if (i == kTravel && is_probing()) {
    // A probing tilt is not judged by its drive: it ends level, and without speed.
    axis.balance.restart_integration();
  }
  // Second check, elevation and pitch: a change of drive since the last motion that lasts too long.
  if (i != kTravel) {
    axis.drive_average = was_started ? low_pass(axis.drive_average, drive) : drive;
    if (!still) {
      axis.drive = axis.drive_average;
    }
    const Quantity drive_change = drive - axis.drive;
    const Quantity judged_drive = i == kElevation && on_table ? drive : magnitude(drive_change);
    // An axis that is driven in alternating directions need not move.
    const bool driven_up = drive_change > Quantity{};
    axis.driven_updates = still && judged_drive > limits.drive_max[i] && driven_up == axis.driven_up
                              ? axis.driven_updates + 1U
                              : 0U;
    axis.driven_up = driven_up;
  }
  if (!still) {
    axis.count = observation.count[i];
  }

  // Third check: a following error that lasts too long.
  const Quantity error_rad = magnitude(input.setpoint_rad[i] - observation.angle_rad[i]);
  const bool error_is_large = (input.closed & bit) != 0U && error_rad > limits.error_max_rad[i];
  axis.error_updates = error_is_large && was_started ? axis.error_updates + 1U : 0U;

  if (i != kElevation && !axis.sign.is_confirmed() && driven && (i == kPitch || rotors_lift) &&
      axis.sign.is_wrong(
          {drive, observation.rate_rad_s[i], limits.balance[i].speed_per_rad_s,
           observation.angle_rad[i], input.setpoint_rad[i] - observation.angle_rad[i]},
          limits.sign[i])) {
    return {kSign[i], drive.to_float() * (i == kTravel ? kDegPerRad : 1.0F)};
  }
  if (axis.driven_updates > limits.motion_updates || is_motionless(i, input, limits)) {
    return {kMotionless[i],
            event_value(i, drive, axis.balance.expected_motion(), limits.balance[i])};
  }
  if (axis.error_updates > limits.following_updates) {
    return {kFollowing[i], error_rad.to_float() * kDegPerRad};
  }
  return {Fault::none, 0.0F};
}

// The drive when elevation last counted held the last hover; an arm that has never counted was
// lifted by the present one. It is not more than the highest elevation needs: an arm that runs away
// upwards is driven by more.
BlindDescent Tracking::blind_descent(bool lifted_off, std::uint32_t duration_ticks,
                                     const TrackingLimits& limits) const {
  const Axis& elevation = axes_[kElevation];
  const Quantity drive_V = lifted_off ? elevation.drive : elevation.drive_average;
  const Quantity lift_V = control::clamp(limits.hover_V + drive_V, Quantity{}, limits.lift_max_V);
  return {lift_V, axes_[kPitch].drive, duration_ticks};
}

// An eighth of a hover carries no arm that comes down by its weight.
bool Tracking::lifts(const Observation& observation, const TrackingLimits& limits) {
  return lift_from_motor_V(observation.applied.front_V, limits.dead_zone) +
             lift_from_motor_V(observation.applied.back_V, limits.dead_zone) >
         limits.hover_V.shifted(3);
}

bool Tracking::is_motionless(std::size_t i, const TrackingInput& input,
                             const TrackingLimits& limits) {
  const Balance& balance = axes_[i].balance;
  const Quantity motion_max = limits.balance[i].expected_motion_max;
  if (i != kTravel) {
    return balance.expected_motion() > motion_max;
  }
  // Without a probe, the drive alone decides. In a landing half the bound does: a landing on a dead
  // encoder must not close the travel loop.
  if (!input.may_probe || limits.probe.silence_updates == 0U || balance.is_coasting() ||
      balance.excess_drive() > limits.probe.friction_rad) {
    return balance.expected_motion() > (input.descends ? motion_max.half() : motion_max);
  }
  // With a probe, the first bound only asks for a tilt; three times the bound is a fault.
  travel_suspected_ = balance.expected_motion() > motion_max;
  return balance.expected_motion() > motion_max + motion_max + motion_max;
}

Verdict Tracking::probe_travel(const TrackingInput& input, const TrackingLimits& limits) {
  const Observation& observation = input.observation;
  if ((started_ & kProbeStarted) == 0U) {
    started_ |= kProbeStarted;
    probe_.restart();
    probe_count_ = observation.count[kTravel];
    stirred_pitch_rad_ = observation.angle_rad[kPitch];
  }

  // Has pitch, or travel, moved since the last update that showed a motion?
  const bool pitch_moved =
      magnitude(observation.angle_rad[kPitch] - stirred_pitch_rad_) > kStirringPitch_rad;
  if (pitch_moved) {
    stirred_pitch_rad_ = observation.angle_rad[kPitch];
  }
  const bool moved = !is_still(count_difference(probe_count_, observation.count[kTravel]));
  if (moved) {
    probe_count_ = observation.count[kTravel];
  }

  // A silent encoder is a fault; the event's value is how far the arm must have turned.
  const Quantity elevation_rad = observation.angle_rad[kElevation];
  probe_event_ =
      probe_.update({input.may_probe && elevation_rad > limits.table_rad,
                     elevation_rad > limits.tilt_rad, travel_suspected_, moved, pitch_moved,
                     input.setpoint_rad[kTravel] - observation.angle_rad[kTravel],
                     observation.angle_rad[kPitch], lift_at(elevation_rad, limits.lift_per_rad)},
                    limits.probe);
  travel_suspected_ = false;
  if (probe_event_ == link::Probe::silent) {
    return {Fault::travel_motionless,
            event_value(kTravel, {}, probe_.expected_travel(), limits.balance[kTravel])};
  }
  return {Fault::none, 0.0F};
}

}  // namespace heli::flight
