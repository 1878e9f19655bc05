"""Gains of the rotors: inputs of disturbances that vary the voltage or the thrust by a share."""

from __future__ import annotations

from typing import Final

import casadi as ca
from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.rig import Quantity
from typing_extensions import override


class RotorGains(Effect):
    """Both motors get 1 + s times their voltage. The front rotor then gives 1 + d times its thrust and the
    back rotor 1 - d times, after all other effects on it.

    Both gains are 0: the estimation core adds random disturbances to them, as to the torques. A supply that
    wanders is s. If the wash of the rotors varies each thrust by itself, s and d vary. Behind a dead zone, a
    share of the voltage is no constant share of the thrust. For a wandering supply, a gain of the voltages
    therefore adds more to the log-likelihood than one of the thrusts: 38 and 52 nats in two flights, 2026-11.
    """

    @override
    def voltage_V(self, at: Operands, volts_V: ca.SX) -> ca.SX:
        return volts_V * (1 + self.own(at, "supply"))

    @override
    def thrust_N(self, at: Operands, thrust_N: ca.SX) -> ca.SX:
        difference = self.own(at, "difference")
        return thrust_N * ca.vertcat(1 + difference, 1 - difference)


_NAME: Final = "rotor_gain"
GAINS: Final = (f"{_NAME}_supply", f"{_NAME}_difference")
"""Parameters of the model that has the effect."""
ROTOR_GAINS: Final = RotorGains(
    _NAME,
    (
        Quantity(GAINS[0], "1", "relative change of both motors' voltage"),
        Quantity(GAINS[1], "1", "relative change of the front rotor's thrust, opposite to the back rotor's"),
    ),
    dict.fromkeys(GAINS, 0.0),
    stage=Stage.TORQUE,
)
"""With this effect in a model, the strength of both disturbances is estimated."""
