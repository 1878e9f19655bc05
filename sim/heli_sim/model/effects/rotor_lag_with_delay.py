"""Voltages act late, and thrust follows them late: a driver's dead time before a motor's lag."""

from __future__ import annotations

from typing import ClassVar, Final

from heli_sim.model.effect import Stage
from heli_sim.model.effects.rotor_lag import LAGS, RotorLag
from heli_sim.model.effects.rotor_lag import SPEC as LAG
from heli_sim.model.effects.spec import EffectSpec, Parameter
from heli_sim.rig.quantity import Prior


class RotorLagWithDelay(RotorLag):
    """First-order lag with dead time: `rotor_lag` behind voltages that are late by a fixed time."""

    time_constant: ClassVar[str] = "lag_s"


SPEC: Final = EffectSpec(
    id="rotor_lag_with_delay",
    effect=RotorLagWithDelay,
    sentence="the rotors' thrust lags voltages that act {delay_s} late by {lag_s}",
    equation=r"T \dot F_i = F(V_i(t - T_d)) - F_i",
    acts_on="thrust",
    stage=Stage.LAG,
    numbers=(
        Parameter("lag_s", "s", "time constant T", 0.1, Prior(0.08, 0.06, low=0.0, high=0.6), size=True),
        Parameter("delay_s", "s", "dead time T_d", 0.01, Prior(0.02, 0.03, low=0.0, high=0.25), size=True),
    ),
    states=LAG.states,
    delay="delay_s",
    contains={"rotor_lag": {"s": "lag_s"}, "input_delay": {"s": "delay_s"}},
    family=LAGS,
    family_numbers={"lag_s": 1.0, "delay_s": 1.0},
    linearisable=True,
    rank=14,
    source="first-order lag with dead time, the usual model of an actuator behind a bus",
)
