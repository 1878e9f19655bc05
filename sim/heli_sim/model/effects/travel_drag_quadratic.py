"""Air drag of the travelling arm, which goes with the square of its speed."""

from __future__ import annotations

from typing import Final

import casadi as ca
from typing_extensions import override

from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.model.effects.kind import EffectKind, Parameter
from heli_sim.model.parts import on_axis
from heli_sim.rig.quantity import Prior


class TravelDragQuadratic(Effect):
    """Torque against travel in proportion to the square of its rate."""

    @override
    def torque_Nm(self, at: Operands) -> ca.SX:
        rate = at.state["travel_rate_rad_s"]
        return on_axis("travel", -self.own(at, "Nms2") * rate * ca.fabs(rate))


KIND: Final = EffectKind(
    id="travel_drag_quadratic",
    effect=TravelDragQuadratic,
    sentence="the air brakes travel by {Nms2}, with the square of its rate",
    equation=r"\tau_\psi = -d\, \dot\psi |\dot\psi|",
    acts_on="torque.travel",
    stage=Stage.TORQUE,
    numbers=(
        Parameter("Nms2", "N m s2/rad2", "torque d at 1 rad/s", 0.07, Prior(0.0, 0.1, -0.5, 2.0), size=True),
    ),
    rank=120,
    source="(22) of the paper, made to oppose motion",
)
