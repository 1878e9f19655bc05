"""Near the table a rotor gives more thrust, because its wake cannot leave freely."""

from __future__ import annotations

from typing import Final

import casadi as ca
from typing_extensions import override

from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.model.effects.spec import EffectSpec, Parameter
from heli_sim.model.parts import rotor_height_m
from heli_sim.rig.quantity import Prior


class GroundEffect(Effect):
    """The thrust of each rotor grows by a share that decays exponentially with the height above the table.

    For small rotors, the height is that of the rotor itself, which changes with pitch (`own` = 1). If both
    rotors share one cushion of air, it is the height of the arm's end (`own` = 0).
    """

    @override
    def thrust_N(self, at: Operands, thrust_N: ca.SX) -> ca.SX:
        height_m = rotor_height_m(at.state, at.parameter)
        end_m = ca.sum1(height_m) / 2
        above_m = end_m + self.value(at, "own") * (height_m - end_m) + self.value(at, "table_m")
        return thrust_N * (1 + self.value(at, "share") * ca.exp(-above_m / self.value(at, "height_m")))


SPEC: Final = EffectSpec(
    id="ground_effect",
    effect=GroundEffect,
    sentence="at the table the rotors push {share} more; over {height_m} of height this falls by a factor e",
    equation=r"F_i \to F_i (1 + a\, e^{-h_i / h_0})",
    acts_on="thrust",
    stage=Stage.GROUND,
    numbers=(
        Parameter("share", "1", "share a gained at the table", 0.2, Prior(0.0, 0.5, 0.0, 5.0), size=True),
        Parameter(
            "height_m",
            "m",
            "height h_0 over which it falls by a factor e",
            0.15,
            Prior(0.15, 0.1, low=0.02, high=1.5),
            grid=(0.05, 0.1, 0.2, 0.4),
        ),
        Parameter("own", "1", "how far each rotor has a height of its own", 1.0, grid=(0.0, 1.0)),
        Parameter("table_m", "m", "how far below the elevation axis the table is, where h_i = 0", 0.25),
    ),
    needs=("L_a", "L_h", "L_theta"),
    linearisable=True,
    rank=90,
    source=(
        "measured thrust of rotors near the ground falls off about exponentially; between one and two radii "
        "of height Cheeseman and Bennett's 1 / (1 - (R / 4h)^2) differs from that by 0.4 % of the thrust"
    ),
)
