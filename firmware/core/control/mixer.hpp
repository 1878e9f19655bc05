// Collective and differential to two motor voltages, and the thrust curve's dead zone.
#pragma once

#include "control/fixed.hpp"
#include "control/math.hpp"

namespace heli::control {

// Thrust of a rotor is k (V - dead_zone) above the dead zone and nothing below (paper, eq. 31).
// The control law therefore works in "lift volts", V minus the dead zone, and this turns them into
// motor volts. Within kBlend of zero the dead zone fades in, so that a loop that hovers around
// zero lift does not chop the motor between 0 and 1 V.
inline constexpr Quantity kBlend_V = Quantity::of(0.05F);
inline constexpr float kPerBlend = 1.0F / 0.05F;

struct DeadZone {
  Quantity zone_V;
  Gain slope;  // volts of the zone per volt of lift within the blend

  static DeadZone of(float zone_V) { return {Quantity::of(zone_V), Gain::of(zone_V * kPerBlend)}; }
};

// Odd function: a negative lift voltage drives the rotor backwards.
inline Quantity motor_from_lift_V(Quantity lift_V, const DeadZone& dead) {
  if (lift_V >= kBlend_V) {
    return lift_V + dead.zone_V;
  }
  return lift_V <= -kBlend_V ? lift_V - dead.zone_V : lift_V + dead.slope * lift_V;
}

// Inverse of motor_from_lift_V() outside of the blend; 0 within the dead zone.
inline Quantity lift_from_motor_V(Quantity motor_V, const DeadZone& dead) {
  if (motor_V > dead.zone_V) {
    return motor_V - dead.zone_V;
  }
  return motor_V < -dead.zone_V ? motor_V + dead.zone_V : Quantity{};
}

struct MixerLimits {
  Quantity collective_min_V;    // both motors at their lowest
  Quantity collective_max_V;    // both at their highest
  Quantity differential_max_V;  // bound of front minus back

  // From the lowest and highest lift voltage of one motor.
  static MixerLimits of(Quantity lift_min_V, Quantity lift_max_V, Quantity differential_max_V) {
    const Quantity span_V = lift_max_V - lift_min_V;
    return {lift_min_V + lift_min_V, lift_max_V + lift_max_V,
            span_V < differential_max_V ? span_V : differential_max_V};
  }
};

struct Mixed {
  Quantity front_V;  // lift volts
  Quantity back_V;
  Quantity collective_V;    // front + back as achieved
  Quantity differential_V;  // front - back as achieved
};

// Paper eq. (32) inverted, with limits. Pitch has priority: the differential keeps its size and the
// collective gives way, because a tandem that cannot hold its pitch cannot hold anything.
inline Mixed mix(Quantity collective_V, Quantity differential_V, const MixerLimits& limits) {
  Mixed mixed{};
  mixed.differential_V =
      clamp(differential_V, -limits.differential_max_V, limits.differential_max_V);
  const Quantity differential_size_V = magnitude(mixed.differential_V);
  mixed.collective_V = clamp(collective_V, limits.collective_min_V + differential_size_V,
                             limits.collective_max_V - differential_size_V);
  mixed.front_V = (mixed.collective_V + mixed.differential_V).half();
  mixed.back_V = (mixed.collective_V - mixed.differential_V).half();
  return mixed;
}

}  // namespace heli::control
