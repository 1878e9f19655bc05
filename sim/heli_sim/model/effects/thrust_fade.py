"""Thrust falls during the flight: motors and drivers get warm."""

from __future__ import annotations

from typing import Final

import casadi as ca
from typing_extensions import override

from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.model.effects.spec import ChangeSpec, EffectFamily, EffectSpec, Parameter
from heli_sim.rig.quantity import Prior


class ThrustFade(Effect):
    """Both thrusts fall with time, linearly or towards a lower level."""

    @override
    def thrust_N(self, at: Operands, thrust_N: ca.SX) -> ca.SX:
        return thrust_N * remaining_share(at.time_s, self.value(at, "per_s"), self.value(at, "bend_per_s"))


def remaining_share(time_s: ca.SX, per_s: ca.SX, bend_per_s: ca.SX) -> ca.SX:
    """Return the remaining share of a fading quantity: 1 - r (1 - exp(-b t)) / b, or 1 - r t if b is 0."""
    bend = bend_per_s * time_s
    is_straight = ca.fabs(bend) < 1e-3  # a series avoids 0 / 0
    safe_bend = ca.if_else(is_straight, 1.0, bend)
    mean_decay = ca.if_else(is_straight, 1 - bend / 2 + bend**2 / 6, (1 - ca.exp(-safe_bend)) / safe_bend)
    return 1 - per_s * time_s * mean_decay


def bends_per_s(seconds: float) -> tuple[float, ...]:
    """Return the rates of levelling off at which a fit starts [1/s].

    They are 0, and 1 over twice, once and a third of the length of the flight, `seconds`.
    """
    return (0.0, 0.5 / seconds, 1.0 / seconds, 3.0 / seconds)


FADES: Final = EffectFamily(
    name="fading thrust",
    unclear="these flights do not show whether the supply fades or the thrust",
)
"""About a hover, both take a share of the thrust; only the dead zone and the thrust curve differ."""

SPEC: Final = EffectSpec(
    id="thrust_fade",
    effect=ThrustFade,
    sentence="the thrust fades by {per_s} at first, levelling off at {bend_per_s}",
    equation=r"F_i \to F_i (1 - r (1 - e^{-\kappa t}) / \kappa), \quad \kappa \to 0: 1 - r t",
    acts_on="thrust",
    stage=Stage.GAIN,
    numbers=(
        Parameter("per_s", "1/s", "share r lost a second", 0.003, Prior(0.0, 0.02, -0.02, 0.1), size=True),
        Parameter(
            "bend_per_s",
            "1/s",
            "rate kappa at which the loss levels off; kappa = r is an exponential fall to nothing",
            0.0,
            Prior(0.0, 0.03, low=-0.02, high=1.0),
            grid=bends_per_s,
        ),
    ),
    family=FADES,
    time_varying=True,
    change=ChangeSpec(
        (0.01,),
        "both rotors lose {} of their thrust",
        "both rotors gain {} of their thrust",
        # From its onset a fade is a ramp of what both rotors lose.
        numbers=("thrust_step_front_share+thrust_step_back_share",),
        is_ramp=True,
    ),
    rank=50,
    source="first-order warming of a motor, of which a straight line and an exponential are limits",
)
