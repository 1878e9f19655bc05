"""An effect that lets disturbances vary the supply voltage, and the thrust of each rotor, by a share."""

from __future__ import annotations

from typing import Final

import casadi as ca
from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.rig import Quantity
from typing_extensions import override


class RotorGains(Effect):
    """Relative changes of the motors' voltage and of the rotors' thrust, as inputs of disturbances.

    Both motors get 1 + s times their voltage. The front rotor then gives 1 + d times its thrust, and the back
    rotor 1 - d times, after all other effects. Both gains are 0; the estimation core adds random disturbances
    to them, as to the torques. A supply that wanders varies s alone. Rotor wash, which varies each thrust
    separately, varies s and d.

    The gain s acts on the voltage, not on the thrust, because the two are not proportional if there is a dead
    zone. For a wandering supply, this adds 38 and 52 nats to the log-likelihood of two flights (2026-11).
    """

    @override
    def voltage_V(self, at: Operands, volts_V: ca.SX) -> ca.SX:
        return volts_V * (1 + self.value(at, "supply"))

    @override
    def thrust_N(self, at: Operands, thrust_N: ca.SX) -> ca.SX:
        difference = self.value(at, "difference")
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
