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
constexpr float kInside_deg[kAxisCount] = {1.0F, 0.0F, 2.0F};

// Sinking faster than this is predicted down to the table; slower is a landing.
constexpr Quantity kSinking_rad_s = Quantity::of(10.0F * kRadPerDeg);

float deg(Quantity angle_rad) { return angle_rad.to_float() * kDegPerRad; }

}  // namespace

Quantity spare_lift_V(Quantity front_V, Quantity back_V, Quantity elevation_rad,
                      const GuardLimits& limits) {
  return lift_from_motor_V(front_V, limits.dead_zone) +
         lift_from_motor_V(back_V, limits.dead_zone) - limits.hover_V -
         limits.hover_V_per_rad * elevation_rad;
}

GuardLimits guard_limits_of(const params::Params& params) {
  const auto rad = [&params](Param p) { return params.get(p) * kRadPerDeg; };
  const float share = params.get(Param::law_envelope);
  GuardLimits l{};
  l.jump_max_V = Quantity::of(params.get(Param::law_jump_max_V));
  const Param angle[kAxisCount] = {Param::elevation_max_deg, Param::pitch_max_deg,
                                   Param::travel_max_deg};
  const Param rate[kAxisCount] = {Param::elevation_rate_max_deg_s, Param::pitch_rate_max_deg_s,
                                  Param::travel_rate_max_deg_s};
  const Param following[kAxisCount] = {Param::elevation_following_max_deg,
                                       Param::pitch_following_max_deg,
                                       Param::travel_following_max_deg};
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    const float inside_rad = kInside_deg[axis] * kRadPerDeg;
    // Setpoints may come near the limits of elevation and travel, but not near those of pitch.
    l.angle_max_rad[axis] =
        Quantity::of(axis == kPitch ? share * rad(angle[axis]) : rad(angle[axis]) - inside_rad);
    l.rate_max_rad_s[axis] = Quantity::of(share * rad(rate[axis]));
    l.following_max_rad[axis] = Quantity::of(share * rad(following[axis]));
    // A law may change its own pitch setpoint in a step, which makes the error large for a moment.
    l.following_end_rad[axis] =
        axis == kPitch ? Quantity::from_raw(INT32_MAX) : Quantity::of(rad(following[axis]));
  }
  l.following_ticks = control::ticks_of(share * params.get(Param::following_s));
  l.table_rad = Quantity::of(rad(Param::elevation_rest_deg) - kInside_deg[kElevation] * kRadPerDeg);
  // The rig can reach all accelerations that setpoints may have.
  l.braking_s2[kElevation] = Gain::of(0.5F / rad(Param::elevation_acceleration_deg_s2));
  l.braking_s2[kTravel] = Gain::of(0.5F / rad(Param::travel_acceleration_deg_s2));
  const float lift = params.get(Param::elevation_acceleration_ff) * kDegPerRad;
  l.lift_rad_s2_per_V = Gain::of(lift > 0.0F ? 1.0F / lift : 0.0F);
  l.hover_V = Quantity::of(params.get(Param::hover_V));
  l.hover_V_per_rad = Gain::of(params.get(Param::hover_slope) * kDegPerRad);
  l.dead_zone = control::DeadZone::of(params.get(Param::dead_zone_V));
  return l;
}

GuardVerdict Guard::check(const ControlInput& in, const LawOutput& wish, const LawOutput& before,
                          const GuardLimits& limits) {
  const GuardVerdict envelope = check_envelope(in, before, limits);
  return envelope.reason != Takeover::command ? envelope : check_following(in, wish, limits);
}

GuardVerdict Guard::check_envelope(const ControlInput& in, const LawOutput& before,
                                   const GuardLimits& limits) const {
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    Quantity rate_rad_s = in.rate_rad_s[axis];
    if (axis == kElevation) {
      const Quantity spare_V =
          spare_lift_V(before.front_V, before.back_V, in.angle_rad[axis], limits);
      rate_rad_s += kReaction_s * (limits.lift_rad_s2_per_V * spare_V);
    }
    const Quantity speed_rad_s = magnitude(rate_rad_s);
    const Quantity brake_rad = limits.braking_s2[axis] * (speed_rad_s * speed_rad_s);
    const Quantity way_rad = kReaction_s * speed_rad_s + brake_rad;
    const bool up = rate_rad_s > Quantity{};
    const Quantity foreseen_rad = in.angle_rad[axis] + (up ? way_rad : -way_rad);
    // A rig that needs less lift than assumed seems to have too little; that predicts a false fall.
    const bool above = axis == kElevation && in.angle_rad[axis] > limits.angle_max_rad[axis];
    // Downwards there is all the lift that the motors have, and the table.
    const bool beyond =
        axis == kElevation && !up
            ? in.rate_rad_s[axis] < -kSinking_rad_s &&
                  in.angle_rad[axis] - kReaction_s * speed_rad_s - brake_rad.half() <
                      limits.table_rad
            : magnitude(foreseen_rad) > limits.angle_max_rad[axis];
    if (above || beyond || magnitude(in.rate_rad_s[axis]) > limits.rate_max_rad_s[axis]) {
      return {kEnvelope[axis], deg(foreseen_rad)};
    }
  }
  return {};
}

GuardVerdict Guard::check_following(const ControlInput& in, const LawOutput& wish,
                                    const GuardLimits& limits) {
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    const Quantity wanted_rad = axis == kPitch ? wish.pitch_setpoint_rad : in.setpoint_rad[axis];
    const Quantity error_rad = magnitude(wanted_rad - in.angle_rad[axis]);
    const bool astray = error_rad > limits.following_max_rad[axis];
    astray_ticks_[axis] = astray ? astray_ticks_[axis] + 1U : 0U;
    if (astray_ticks_[axis] > limits.following_ticks ||
        error_rad > limits.following_end_rad[axis]) {
      return {kFollowing[axis], deg(error_rad)};
    }
  }
  return {};
}

}  // namespace heli::law
