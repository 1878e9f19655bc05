"""Dry friction of an axis: its size does not depend on the speed, and it can hold the axis at rest."""

from __future__ import annotations

import math
from typing import Final

import casadi as ca
from typing_extensions import override

from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.model.effects.spec import ChangeSpec, EffectSpec, Parameter
from heli_sim.model.parts import AXES, on_axis
from heli_sim.rig.quantity import Prior

_RATE_STD_COUNTS_PER_s: Final = 2.9335
"""Standard error of a moving axis' rate as a flight shows it, in encoder counts per second: 0.0045 rad/s with
4096 counts.

It was set on nineteen simulated flights with dry friction (2026-11), where the most likely values were 0.004
rad/s without disturbances and 0.004 to 0.012 rad/s in gusts. With half of it, friction in gusts is estimated
up to an eighth too small, and the difference is attributed to fast gusts. With twice of it, friction without
disturbances is estimated a tenth too large."""


class CoulombFriction(Effect):
    """The torque that would bring the axis to rest within a short time, limited to the size of dry friction.

    Friction with the sign of the speed could neither be integrated nor differentiated. A smoothed sign would
    let the axis creep under a load that friction should hold. This form holds the axis, and its steepness,
    1 over the time, is the same for a heavy and a light axis.
    """

    @override
    def friction_Nm(self, at: Operands, acceleration_rad_s2: ca.SX, inertia_kg_m2: ca.SX) -> ca.SX:
        stopping_Nm = inertia_kg_m2[AXES.index(self.place)] * self._stopping_rad_s2(at, acceleration_rad_s2)
        max_Nm = self.value(at, "Nm")
        return on_axis(self.place, -ca.fmin(ca.fmax(stopping_Nm, -max_Nm), max_Nm))

    def _stopping_rad_s2(self, at: Operands, acceleration_rad_s2: ca.SX) -> ca.SX:
        """Return the deceleration that brings the axis to rest within the short time."""
        rate_rad_s = at.state[f"{self.place}_rate_rad_s"]
        return acceleration_rad_s2[AXES.index(self.place)] + rate_rad_s / self.value(at, "hold_s")

    @override
    def with_measured_angles(self) -> Effect:
        return CoulombFrictionOfMeasuredRate(
            name=self.name,
            parameters=self.parameters,
            values=self.values,
            priors=self.priors,
            stage=self.stage,
        )


class CoulombFrictionOfMeasuredRate(CoulombFriction):
    """Coulomb friction along a measured flight: its mean over the uncertain rate of the axis.

    Such a mean is a describing function (Gelb and Vander Velde 1968). Near standstill the encoders do not
    show in which direction the axis creeps, so the mean friction is smaller than the full one. A rate of
    exactly zero marks an axis at rest, whose friction is not averaged.
    """

    @override
    def friction_Nm(self, at: Operands, acceleration_rad_s2: ca.SX, inertia_kg_m2: ca.SX) -> ca.SX:
        count_rad = 2.0 * math.pi / at.parameter[f"encoder_counts_{self.place}"]
        uncertainty_rad_s2 = _RATE_STD_COUNTS_PER_s * count_rad / self.value(at, "hold_s")
        stopping_rad_s2 = self._stopping_rad_s2(at, acceleration_rad_s2)
        moving_Nm = self.value(at, "Nm") * ca.erf(stopping_rad_s2 / (math.sqrt(2.0) * uncertainty_rad_s2))
        at_rest_Nm = super().friction_Nm(at, acceleration_rad_s2, inertia_kg_m2)
        is_at_rest = at.state[f"{self.place}_rate_rad_s"] == 0.0
        return ca.if_else(is_at_rest, at_rest_Nm, -on_axis(self.place, moving_Nm))


def _spec(axis: str, typical_Nm: float) -> EffectSpec:
    return EffectSpec(
        id=f"coulomb_friction.{axis}",
        effect=CoulombFriction,
        sentence=f"the {axis} axis has dry friction of {{Nm}}",
        equation=r"\tau = -\min(\max(J (\dot\omega_0 + \omega / T), -c), c)",
        acts_on=f"torque.{axis}",
        stage=Stage.TORQUE,
        # Without any friction it has no side, and the size no derivative.
        numbers=(
            Parameter(
                "Nm",
                "N m",
                "torque c",
                typical_Nm,
                Prior(0.0, 3 * typical_Nm, 0.0, 0.5),
                size=True,
                neutral=1e-14,
            ),
            Parameter(
                "hold_s",
                "s",
                "time T within which it brings the axis to rest",
                0.01,
                Prior(0.008, 0.005, low=0.004, high=0.05),
            ),
        ),
        change=ChangeSpec(
            (2.0 * typical_Nm,),
            f"the {axis} axis has {{}} more dry friction",
            f"the {axis} axis has {{}} less dry friction",
        ),
        rank=110,
        source=(
            "Coulomb, with standstill as a damped constraint as solvers of rigid bodies pose it; Runge-Kutta "
            "steps of 10 ms, as identification takes them, are stable down to T = 3.6 ms"
        ),
    )


SPECS: Final = tuple(_spec(axis, size) for axis, size in zip(AXES, (0.03, 0.01, 0.02), strict=True))
