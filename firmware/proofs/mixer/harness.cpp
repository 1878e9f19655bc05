// From any collective and differential to two lift voltages, and the limits of that.
#include "any.hpp"
#include "mixer/invariant.hpp"

using heli::control::clamp;
using heli::control::DeadZone;
using heli::control::lift_from_motor_V;
using heli::control::Mixed;
using heli::control::MixerLimits;
using heli::control::Quantity;
using heli::proofs::any;
using heli::proofs::holds;
using heli::proofs::kVoltageRoom;

namespace {

Quantity any_quantity() { return Quantity::from_raw(any<std::int32_t>()); }

}  // namespace

// Limits from any limits of the motors.
void step_limits() {
  const Quantity least_V = any_quantity();
  const Quantity most_V = any_quantity();
  const Quantity differential_V = any_quantity();
  const DeadZone dead{any_quantity(), {}};
  ASSUME(-kVoltageRoom < least_V.raw() && least_V.raw() <= 0);
  ASSUME(0 <= most_V.raw() && most_V.raw() < kVoltageRoom);
  ASSUME(0 <= dead.zone_V.raw() && 0 <= differential_V.raw());

  const MixerLimits limits = MixerLimits::of(lift_from_motor_V(least_V, dead),
                                             lift_from_motor_V(most_V, dead), differential_V);

  CLAIM(holds(limits), "the limits are usable");
}

// From any collective and differential to the voltages of both rotors.
void step_mix() {
  const MixerLimits limits{any_quantity(), any_quantity(), any_quantity()};
  ASSUME(holds(limits));
  const Quantity differential_V = any_quantity();

  const Mixed mixed = heli::control::mix(any_quantity(), differential_V, limits);

  const Quantity least_V = limits.collective_min_V.half();
  const Quantity most_V = limits.collective_max_V.half();
  CLAIM(least_V <= mixed.front_V && mixed.front_V <= most_V, "the front is within its limits");
  CLAIM(least_V <= mixed.back_V && mixed.back_V <= most_V, "the back is within its limits");
  const Quantity difference_V = mixed.front_V - mixed.back_V;
  const Quantity kept_V =
      clamp(differential_V, -limits.differential_max_V, limits.differential_max_V);
  CLAIM(difference_V == kept_V, "the collective gives way, the differential does not");
}
