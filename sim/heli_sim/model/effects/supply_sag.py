"""The voltage of the supply falls under load, so that each motor gets less when the other is driven."""

from __future__ import annotations

from typing import Final

import casadi as ca
from typing_extensions import override

from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.model.effects.spec import EffectSpec, Parameter
from heli_sim.rig.quantity import Prior


class SupplySag(Effect):
    """Both motors lose voltage in proportion to the load, which is the sum of their voltages.

    If switching drivers share the supply, each motor loses a share of its own voltage (`line` = 0). If the
    motors share a supply line with a resistance, both lose the same voltage (`line` = 1).
    """

    @override
    def voltage_V(self, at: Operands, volts_V: ca.SX) -> ca.SX:
        load_V = ca.fabs(volts_V[0]) + ca.fabs(volts_V[1])
        line = self.value(at, "line")
        return volts_V - self.value(at, "per_V") * load_V * ((1 - line) * volts_V + line * _LINE_V)


_LINE_V: Final = 1.0
"""Motor voltage to which the loss refers, if both motors lose the same voltage."""

SPEC: Final = EffectSpec(
    id="supply_sag",
    effect=SupplySag,
    sentence="the supply sags by {per_V}, a share for each volt on either motor",
    equation=r"V_i \to V_i - s (|V_f| + |V_b|) ((1 - l) V_i + l \cdot 1\,\mathrm{V})",
    acts_on="input",
    stage=Stage.CURVE,
    numbers=(
        Parameter("per_V", "1/V", "share s lost for each volt", 0.02, Prior(0.0, 0.1, 0.0, 0.2), size=True),
        Parameter(
            "line",
            "1",
            "0 where each driver loses a share of its voltage, 1 where both lose the same voltage",
            0.0,
            grid=(0.0, 1.0),
        ),
    ),
    linearisable=True,
    rank=70,
    source="Ohm: a driver passes on a share of the supply, whose current goes with both motors' voltages",
)
