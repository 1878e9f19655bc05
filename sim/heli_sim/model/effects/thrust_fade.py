"""Thrust falls during the flight: motors and drivers get warm."""

from __future__ import annotations

from typing import Final

import casadi as ca
from typing_extensions import override

from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.model.effects.spec import ChangeSpec, EffectFamily, EffectSpec, Parameter
from heli_sim.rig.quantity import Prior


class ThrustFade(Effect):
    """Both thrusts fall with time, in a straight line or towards a lower level."""

    @override
    def thrust_N(self, at: Operands, thrust_N: ca.SX) -> ca.SX:
        return thrust_N * share_left(at.time_s, self.own(at, "per_s"), self.own(at, "bend_per_s"))


def share_left(time_s: ca.SX, per_s: ca.SX, bend_per_s: ca.SX) -> ca.SX:
    """Share that remains at `time_s` [s] of a quantity that at first loses the share `per_s` [1/s], and
    levels off at the rate `bend_per_s` [1/s]: a straight line at 0.
    """
    bent = bend_per_s * time_s
    straight = ca.fabs(bent) < 1e-3  # there the quotient below is 0 / 0
    safe = ca.if_else(straight, 1.0, bent)
    course = ca.if_else(straight, 1 - bent / 2 + bent**2 / 6, (1 - ca.exp(-safe)) / safe)
    return 1 - per_s * time_s * course


def bends_per_s(seconds: float) -> tuple[float, ...]:
    """Rates of levelling off to start from [1/s]: none, and after twice, once and a third of a flight of
    `seconds`.
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
