"""A rotor that climbs meets its air faster and pushes less."""

from __future__ import annotations

from typing import Final

import casadi as ca

from heli_sim.model.effect import Effect, Situation, Stage
from heli_sim.model.effects.kind import EffectKind, Parameter
from heli_sim.model.parts import rotor_climb_m_s
from heli_sim.rig.quantity import Prior

_AT_N: Final = 1.0
"""Thrust at which the loss is `Ns_per_m`, however it goes with the thrust."""


class InflowDamping(Effect):
    """Each rotor loses thrust in proportion to its own speed along its thrust axis.

    Blade elements lose it in proportion to the rotors' speed too: between the same loss at any thrust
    (`loaded` = 0) and a loss in proportion to the thrust (1).
    """

    def thrust_N(self, at: Situation, thrust_N: ca.SX) -> ca.SX:
        """Take away what the climb costs.

        Parameters
        ----------
        at : Situation
            Present state, voltages and parameters.
        thrust_N : casadi.SX
            Thrust of rotors that stand still in the air, shape (2, 1).

        Returns
        -------
        casadi.SX
            Thrust of these, shape (2, 1).
        """
        loaded = self.own(at, "loaded")
        loss_Ns_per_m = self.own(at, "Ns_per_m") * (1 - loaded + loaded * thrust_N / _AT_N)
        return thrust_N - loss_Ns_per_m * rotor_climb_m_s(at.state, at.parameter)


KIND: Final = EffectKind(
    id="inflow_damping",
    effect=InflowDamping,
    says="each rotor loses {Ns_per_m} of thrust to its own climb along its axis",
    equation=r"F_i \to F_i - c\, v_i, \quad v_i = \boldsymbol n \cdot \dot{\boldsymbol r}_i",
    acts_on="thrust",
    stage=Stage.INFLOW,
    numbers=(
        Parameter(
            "Ns_per_m", "N s/m", "thrust c lost for each m/s", 0.1, Prior(0.0, 0.15, -0.5, 2), size=True
        ),
        Parameter("loaded", "1", "how far the loss goes with the thrust", 0.0, scan=(0.0, 1.0)),
    ),
    needs=("L_a", "L_h", "L_theta"),
    source="blade element theory: the angle of attack falls with the axial speed",
)
