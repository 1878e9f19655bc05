"""Gains of the rotors: inputs of disturbances that vary the thrust by a share."""

from __future__ import annotations

from typing import Final

import casadi as ca
from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.rig import Quantity
from typing_extensions import override


class RotorGains(Effect):
    """The front rotor gives 1 + b + d times its thrust and the back rotor 1 + b - d times, after all other
    effects on it.

    Both gains are 0: the estimation core adds random disturbances to them, as to the torques. A supply varies
    the thrust of both rotors together (b). The wash of the rotors varies each by itself: b and d are equally
    strong then.
    """

    @override
    def thrust_N(self, at: Operands, thrust_N: ca.SX) -> ca.SX:
        both, difference = self.own(at, "both"), self.own(at, "difference")
        return thrust_N * ca.vertcat(1 + both + difference, 1 + both - difference)


_NAME: Final = "rotor_gain"
GAINS: Final = (f"{_NAME}_both", f"{_NAME}_difference")
"""Parameters of the model that has the effect."""
ROTOR_GAINS: Final = RotorGains(
    _NAME,
    (
        Quantity(GAINS[0], "1", "relative change of both rotors' thrust"),
        Quantity(GAINS[1], "1", "relative change of the front rotor's thrust, opposite to the back rotor's"),
    ),
    dict.fromkeys(GAINS, 0.0),
    stage=Stage.TORQUE,
)
"""With this effect in a model, the strength of both disturbances is estimated."""
