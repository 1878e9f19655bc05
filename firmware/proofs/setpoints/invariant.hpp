// What the proofs of the setpoints assume before a call and prove after it.
#pragma once

#include "flight/setpoints.hpp"

namespace heli::proofs {

// A place moves by less than this in a tick.
inline constexpr std::int64_t kStepRoom = std::int64_t{1} << 31;
// From the middle to here at full speed takes 24 days.
inline constexpr std::int64_t kPlaceRoom = std::int64_t{1} << 62;
// Any quantity is within this.
inline constexpr std::int64_t kTargetRoom = std::int64_t{1} << 43;
// Beyond it a change would overflow as a `Change`.
inline constexpr std::int32_t kChangeRoom = std::int32_t{1} << 23;

inline bool within(const flight::FineAngle& setpoint, std::int64_t room) {
  return -room <= setpoint.raw_ && setpoint.raw_ <= room;
}

// No limit is negative, and changes can be smoothed.
inline bool holds(const flight::SetpointLimits& limits) {
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    if (limits.step_max_rad[axis].raw() < 0 || limits.step_change_max_rad[axis].raw() < 0 ||
        limits.step_change_max_rad[axis].raw() >= kChangeRoom ||
        limits.close_in_rad[axis].raw() < 0) {
      return false;
    }
  }
  return limits.landing_step_rad.raw() >= 0;
}

// A ramp's path leaves the quantities by no more than its rounding.
inline constexpr std::int64_t kPathRoom = kTargetRoom + (std::int64_t{1} << 22);

// Targets are quantities, a ramp ends, and no place is so far away that a sum would overflow.
inline bool holds(const flight::Setpoints& setpoints, std::int64_t room = kPlaceRoom) {
  if (setpoints.ramp_ticks_ > flight::Setpoints::kMaxAhead_ticks) {
    return false;
  }
  for (const flight::Setpoints::Axis& axis : setpoints.axes_) {
    if (!within(axis.target, kTargetRoom) || !within(axis.slope, 2 * kTargetRoom) ||
        !within(axis.path, kPathRoom) || !within(axis.setpoint, room)) {
      return false;
    }
  }
  return true;
}

}  // namespace heli::proofs
