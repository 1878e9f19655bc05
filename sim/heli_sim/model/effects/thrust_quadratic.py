"""Thrust grows with the square of the speed, so its curve over the voltage is bent."""

from __future__ import annotations

from typing import Final

import casadi as ca
from typing_extensions import override

from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.model.effects.spec import EffectSpec, Parameter
from heli_sim.rig.quantity import Prior


class ThrustQuadratic(Effect):
    """A share of the thrust goes with the square of the voltage above the dead zone."""

    @override
    def thrust_N(self, at: Operands, thrust_N: ca.SX) -> ca.SX:
        # Bent about one point, which leaves the gain near what it was.
        above_V = ca.fabs(thrust_N) / at.parameter["thrust_gain"]
        return thrust_N * (1 + self.value(at, "share") * (above_V / self.value(at, "pivot_V") - 1))


SPEC: Final = EffectSpec(
    id="thrust_quadratic",
    effect=ThrustQuadratic,
    sentence="{share} of the thrust at {pivot_V} above the dead zone goes with the square of the voltage",
    equation=r"F_i = k e_i (1 + q (|e_i| / e_0 - 1)), \quad e_i = V_i - V_0",
    acts_on="thrust",
    stage=Stage.CURVE,
    numbers=(
        Parameter("share", "1", "quadratic share q", 0.3, Prior(0.0, 0.6, low=-1.0, high=1.5), size=True),
        Parameter("pivot_V", "V", "voltage e_0 above the dead zone at which the thrust is not changed", 1.0),
    ),
    linearisable=True,
    rank=30,
    source="propeller theory: thrust goes with the square of the speed; (31) of the paper is a straight line",
)
