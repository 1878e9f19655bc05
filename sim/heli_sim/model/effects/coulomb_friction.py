"""Dry friction of an axis: as large at any speed, and while it can it holds the axis where it is."""

from __future__ import annotations

from typing import Final

import casadi as ca
from typing_extensions import override

from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.model.effects.kind import EffectKind, Parameter
from heli_sim.model.parts import AXES, on_axis
from heli_sim.rig.quantity import Prior


class CoulombFriction(Effect):
    """The torque that would bring the axis to rest within a short time, but no more than dry friction gives.

    A sign of the speed could neither be integrated nor differentiated, and one that is rounded off below some
    speed creeps where it should hold. This one holds, and its steepness, 1 over the time, is the same for a
    heavy and a light axis.
    """

    @override
    def friction_Nm(self, at: Operands, acceleration_rad_s2: ca.SX, inertia_kg_m2: ca.SX) -> ca.SX:
        axis = AXES.index(self.place)
        slowing = acceleration_rad_s2[axis] + at.state[f"{self.place}_rate_rad_s"] / self.own(at, "hold_s")
        most_Nm = self.own(at, "Nm")
        return on_axis(self.place, -ca.fmin(ca.fmax(inertia_kg_m2[axis] * slowing, -most_Nm), most_Nm))


def _kind(axis: str, typical_Nm: float) -> EffectKind:
    return EffectKind(
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
        rank=110,
        source=(
            "Coulomb, with standstill as a damped constraint as solvers of rigid bodies pose it; Runge-Kutta "
            "steps of 10 ms, as identification takes them, are stable down to T = 3.6 ms"
        ),
    )


KINDS: Final = tuple(_kind(axis, size) for axis, size in zip(AXES, (0.03, 0.01, 0.02), strict=True))
