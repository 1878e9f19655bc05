#include "law/recovery.hpp"

#include <initializer_list>

#include "control/math.hpp"

namespace heli::law {

using control::ControlInput;
using control::kRadPerDeg;
using control::magnitude;
using link::Param;

namespace {

constexpr Quantity degrees(float deg) { return Quantity::of(deg * kRadPerDeg); }

// At rest, for as long as the slowest rotors measured take twice to follow their voltages: shorter,
// and lift that is still to come throws the arm away after all; longer only delays.
constexpr Quantity kCalm_rad_s[kAxisCount] = {degrees(6.0F), degrees(40.0F), degrees(10.0F)};
constexpr Quantity kLevel_rad = degrees(10.0F);
constexpr std::uint32_t kCalm_ticks = 300;
// Whoever keeps moving for longer is in no law's hand; the supervisor watches the setpoint again.
constexpr std::uint32_t kMost_ticks = 3000;

// The cascade overshoots a step by a quarter: by less than a degree of elevation from here.
constexpr Quantity kNear_rad[kAxisCount] = {degrees(3.0F), Quantity{}, degrees(6.0F)};
// Lift that is this far from what carries the arm moves it by 6 deg/s in 0.4 s.
constexpr Quantity kCarries_V = Quantity::of(0.5F);

// As far below the limit as a setpoint has to be.
constexpr float kMargin_deg = 2.0F;

bool at_rest(const ControlInput& in) {
  bool slow = magnitude(in.angle_rad[kPitch]) < kLevel_rad;
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    slow = slow && magnitude(in.rate_rad_s[axis]) < kCalm_rad_s[axis];
  }
  return slow;
}

bool is_near(const ControlInput& in, std::size_t axis) {
  return magnitude(in.setpoint_rad[axis] - in.angle_rad[axis]) < kNear_rad[axis];
}

}  // namespace

RecoveryLimits recovery_limits_of(const params::Params& params) {
  RecoveryLimits l{};
  l.elevation_least_rad = degrees(params.get(Param::elevation_rest_deg));
  l.elevation_most_rad = degrees(params.get(Param::elevation_max_deg) - kMargin_deg);
  return l;
}

void Recovery::update(ControlInput& in, Quantity lift_V, Quantity tilt_V,
                      const RecoveryLimits& limits) {
  const bool calm = at_rest(in);
  if (!begun_) {
    begun_ = true;
    ticks_ = 0;
    calm_ticks_ = 0;
    for (bool& moves : moves_) {
      moves = false;
    }
    active_ = !(calm && is_near(in, kElevation) && is_near(in, kTravel) &&
                magnitude(lift_V) < kCarries_V && magnitude(tilt_V) < kCarries_V);
  }
  calm_ticks_ = calm ? calm_ticks_ + 1U : 0U;
  active_ = active_ && calm_ticks_ <= kCalm_ticks && ticks_ < kMost_ticks;
  if (!active_) {
    return;
  }
  ++ticks_;
  setpoint_rad_[kElevation] = control::clamp(in.angle_rad[kElevation], limits.elevation_least_rad,
                                             limits.elevation_most_rad);
  setpoint_rad_[kTravel] = in.angle_rad[kTravel];
  for (const std::size_t axis : {kElevation, kTravel}) {
    moves_[axis] = moves_[axis] || !is_near(in, axis);
    if (!moves_[axis]) {
      continue;
    }
    in.setpoint_rad[axis] = setpoint_rad_[axis];
    in.setpoint_rate_rad_s[axis] = Quantity{};
    in.setpoint_acceleration_rad_s2[axis] = Quantity{};
  }
}

}  // namespace heli::law
