"""The supply's voltage falls during the flight: a battery runs down."""

from __future__ import annotations

from typing import Final

import casadi as ca
from typing_extensions import override

from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.model.effects.spec import EffectSpec, Parameter
from heli_sim.model.effects.thrust_fade import FADES, bends_per_s, remaining_share
from heli_sim.rig.quantity import Prior


class SupplyFade(Effect):
    """Both motors lose a share of their voltage that grows with time, in a straight line or towards a lower
    level.

    The dead zone stays where it is, so a share lost here costs the more of a thrust the smaller it is;
    `thrust_fade` takes the same share of any.
    """

    @override
    def voltage_V(self, at: Operands, volts_V: ca.SX) -> ca.SX:
        return volts_V * remaining_share(at.time_s, self.value(at, "per_s"), self.value(at, "bend_per_s"))


SPEC: Final = EffectSpec(
    id="supply_fade",
    effect=SupplyFade,
    sentence="the supply's voltage fades by {per_s} at first, levelling off at {bend_per_s}",
    equation=r"V_i \to V_i (1 - r (1 - e^{-\kappa t}) / \kappa), \quad \kappa \to 0: 1 - r t",
    acts_on="input",
    stage=Stage.SUPPLY,
    numbers=(
        Parameter(
            "per_s",
            "1/s",
            "share r of the voltage lost a second",
            0.001,
            Prior(0.0, 0.01, -0.01, 0.05),
            size=True,
        ),
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
    rank=72,
    source="discharge of a battery: steep at first and flat after, or nearly straight",
)
