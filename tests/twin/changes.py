"""What is changed in flights, from a moment on, each at three sizes."""

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
"""Since the motors first turned."""
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
"""Sizes of each change, as values of its first parameter."""
REST_rad = 0.2
"""Where the cable is at rest."""


class _LateFriction(CoulombFriction):
    def friction_Nm(self, at: Operands, acceleration_rad_s2: ca.SX, inertia_kg_m2: ca.SX) -> ca.SX:
        whole = super().friction_Nm(at, acceleration_rad_s2, inertia_kg_m2)
        return smooth_step(at.time_s, ca.SX(ONSET_s)) * whole

    @property
    def has_friction(self) -> bool:
        return True


class _LateZero(ZeroOffset):
    def measured_rad(self, at: Operands, angles_rad: ca.SX) -> ca.SX:
        shown = super().measured_rad(at, angles_rad)
        return angles_rad + smooth_step(at.time_s, ca.SX(ONSET_s)) * (shown - angles_rad)


class _LateCable(CableSpring):
    def torque_Nm(self, at: Operands) -> ca.SX:
        return smooth_step(at.time_s, ca.SX(ONSET_s)) * super().torque_Nm(at)


class _LateFade(ThrustFade):
    def thrust_N(self, at: Operands, thrust_N: ca.SX) -> ca.SX:
        return thrust_N * (1 - self.own(at, "per_s") * ca.fmax(at.time_s - ONSET_s, 0.0))


_LATE: Mapping[str, type[Effect]] = {
    "coulomb_friction": _LateFriction,
    "zero_offset": _LateZero,
    "cable_spring": _LateCable,
    "thrust_fade": _LateFade,
}


def change(name: str, size: float) -> Effect:
    """Make the effect `name` of the catalogue, of this `size`, from `ONSET_s` on."""
    kind = catalogue()[name]
    values = {**kind.typical, kind.full(kind.numbers[0].name): size}
    for what, value in (("at_s", ONSET_s), ("rest_rad", REST_rad)):
        if kind.full(what) in values:
            values[kind.full(what)] = value
    made = kind.make(values)
    late = _LATE.get(name.partition(".")[0])
    if late is None:
        return made
    given: dict[str, Any] = {field.name: getattr(made, field.name) for field in fields(made)}
    return late(**given)
