"""The supply's voltage falls under load: both motors get less when either of them works hard."""

from __future__ import annotations

from typing import Final

import casadi as ca

from heli_sim.model.effect import Effect, Situation, Stage
from heli_sim.model.effects.kind import EffectKind, Parameter
from heli_sim.rig.quantity import Prior


class SupplySag(Effect):
    """Drivers pass on a share of a supply that sags with the sum of both motors' voltages."""

    def voltage_V(self, at: Situation, volts_V: ca.SX) -> ca.SX:
        """Lower both voltages.

        Parameters
        ----------
        at : Situation
            Present state, voltages and parameters.
        volts_V : casadi.SX
            Voltages from a stiff supply, shape (2, 1).

        Returns
        -------
        casadi.SX
            Voltages from this one, shape (2, 1).
        """
        load_V = ca.fabs(volts_V[0]) + ca.fabs(volts_V[1])
        return volts_V * (1 - self.own(at, "per_V") * load_V)


KIND: Final = EffectKind(
    id="supply_sag",
    effect=SupplySag,
    says="the supply sags by {per_V}, a share for each volt on either motor",
    equation=r"V_i \to V_i (1 - s (|V_f| + |V_b|))",
    acts_on="input",
    stage=Stage.CURVE,
    numbers=(
        Parameter("per_V", "1/V", "share s lost for each volt", 0.02, Prior(0.0, 0.02, -0.1, 0.2), size=True),
    ),
    source="Ohm: a driver passes on a share of the supply, whose current goes with both motors' voltages",
)
