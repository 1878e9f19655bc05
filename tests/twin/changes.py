"""Effects that begin during a flight: the changes that the twin must detect, each at three sizes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import casadi as ca
from heli_sim.model.base import Effect, Operands
from heli_sim.model.effects import catalogue
from heli_sim.model.effects.cable_spring import CableSpring
from heli_sim.model.effects.coulomb_friction import CoulombFriction
from heli_sim.model.effects.thrust_fade import ThrustFade
from heli_sim.model.effects.zero_offset import ZeroOffset
from heli_sim.model.parts import smooth_step

ONSET_s = 30.0
"""Time from the first turn of the motors to the change [s]."""
SIZES: Mapping[str, tuple[float, float, float]] = {
    "thrust_step.front": (0.02, 0.05, 0.1),
    "thrust_step.back": (0.02, 0.05, 0.1),
    "thrust_fade": (0.002, 0.005, 0.01),
    "counterweight_shift": (0.002, 0.005, 0.01),
    "coulomb_friction.elevation": (0.015, 0.03, 0.06),
    "coulomb_friction.pitch": (0.005, 0.01, 0.02),
    "coulomb_friction.travel": (0.01, 0.02, 0.04),
    "zero_offset.elevation": (0.01, 0.02, 0.04),
    "zero_offset.pitch": (0.01, 0.02, 0.04),
    "cable_spring.elevation": (0.05, 0.1, 0.2),
    "cable_spring.travel": (0.02, 0.05, 0.1),
}
"""Sizes of each change, as values of its first parameter [SI]."""
REST_rad = 0.2
"""Angle at which the spring of the cable has no torque [rad]."""


class _LateFriction(CoulombFriction):
    """Dry friction from `ONSET_s` on."""

    def friction_Nm(self, at: Operands, acceleration_rad_s2: ca.SX, inertia_kg_m2: ca.SX) -> ca.SX:
        full_friction_Nm = super().friction_Nm(at, acceleration_rad_s2, inertia_kg_m2)
        return smooth_step(at.time_s, ca.SX(ONSET_s)) * full_friction_Nm


class _LateZero(ZeroOffset):
    """A wrong encoder zero from `ONSET_s` on."""

    def measured_rad(self, at: Operands, angles_rad: ca.SX) -> ca.SX:
        shifted_rad = super().measured_rad(at, angles_rad)
        return angles_rad + smooth_step(at.time_s, ca.SX(ONSET_s)) * (shifted_rad - angles_rad)


class _LateCable(CableSpring):
    """The spring torque of a cable from `ONSET_s` on."""

    def torque_Nm(self, at: Operands) -> ca.SX:
        return smooth_step(at.time_s, ca.SX(ONSET_s)) * super().torque_Nm(at)


class _LateFade(ThrustFade):
    """Thrust that decreases at a constant rate from `ONSET_s` on."""

    def thrust_N(self, at: Operands, thrust_N: ca.SX) -> ca.SX:
        return thrust_N * (1 - self.value(at, "per_s") * ca.fmax(at.time_s - ONSET_s, 0.0))


_LATE_EFFECTS: Mapping[str, type[Effect]] = {
    "coulomb_friction": _LateFriction,
    "zero_offset": _LateZero,
    "cable_spring": _LateCable,
    "thrust_fade": _LateFade,
}
"""Effects of the catalogue that have no onset of their own, with an onset."""


def change(name: str, size: float) -> Effect:
    """Return the effect `name` of the catalogue that acts from `ONSET_s` on.

    Its first parameter has the value `size` [SI], the others have typical values.
    """
    spec = catalogue()[name]
    values = {**spec.typical, spec.full(spec.numbers[0].name): size}
    for parameter, value in (("at_s", ONSET_s), ("rest_rad", REST_rad)):
        if spec.full(parameter) in values:
            values[spec.full(parameter)] = value
    effect = spec.make(values)
    late_class = _LATE_EFFECTS.get(name.partition(".")[0])
    if late_class is None:
        return effect
    arguments: dict[str, Any] = {field.name: getattr(effect, field.name) for field in fields(effect)}
    return late_class(**arguments)
