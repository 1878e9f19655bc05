"""The counterweight slips along the arm at one moment of the flight."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import casadi as ca
from typing_extensions import override

from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.model.effects.spec import ChangeSpec, EffectSpec, Parameter
from heli_sim.model.effects.thrust_step import moments_s
from heli_sim.model.parts import smooth_step
from heli_sim.rig.quantity import Prior


class CounterweightShift(Effect):
    """From an unknown moment on, the counterweight is farther out on the arm."""

    @override
    def modified_parameters(self, at: Operands) -> Mapping[str, ca.SX]:
        shift_m = self.value(at, "m") * smooth_step(at.time_s, self.value(at, "at_s"))
        return {"L_b": at.parameter["L_b"] + shift_m}


SPEC: Final = EffectSpec(
    id="counterweight_shift",
    effect=CounterweightShift,
    sentence="the counterweight slips by {m} outwards at {at_s}",
    equation=r"L_b \to L_b + \Delta\, [t > t_0]",
    acts_on="parameters",
    stage=Stage.TORQUE,
    numbers=(
        Parameter(
            "m", "m", "distance Delta, outwards", 0.005, Prior(0.0, 0.03, low=-0.1, high=0.1), size=True
        ),
        Parameter("at_s", "s", "moment t_0", 20.0, Prior(30.0, 60.0, low=0.0), grid=moments_s),
    ),
    needs=("L_b", "M_w"),
    time_varying=True,
    change=ChangeSpec(
        (0.01,),
        "the counterweight slipped by {} outwards",
        "the counterweight slipped by {} inwards",
    ),
    rank=150,
    source="definition; no flight distinguishes a shift from a mass that falls off",
)
