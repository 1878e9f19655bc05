// The setpoints: one tick or one target, from any state of them.
#include "any.hpp"
#include "control/fixed.hpp"

namespace heli::control {

// Contracts: the braking curve and each product are any number; the solver cannot multiply cheaply.
template <>
Fixed<36> product<36, 32, 36>(Fixed<32>, Fixed<36>) {
  return Fixed<36>::from_raw(proofs::any<std::int32_t>());
}
template <>
Fixed<44> product<44, 30, 44>(Fixed<30>, Fixed<44>) {
  return Fixed<44>::from_raw(proofs::any<std::int32_t>());
}
inline std::uint64_t any_long_product(std::uint32_t, std::uint32_t) {
  return proofs::any<std::uint64_t>();
}
inline std::uint32_t any_root(std::uint64_t) { return proofs::any<std::uint32_t>(); }

}  // namespace heli::control

#define long_product any_long_product
#define square_root any_root
#include "flight/setpoints.cpp"
#undef long_product
#undef square_root
#include "setpoints/invariant.hpp"

// Contract: each value is any value afterwards.
void heli::params::Params::defaults() {}

using heli::kAxisCount;
using heli::kElevation;
using heli::kPitch;
using heli::control::Quantity;
using heli::flight::Change;
using heli::flight::FineAngle;
using heli::flight::SetpointLimits;
using heli::flight::Setpoints;
using heli::flight::Step;
using heli::link::kParamCount;
using heli::link::kParams;
using heli::proofs::any;
using heli::proofs::holds;
using heli::proofs::kPlaceRoom;
using heli::proofs::kStepRoom;
using heli::proofs::kTargetRoom;

namespace {

// Absolute value, in the raw unit of the fixed-point number.
template <int kFraction>
std::int64_t size(heli::control::Fixed<kFraction> value) {
  const std::int64_t raw = value.raw();
  return raw < 0 ? -raw : raw;
}

std::int64_t larger(std::int64_t a, std::int64_t b) { return a > b ? a : b; }

// The axes from `first` to before `last` in any state; the others rest at 0.
Setpoints any_setpoints(std::int64_t room, std::size_t first = 0, std::size_t last = kAxisCount) {
  Setpoints setpoints;
  for (std::size_t i = first; i < last; ++i) {
    Setpoints::Axis& axis = setpoints.axes_[i];
    axis.path.raw_ = any<std::int64_t>();
    axis.slope.raw_ = any<std::int64_t>();
    axis.target.raw_ = any<std::int64_t>();
    axis.setpoint.raw_ = any<std::int64_t>();
    axis.step_rad = Step::from_raw(any<std::int32_t>());
    axis.smooth_change_rad = Change::from_raw(any<std::int32_t>());
  }
  setpoints.ramp_ticks_ = any<std::uint32_t>();
  ASSUME(holds(setpoints, room));
  return setpoints;
}

// Any limits that satisfy the invariant.
SetpointLimits any_limits() {
  SetpointLimits limits{};
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    limits.step_max_rad[axis] = Step::from_raw(any<std::int32_t>());
    limits.step_change_max_rad[axis] = Step::from_raw(any<std::int32_t>());
    limits.close_in_rad[axis] = Quantity::from_raw(any<std::int32_t>());
    limits.min_rad[axis] = Quantity::from_raw(any<std::int32_t>());
    limits.max_rad[axis] = Quantity::from_raw(any<std::int32_t>());
  }
  limits.landing_step_rad = Step::from_raw(any<std::int32_t>());
  ASSUME(holds(limits));
  return limits;
}

}  // namespace

// Limits computed from any valid parameters satisfy the invariant.
void step_limits() {
  heli::params::Params params;
  for (std::size_t i = 0; i < kParamCount; ++i) {
    params.values_[i] = any<float>();
    ASSUME(kParams[i].min <= params.values_[i] && params.values_[i] <= kParams[i].max);
  }
  CLAIM(holds(heli::flight::setpoint_limits_of(params)), "the limits are usable");
}

// One axis follows its path for a tick.
void step_follow() {
  std::int64_t room = any<std::int64_t>();
  ASSUME(0 <= room && room <= kPlaceRoom);
  Setpoints::Axis axis = any_setpoints(room, kElevation, kElevation + 1).axes_[kElevation];
  const Setpoints::Axis before = axis;
  const SetpointLimits limits = any_limits();
  const Step step_max_rad = limits.step_max_rad[kElevation];
  const Step step_change_max_rad = limits.step_change_max_rad[kElevation];

  Setpoints::follow(axis, step_max_rad, step_change_max_rad, limits.close_in_rad[kElevation]);

  CLAIM(heli::proofs::within(axis.setpoint, room + kStepRoom), "it moves less than a step's range");
  CLAIM(axis.setpoint.raw_ == before.setpoint.raw_ + axis.step_rad.raw(), "it moves by its step");
  CLAIM(size(axis.step_rad) <= larger(size(step_max_rad), size(before.step_rad)),
        "the slope is within the slew, or falls to it");
  const std::int64_t change = std::int64_t{axis.step_rad.raw()} - before.step_rad.raw();
  CLAIM(-size(step_change_max_rad) <= change && change <= size(step_change_max_rad),
        "the slope changes by no more than the acceleration");
}

// One tick of all axes, where only pitch moves.
void step_pitch() {
  Setpoints setpoints = any_setpoints(kPlaceRoom, kPitch, kPitch + 1);
  const std::int64_t before = setpoints.axes_[kPitch].setpoint.raw_;
  const SetpointLimits limits = any_limits();
  const std::int64_t most = limits.step_max_rad[kPitch].raw();

  setpoints.advance(limits);

  const std::int64_t step = setpoints.axes_[kPitch].setpoint.raw_ - before;
  CLAIM(-most <= step && step <= most, "the pitch setpoint is within its slew");
}

// One target of any angles and times.
void step_aim() {
  Setpoints setpoints = any_setpoints(kPlaceRoom);
  const Setpoints before = setpoints;
  const SetpointLimits limits = any_limits();
  Quantity target_rad[kAxisCount];
  bool inside = true;
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    target_rad[axis] = Quantity::from_raw(any<std::int32_t>());
    inside = inside && limits.min_rad[axis] <= target_rad[axis] &&
             target_rad[axis] <= limits.max_rad[axis];
  }

  const bool taken = setpoints.aim(target_rad, any<std::uint32_t>(), any<std::uint32_t>(), limits);

  CLAIM(!taken || inside, "no target is out of bounds");
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    const Setpoints::Axis& old = before.axes_[axis];
    const Setpoints::Axis& now = setpoints.axes_[axis];
    CLAIM(now.target.raw_ == (taken ? FineAngle::at(target_rad[axis]).raw_ : old.target.raw_),
          "the target is the one that was taken");
    CLAIM(heli::proofs::within(now.target, kTargetRoom) &&
              heli::proofs::within(now.slope, 2 * kTargetRoom) &&
              setpoints.ramp_ticks_ <= Setpoints::kMaxAhead_ticks,
          "the invariant is kept");
    CLAIM(now.setpoint.raw_ == old.setpoint.raw_ && now.path.raw_ == old.path.raw_ &&
              now.step_rad == old.step_rad && (taken || now.slope.raw_ == old.slope.raw_),
          "no target makes the setpoint jump");
  }
}
