// Predicted angles and following errors of an uploaded law; see guard.hpp. The checks run in the
// tick, guard_limits_of() in the idle loop.
#include "law/guard.hpp"

#include "control/math.hpp"

namespace heli::law {

using control::ControlInput;
using control::kDegPerRad;
using control::kRadPerDeg;
using control::lift_from_motor_V;
using control::magnitude;
using control::Share;
using link::Param;

namespace {

constexpr Takeover kEnvelope[kAxisCount] = {Takeover::elevation_envelope, Takeover::pitch_envelope,
                                            Takeover::travel_envelope};
constexpr Takeover kFollowing[kAxisCount] = {Takeover::elevation_following,
                                             Takeover::pitch_following, Takeover::travel_following};

// Time until the voltages of another law act as thrust: the slowest rotors measured lag by 0.15 s.
constexpr Share kReaction_s = Share::of(0.15F);

// The predicted angle must stay this far inside the limits that switch the motors off.
constexpr float kMargin_deg[kAxisCount] = {1.0F, 0.0F, 2.0F};

// Sinking faster than this is predicted down to the table; slower is a landing.
constexpr Quantity kSinking_rad_s = Quantity::of(10.0F * kRadPerDeg);

float deg(Quantity angle_rad) { return angle_rad.to_float() * kDegPerRad; }

}  // namespace

Quantity excess_lift_V(Quantity front_V, Quantity back_V, Quantity elevation_rad,
                       const GuardLimits& limits) {
  return lift_from_motor_V(front_V, limits.dead_zone) +
         lift_from_motor_V(back_V, limits.dead_zone) - limits.hover_V -
         limits.hover_V_per_rad * elevation_rad;
}

// The parameter law_envelope is the share of the supervisor's limits that a law may use: of angle
// (pitch only), rate, following error and its time.
GuardLimits guard_limits_of(const params::Params& params) {
  const auto rad = [&params](Param p) { return params.get(p) * kRadPerDeg; };
  const float share = params.get(Param::law_envelope);
  GuardLimits limits{};
  limits.jump_max_V = Quantity::of(params.get(Param::law_jump_max_V));
  const Param angle[kAxisCount] = {Param::elevation_max_deg, Param::pitch_max_deg,
                                   Param::travel_max_deg};
  const Param rate[kAxisCount] = {Param::elevation_rate_max_deg_s, Param::pitch_rate_max_deg_s,
                                  Param::travel_rate_max_deg_s};
  const Param following[kAxisCount] = {Param::elevation_following_max_deg,
                                       Param::pitch_following_max_deg,
                                       Param::travel_following_max_deg};
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    const float margin_rad = kMargin_deg[axis] * kRadPerDeg;
    // Setpoints may come near the limits of elevation and travel, but not near those of pitch.
    limits.angle_max_rad[axis] =
        Quantity::of(axis == kPitch ? share * rad(angle[axis]) : rad(angle[axis]) - margin_rad);
    limits.rate_max_rad_s[axis] = Quantity::of(share * rad(rate[axis]));
    limits.following_max_rad[axis] = Quantity::of(share * rad(following[axis]));
    // A law may change its own pitch setpoint in a step, which makes the error large for a moment.
    limits.following_end_rad[axis] =
        axis == kPitch ? Quantity::from_raw(INT32_MAX) : Quantity::of(rad(following[axis]));
  }
  limits.following_ticks = control::ticks_of(share * params.get(Param::following_s));
  limits.table_rad =
      Quantity::of(rad(Param::elevation_rest_deg) - kMargin_deg[kElevation] * kRadPerDeg);
  // Braking from a rate takes rate^2 / (2 acceleration). The rig can reach all accelerations that
  // setpoints may have.
  limits.braking_s2[kElevation] = Gain::of(0.5F / rad(Param::elevation_acceleration_deg_s2));
  limits.braking_s2[kTravel] = Gain::of(0.5F / rad(Param::travel_acceleration_deg_s2));
  const float acceleration_ff_V = params.get(Param::elevation_acceleration_ff) * kDegPerRad;
  limits.lift_rad_s2_per_V = Gain::of(acceleration_ff_V > 0.0F ? 1.0F / acceleration_ff_V : 0.0F);
  limits.hover_V = Quantity::of(params.get(Param::hover_V));
  limits.hover_V_per_rad = Gain::of(params.get(Param::hover_slope) * kDegPerRad);
  limits.dead_zone = control::DeadZone::of(params.get(Param::dead_zone_V));
  return limits;
}

GuardVerdict Guard::check(const ControlInput& in, const LawOutput& output,
                          const LawOutput& previous, const GuardLimits& limits) {
  const GuardVerdict envelope = check_envelope(in, previous, limits);
  return envelope.reason != Takeover::command ? envelope : check_following(in, output, limits);
}

// Predicts the angle of each axis at which it comes to rest if the cascade takes over now: it moves
// on for the reaction time, then brakes. The prediction must stay within the limits.
GuardVerdict Guard::check_envelope(const ControlInput& in, const LawOutput& previous,
                                   const GuardLimits& limits) const {
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    Quantity rate_rad_s = in.rate_rad_s[axis];
    if (axis == kElevation) {
      const Quantity excess_V =
          excess_lift_V(previous.front_V, previous.back_V, in.angle_rad[axis], limits);
      rate_rad_s += kReaction_s * (limits.lift_rad_s2_per_V * excess_V);
    }
    const Quantity speed_rad_s = magnitude(rate_rad_s);
    const Quantity brake_rad = limits.braking_s2[axis] * (speed_rad_s * speed_rad_s);
    const Quantity stopping_distance_rad = kReaction_s * speed_rad_s + brake_rad;
    const bool up = rate_rad_s > Quantity{};
    const Quantity predicted_rad =
        in.angle_rad[axis] + (up ? stopping_distance_rad : -stopping_distance_rad);
    // A rig that needs less lift than assumed seems to have too little; that predicts a false fall.
    const bool is_above = axis == kElevation && in.angle_rad[axis] > limits.angle_max_rad[axis];
    // Downwards there is all the lift that the motors have, and the table.
    const bool leaves_range =
        axis == kElevation && !up
            ? in.rate_rad_s[axis] < -kSinking_rad_s &&
                  in.angle_rad[axis] - kReaction_s * speed_rad_s - brake_rad.half() <
                      limits.table_rad
            : magnitude(predicted_rad) > limits.angle_max_rad[axis];
    if (is_above || leaves_range || magnitude(in.rate_rad_s[axis]) > limits.rate_max_rad_s[axis]) {
      return {kEnvelope[axis], deg(predicted_rad)};
    }
  }
  return {};
}

// Following errors, against the law's own setpoint for pitch and the board's for the other axes.
GuardVerdict Guard::check_following(const ControlInput& in, const LawOutput& output,
                                    const GuardLimits& limits) {
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    const Quantity setpoint_rad =
        axis == kPitch ? output.pitch_setpoint_rad : in.setpoint_rad[axis];
    const Quantity error_rad = magnitude(setpoint_rad - in.angle_rad[axis]);
    const bool error_is_large = error_rad > limits.following_max_rad[axis];
    error_ticks_[axis] = error_is_large ? error_ticks_[axis] + 1U : 0U;
    if (error_ticks_[axis] > limits.following_ticks || error_rad > limits.following_end_rad[axis]) {
      return {kFollowing[axis], deg(error_rad)};
    }
  }
  return {};
}

}  // namespace heli::law
