// Collective and differential to two motor voltages, and the thrust curve's dead zone.
#pragma once

#include "control/math.hpp"

namespace heli::control {

// Thrust of a rotor is k (V - dead_zone) above the dead zone and nothing below (paper, eq. 31).
// The control law therefore works in "lift volts", V minus the dead zone, and this turns them into
// motor volts. Within kBlend_V of zero the dead zone fades in, so that a loop that hovers around
// zero lift does not chop the motor between 0 and 1 V.
inline constexpr float kBlend_V = 0.05F;
inline constexpr float kPerBlend = 1.0F / kBlend_V;

inline float motor_from_lift_V(float lift_V, float dead_zone_V) {
  return lift_V + dead_zone_V * clamp(lift_V * kPerBlend, -1.0F, 1.0F);
}

inline float lift_from_motor_V(float motor_V, float dead_zone_V) {
  if (motor_V > dead_zone_V) {
    return motor_V - dead_zone_V;
  }
  return motor_V < -dead_zone_V ? motor_V + dead_zone_V : 0.0F;
}

struct MixerLimits {
  float lift_min_V;          // lowest lift voltage of one motor
  float lift_max_V;          // highest
  float differential_max_V;  // bound of front minus back
};

struct Mixed {
  float front_V;  // lift volts
  float back_V;
  float collective_V;    // front + back as achieved
  float differential_V;  // front - back as achieved
};

// Paper eq. (32) inverted, with limits. Pitch has priority: the differential keeps its size and the
// collective gives way, because a tandem that cannot hold its pitch cannot hold anything.
inline Mixed mix(float collective_V, float differential_V, const MixerLimits& limits) {
  const float span_V = limits.lift_max_V - limits.lift_min_V;
  const float bound_V = span_V < limits.differential_max_V ? span_V : limits.differential_max_V;
  Mixed m{};
  m.differential_V = clamp(differential_V, -bound_V, bound_V);
  const float taken_V = magnitude(m.differential_V);
  m.collective_V =
      clamp(collective_V, 2.0F * limits.lift_min_V + taken_V, 2.0F * limits.lift_max_V - taken_V);
  m.front_V = 0.5F * (m.collective_V + m.differential_V);
  m.back_V = 0.5F * (m.collective_V - m.differential_V);
  return m;
}

}  // namespace heli::control
