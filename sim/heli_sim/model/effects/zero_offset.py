"""An encoder shows zero although the axis is not level."""

from __future__ import annotations

from typing import Final

import casadi as ca
from typing_extensions import override

from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.model.effects.rotor_reaction_torque import TILTS
from heli_sim.model.effects.spec import ChangeSpec, EffectSpec, Parameter
from heli_sim.model.parts import AXES, on_axis
from heli_sim.rig.quantity import Prior


class ZeroOffset(Effect):
    """Constant error of one encoder, larger than the one or two counts that remain after each zeroing."""

    @override
    def measured_rad(self, at: Operands, angles_rad: ca.SX) -> ca.SX:
        return angles_rad + on_axis(self.place, self.value(at, "rad"))


def _spec(axis: str) -> EffectSpec:
    return EffectSpec(
        id=f"zero_offset.{axis}",
        effect=ZeroOffset,
        sentence=f"the {axis} encoder shows {{rad}} too much",
        equation=r"y = q + z",
        acts_on=f"measurement.{axis}",
        stage=Stage.ZERO,
        numbers=(Parameter("rad", "rad", "offset z", 0.02, Prior(0.0, 0.1, -1.0, 1.0), size=True),),
        change=ChangeSpec(
            (0.03,), f"the {axis} encoder shows {{}} too much", f"the {axis} encoder shows {{}} too little"
        ),
        family=TILTS if axis == "pitch" else None,
        family_numbers={"rad": 1.0} if axis == "pitch" else {},
        rank=180,
        source="definition; on travel it shows only beside a spring, a tilt or an eccentricity",
    )


SPECS: Final = tuple(_spec(axis) for axis in AXES)
