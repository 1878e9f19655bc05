// Thresholds and the two phases of a recovery: stop the arm, return travel; see recovery.hpp.
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

// The arm must be at rest for twice the lag of the slowest rotors measured. Shorter: thrust that is
// still building up moves the arm away again. Longer: only a delay.
constexpr Quantity kRestRate_rad_s[kAxisCount] = {degrees(6.0F), degrees(40.0F), degrees(10.0F)};
constexpr Quantity kLevel_rad = degrees(10.0F);
constexpr std::uint32_t kRest_ticks = 300;
// An arm that moves for longer is not under control; the supervisor checks the setpoint again.
constexpr std::uint32_t kMaxStop_ticks = 3000;

// The cascade overshoots a step by a quarter: by less than a degree of elevation from here.
constexpr Quantity kNear_rad[kAxisCount] = {degrees(3.0F), Quantity{}, degrees(6.0F)};
// Lift that is this far from what carries the arm moves it by 6 deg/s in 0.4 s.
constexpr Quantity kLiftTolerance_V = Quantity::of(0.5F);

// Travel has returned when its setpoint and the arm are slower than this. A return from 175 degrees
// takes 13 s.
constexpr Quantity kArrives_rad_s = degrees(1.0F);
constexpr std::uint32_t kMaxReturn_ticks = 20000;
// Elevation waits where the rotors have this share of their lift at level: with 0.3 of it, a return
// over 30 degrees lifts the arm by 2, with 0.4 not at all (nominal rig).
constexpr float kTiltingShare = 0.4F;
// Rate to that elevation, per tick: 5 degrees per second.
constexpr Quantity kRiseStep_rad = degrees(0.005F);

// The distance below the limit that a setpoint must keep.
constexpr float kElevationMargin_deg = 2.0F;

bool at_rest(const ControlInput& in) {
  bool at_rest = magnitude(in.angle_rad[kPitch]) < kLevel_rad;
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    at_rest = at_rest && magnitude(in.rate_rad_s[axis]) < kRestRate_rad_s[axis];
  }
  return at_rest;
}

bool is_near(const ControlInput& in, std::size_t axis) {
  return magnitude(in.setpoint_rad[axis] - in.angle_rad[axis]) < kNear_rad[axis];
}

}  // namespace

RecoveryLimits recovery_limits_of(const params::Params& params) {
  RecoveryLimits limits{};
  limits.elevation_min_rad = degrees(params.get(Param::elevation_rest_deg));
  limits.elevation_max_rad = degrees(params.get(Param::elevation_max_deg) - kElevationMargin_deg);
  const float slope = params.get(Param::hover_slope);
  const float tilting_deg =
      slope > 0.0F ? (kTiltingShare - 1.0F) * params.get(Param::hover_V) / slope : -90.0F;
  limits.tilting_min_rad =
      control::clamp(degrees(tilting_deg), limits.elevation_min_rad, Quantity{});
  return limits;
}

// The first call decides whether there is anything to recover.
void Recovery::update(ControlInput& in, Quantity lift_V, Quantity tilt_V,
                      const RecoveryLimits& limits) {
  if (!begun_) {
    begun_ = true;
    returning_ = false;
    ticks_ = 0;
    rest_ticks_ = 0;
    for (bool& override : overrides_) {
      override = false;
    }
    active_ = !(at_rest(in) && is_near(in, kElevation) && is_near(in, kTravel) &&
                magnitude(lift_V) < kLiftTolerance_V && magnitude(tilt_V) < kLiftTolerance_V);
  }
  if (active_) {
    ++ticks_;
    active_ = returning_ ? return_travel(in, limits) : stop_arm(in, limits);
  }
}

// True once the condition has held for kRest_ticks in a row.
bool Recovery::at_rest_long_enough(bool at_rest_now) {
  rest_ticks_ = at_rest_now ? rest_ticks_ + 1U : 0U;
  return rest_ticks_ > kRest_ticks;
}

// Replaces the setpoint of an axis by one at rest.
void Recovery::override_setpoint(ControlInput& in, std::size_t axis, Quantity setpoint_rad) {
  overrides_[axis] = true;
  setpoint_rad_[axis] = setpoint_rad;
  in.setpoint_rad[axis] = setpoint_rad;
  in.setpoint_rate_rad_s[axis] = Quantity{};
  in.setpoint_acceleration_rad_s2[axis] = Quantity{};
}

// First phase. Ends when the arm is at rest; the second phase follows if travel was overridden.
bool Recovery::stop_arm(ControlInput& in, const RecoveryLimits& limits) {
  if (at_rest_long_enough(at_rest(in)) || ticks_ > kMaxStop_ticks) {
    returning_ = overrides_[kTravel];
    overrides_[kElevation] = false;
    overrides_[kTravel] = false;
    rest_ticks_ = 0;
    return returning_;
  }
  if (overrides_[kElevation] || !is_near(in, kElevation)) {
    override_setpoint(in, kElevation,
                      control::clamp(in.angle_rad[kElevation], limits.elevation_min_rad,
                                     limits.elevation_max_rad));
  }
  if (overrides_[kTravel] || !is_near(in, kTravel)) {
    override_setpoint(in, kTravel, in.angle_rad[kTravel]);
  }
  return true;
}

// Second phase: travel returns to the supervisor's setpoint. Ends when it has arrived.
bool Recovery::return_travel(ControlInput& in, const RecoveryLimits& limits) {
  const bool arrived = magnitude(in.setpoint_rate_rad_s[kTravel]) < kArrives_rad_s &&
                       magnitude(in.rate_rad_s[kTravel]) < kArrives_rad_s && is_near(in, kTravel);
  if (at_rest_long_enough(arrived) || ticks_ > kMaxReturn_ticks) {
    return false;
  }
  const Quantity setpoint_rad = in.setpoint_rad[kElevation];
  if (setpoint_rad < limits.tilting_min_rad) {
    const Quantity raised_rad = setpoint_rad + kRiseStep_rad;
    override_setpoint(in, kElevation,
                      raised_rad < limits.tilting_min_rad ? raised_rad : limits.tilting_min_rad);
  }
  return true;
}

}  // namespace heli::law
