"""Air drag of an arm that turns, which goes with the square of its speed."""

from __future__ import annotations

from typing import Final

import casadi as ca
from typing_extensions import override

from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.model.effects.spec import EffectSpec, Parameter
from heli_sim.model.parts import AXES, on_axis
from heli_sim.rig.quantity import Prior


class DragQuadratic(Effect):
    """Torque against an axis in proportion to the square of its rate; the effect's name begins with the
    axis.
    """

    @override
    def torque_Nm(self, at: Operands) -> ca.SX:
        axis = self.name.partition("_")[0]
        rate = at.state[f"{axis}_rate_rad_s"]
        return on_axis(axis, -self.value(at, "Nms2") * rate * ca.fabs(rate))


def _spec(axis: str, symbol: str, typical_Nms2: float, prior: Prior, source: str) -> EffectSpec:
    return EffectSpec(
        id=f"{axis}_drag_quadratic",
        effect=DragQuadratic,
        sentence=f"the air brakes {axis} by {{Nms2}}, with the square of its rate",
        equation=rf"\tau_{symbol} = -d\, \dot{symbol} |\dot{symbol}|",
        acts_on=f"torque.{axis}",
        stage=Stage.TORQUE,
        numbers=(Parameter("Nms2", "N m s2/rad2", "torque d at 1 rad/s", typical_Nms2, prior, size=True),),
        linearisable=True,
        rank=120,
        source=source,
    )


# The size has the lower bound 0, because drag opposes motion. With negative sizes, it had been named in two
# flights that had no such effect, next to dry friction (2026-11).
_BROADSIDE: Final = "drag of bodies: the square of the speed; (22) of the paper has it for travel alone"

SPECS: Final = (
    _spec(AXES[0], r"\theta", 0.1, Prior(0.0, 0.5, 0.0, 2.0), _BROADSIDE),
    _spec(AXES[1], r"\phi", 0.02, Prior(0.0, 0.1, 0.0, 2.0), _BROADSIDE),
    _spec(AXES[2], r"\psi", 0.07, Prior(0.0, 0.5, 0.0, 2.0), "(22) of the paper, made to oppose motion"),
)
