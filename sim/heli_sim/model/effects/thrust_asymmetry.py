"""The two rotors differ: one pushes more than the other at the same voltage."""

from __future__ import annotations

from typing import Final

import casadi as ca
from typing_extensions import override

from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.model.effects.spec import EffectSpec, Parameter
from heli_sim.rig.quantity import Prior


class ThrustAsymmetry(Effect):
    """The front rotor pushes more by a share, the back rotor less by the same."""

    @override
    def thrust_N(self, at: Operands, thrust_N: ca.SX) -> ca.SX:
        share = self.value(at, "share")
        return thrust_N * ca.vertcat(1 + share, 1 - share)


SPEC: Final = EffectSpec(
    id="thrust_asymmetry",
    effect=ThrustAsymmetry,
    sentence="the front rotor pushes {share} more, and the back rotor as much less, than their mean",
    equation=r"F_f \to (1 + a) F_f, \quad F_b \to (1 - a) F_b",
    acts_on="thrust",
    stage=Stage.GAIN,
    numbers=(Parameter("share", "1", "share a", 0.05, Prior(0.0, 0.3, low=-0.9, high=0.9), size=True),),
    linearisable=True,
    rank=40,
    source="definition; what both rotors gain together is the thrust gain k",
)
