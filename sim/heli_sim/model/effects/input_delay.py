"""Voltages act late by a fixed time: a bus, a driver or a controller holds them back."""

from __future__ import annotations

from typing import Final

from heli_sim.model.effect import Effect, Stage
from heli_sim.model.effects.spec import EffectSpec, Parameter
from heli_sim.rig.quantity import Prior


class InputDelay(Effect):
    """Pure delay of both voltages; programs that integrate the model must pass it late voltages."""


SPEC: Final = EffectSpec(
    id="input_delay",
    effect=InputDelay,
    sentence="the voltages act {s} late",
    equation=r"V_i \to V_i(t - T_d)",
    acts_on="input",
    stage=Stage.CURVE,
    numbers=(Parameter("s", "s", "delay T_d", 0.02, Prior(0.02, 0.03, low=0.0, high=0.25), size=True),),
    delay="s",
    linearisable=True,
    rank=20,
    source="definition",
)
