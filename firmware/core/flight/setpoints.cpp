// The path's ramps and the setpoint that follows them within slew and acceleration; see
// setpoints.hpp. Runs in the tick, except setpoint_limits_of(), which runs in the idle loop.
#include "flight/setpoints.hpp"

#include <array>

#include "control/math.hpp"

namespace heli::flight {

using control::clamp;
using control::Fixed;
using control::Gain;
using control::kRadPerDeg;
using control::kTick_s;
using control::kTickRate_Hz;
using control::magnitude;
using control::product;
using control::Share;
using link::Param;

namespace {

// Near the path, the setpoint covers this share of the remaining distance per tick (10/s).
constexpr float kCloseIn = 0.01F;
constexpr Step kCloseInShare = Step::of(kCloseIn);
constexpr float kInverseCloseInSquared = 1.0F / (kCloseIn * kCloseIn);

// The host sends the path in 20 ms pieces; their corners are smoothed over five of them before
// the control law sees an acceleration.
constexpr Share kSmoothing = Share::of(0.01F);

constexpr Gain kTickRate = Gain::of(kTickRate_Hz);
constexpr Fixed<10> kTickRateSquared = Fixed<10>::of(kTickRate_Hz * kTickRate_Hz);

using InverseTicks = std::array<Share, Setpoints::kMaxAhead_ticks + 1>;

constexpr InverseTicks make_inverse_ticks() {
  InverseTicks table{};
  for (std::size_t ticks = 1; ticks < table.size(); ++ticks) {
    table[ticks] = Share::of(1.0F / static_cast<float>(ticks));
  }
  return table;
}

// 1 / ticks for each ramp, so that the tick multiplies instead of dividing; entry 0 is 0.
constexpr InverseTicks kInverseTicks = make_inverse_ticks();

// Squares of steps, 72 bits behind the point, are bounded here: beyond it lie 10 milliradians a
// tick, and no setpoint may slew at more than 3.5.
constexpr std::uint64_t kMaxSquare = std::uint64_t{1} << 59U;

// Returns the fastest step, per tick, from which the setpoint can still brake before `goal` when
// its step changes by `step_change_max_rad` per tick. Closer than `close_in_rad` it closes in
// exponentially instead; the braking curve meets that region at equal speed.
Step approach(FineAngle from, FineAngle goal, Step step_change_max_rad, Quantity close_in_rad) {
  const Quantity distance_rad = from.distance_rad(goal);
  const Quantity distance_size_rad = magnitude(distance_rad);
  if (distance_size_rad <= close_in_rad) {
    return product<36>(from.near_distance_rad(goal), kCloseInShare);
  }
  // step = square root of 2 change (distance - close_in / 2), with 72 bits behind the point: the
  // root then has the 36 bits of a Step.
  const auto braking_distance_24 =
      static_cast<std::uint32_t>((distance_size_rad + distance_size_rad - close_in_rad).raw());
  const std::uint64_t step_squared_60 = control::long_product(
      static_cast<std::uint32_t>(step_change_max_rad.raw()), braking_distance_24);
  const std::uint64_t step_squared_72 =
      step_squared_60 < (kMaxSquare >> 12U) ? step_squared_60 << 12U : kMaxSquare;
  const auto step_rad =
      Step::from_raw(static_cast<std::int32_t>(control::square_root(step_squared_72)));
  return distance_rad < Quantity{} ? -step_rad : step_rad;
}

}  // namespace

SetpointLimits setpoint_limits_of(const params::Params& params) {
  const auto rad = [&params](Param p) { return params.get(p) * kRadPerDeg; };
  const float travel_rad = rad(Param::travel_max_deg) - link::kTravelMaxMargin_deg * kRadPerDeg;
  const Quantity pitch_rad = Quantity::of(rad(Param::pitch_setpoint_max_deg));
  SetpointLimits limits{};
  limits.step_max_rad[kElevation] = Step::of(rad(Param::elevation_slew_deg_s) * kTick_s);
  limits.step_max_rad[kPitch] = Step::of(rad(Param::pitch_slew_deg_s) * kTick_s);
  limits.step_max_rad[kTravel] = Step::of(rad(Param::travel_slew_deg_s) * kTick_s);
  const auto set_acceleration = [&limits, &rad](std::size_t axis, Param acceleration) {
    const float change_rad = rad(acceleration) * kTick_s * kTick_s;
    limits.step_change_max_rad[axis] = Step::of(change_rad);
    limits.close_in_rad[axis] = Quantity::of(change_rad * kInverseCloseInSquared);
  };
  set_acceleration(kElevation, Param::elevation_acceleration_deg_s2);
  set_acceleration(kTravel, Param::travel_acceleration_deg_s2);
  limits.min_rad[kElevation] =
      Quantity::of(rad(Param::elevation_rest_deg) - link::kElevationRestMargin_deg * kRadPerDeg);
  limits.max_rad[kElevation] =
      Quantity::of(rad(Param::elevation_max_deg) - link::kElevationMaxMargin_deg * kRadPerDeg);
  limits.min_rad[kPitch] = -pitch_rad;
  limits.max_rad[kPitch] = pitch_rad;
  limits.min_rad[kTravel] = Quantity::of(-travel_rad);
  limits.max_rad[kTravel] = Quantity::of(travel_rad);
  limits.landing_step_rad = Step::of(rad(Param::landing_rate_deg_s) * kTick_s);
  return limits;
}

void Setpoints::start_at(const Quantity (&angle_rad)[kAxisCount]) {
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    hold_at(axis, angle_rad[axis]);
  }
}

void Setpoints::hold_at(std::size_t axis, Quantity angle_rad) {
  axes_[axis] = Axis{};
  axes_[axis].path = FineAngle::at(angle_rad);
  axes_[axis].target = FineAngle::at(angle_rad);
  axes_[axis].setpoint = FineAngle::at(angle_rad);
}

void Setpoints::continue_from(std::size_t axis, Quantity angle_rad) {
  axes_[axis].setpoint = FineAngle::at(angle_rad);
  axes_[axis].step_rad = Step{};
  axes_[axis].smooth_change_rad = Change{};
}

Setpoint Setpoints::of(std::size_t axis) const {
  const Axis& a = axes_[axis];
  return {a.setpoint.angle_rad(), product<24>(a.step_rad, kTickRate),
          product<24>(a.smooth_change_rad, kTickRateSquared)};
}

// Sets a target that the path reaches at `apply_tick` in a straight line; false if it lies outside
// the limits or too far ahead. A target in the past is reached immediately.
bool Setpoints::aim(const Quantity (&target_rad)[kAxisCount], std::uint32_t apply_tick,
                    std::uint32_t now_tick, const SetpointLimits& limits) {
  const auto ahead = static_cast<std::int32_t>(apply_tick - now_tick);
  if (ahead > static_cast<std::int32_t>(kMaxAhead_ticks)) {
    return false;
  }
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    if (target_rad[axis] < limits.min_rad[axis] || target_rad[axis] > limits.max_rad[axis]) {
      return false;
    }
  }
  ramp_ticks_ = ahead > 0 ? static_cast<std::uint32_t>(ahead) : 0U;
  for (std::size_t i = 0; i < kAxisCount; ++i) {
    Axis& axis = axes_[i];
    axis.target = FineAngle::at(target_rad[i]);
    axis.slope =
        FineAngle::share_of(axis.path.distance_rad(axis.target), kInverseTicks[ramp_ticks_]);
  }
  return true;
}

// Moves the setpoint of an axis one tick towards its path, within the limits of its rate and of its
// acceleration (`step_change_max_rad`, change of the step per tick).
void Setpoints::follow(Axis& axis, Step step_max_rad, Step step_change_max_rad,
                       Quantity close_in_rad) {
  // The rate of the path itself, so that the setpoint does not lag behind a moving path.
  const Step slope_rad = clamp(FineAngle{}.step_to(axis.slope), -step_max_rad, step_max_rad);
  const Step wanted_rad =
      clamp(slope_rad + approach(axis.setpoint, axis.path, step_change_max_rad, close_in_rad),
            -step_max_rad, step_max_rad);
  const Step change_rad =
      clamp(wanted_rad - axis.step_rad, -step_change_max_rad, step_change_max_rad);
  axis.step_rad += change_rad;
  axis.setpoint.add(axis.step_rad);
  // 256: from a Step's to a Change's resolution.
  const Change fine_change_rad = Change::from_raw(change_rad.raw() * 256);
  axis.smooth_change_rad += product<44>(kSmoothing, fine_change_rad - axis.smooth_change_rad);
}

// Moves the path of each axis by a tick, and the setpoint along it.
void Setpoints::advance(const SetpointLimits& limits) {
  if (ramp_ticks_ > 0U) {
    --ramp_ticks_;
  }
  for (std::size_t i = 0; i < kAxisCount; ++i) {
    Axis& axis = axes_[i];
    if (ramp_ticks_ > 0U) {
      axis.path.add(axis.slope);
    } else {
      axis.path = axis.target;
      axis.slope = FineAngle{};
    }
    if (i == kPitch) {
      // Pitch has no limit of acceleration: its setpoint comes from the travel loop or a pilot.
      const Step max_rad = limits.step_max_rad[i];
      axis.setpoint.add(clamp(axis.setpoint.step_to(axis.path), -max_rad, max_rad));
    } else {
      follow(axis, limits.step_max_rad[i], limits.step_change_max_rad[i], limits.close_in_rad[i]);
    }
  }
}

void Setpoints::descend(const SetpointLimits& limits, Quantity floor_rad) {
  Axis& axis = axes_[kElevation];
  axis.target = FineAngle::at(floor_rad);
  axis.path = axis.target;
  axis.slope = FineAngle{};
  follow(axis, limits.landing_step_rad, limits.step_change_max_rad[kElevation],
         limits.close_in_rad[kElevation]);
}

}  // namespace heli::flight
