"""A rotor that moves along its own axis meets its air faster, and gives less thrust."""

from __future__ import annotations

from typing import Final

import casadi as ca
from typing_extensions import override

from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.model.effects.spec import EffectSpec, Parameter
from heli_sim.model.parts import rotor_climb_m_s
from heli_sim.rig.quantity import Prior


class InflowDamping(Effect):
    """Each rotor loses thrust in proportion to its own speed along its thrust axis.

    If the speed of the propeller follows the voltage, the loss grows with the thrust (`loaded` = 1). If the
    speed is nearly constant, the loss is the same at any thrust (`loaded` = 0). Travel at a pitch angle also
    moves the rotors along their axes, if the air in the room is at rest (`still` = 1). In a small room the
    air soon turns with the rig, so that travel has no effect (`still` = 0).
    """

    @override
    def thrust_N(self, at: Operands, thrust_N: ca.SX) -> ca.SX:
        through_air = {"travel_rate_rad_s": self.value(at, "still") * at.state["travel_rate_rad_s"]}
        climb_m_s = rotor_climb_m_s({**at.state, **through_air}, at.parameter)
        loaded = self.value(at, "loaded")
        return thrust_N - self.value(at, "s_per_m") * climb_m_s * (loaded * thrust_N + (1 - loaded) * _AT_N)


_AT_N: Final = 1.0
"""Thrust at which the loss is defined, if it is the same at any thrust."""


SPEC: Final = EffectSpec(
    id="inflow_damping",
    effect=InflowDamping,
    sentence="each rotor loses a share of {s_per_m} of its thrust to its own climb along its axis",
    equation=(
        r"F_i \to F_i - c\, v_i (l F_i + (1 - l) \cdot 1\,\mathrm{N}), "
        r"\quad v_i = \boldsymbol{n} \cdot \dot{\boldsymbol{r}}_i"
    ),
    acts_on="thrust",
    stage=Stage.INFLOW,
    numbers=(
        Parameter("s_per_m", "s/m", "share c lost for each m/s", 0.1, Prior(0.0, 0.5, 0.0, 2.0), size=True),
        Parameter(
            "loaded",
            "1",
            "1 if the loss is proportional to the thrust, 0 if it is the same at any thrust",
            1.0,
            grid=(1.0, 0.0),
        ),
        Parameter(
            "still",
            "1",
            "1 in air that stands still, 0 in air that turns with travel",
            1.0,
            grid=(1.0, 0.0),
        ),
    ),
    needs=("L_a", "L_h", "L_theta"),
    linearisable=True,
    rank=80,
    source="blade element theory: the loss goes with axial speed over blade speed, and with the thrust",
)
