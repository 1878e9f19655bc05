"""An encoder's zero is not where the axis is level."""

from __future__ import annotations

from typing import Final

import casadi as ca

from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.model.effects.kind import EffectKind, Parameter
from heli_sim.model.parts import AXES, on_axis
from heli_sim.rig.quantity import Prior


class ZeroOffset(Effect):
    """Constant error of one encoder, larger than the count or two that every flight's zeroing has."""

    def measured_rad(self, at: Operands, angles_rad: ca.SX) -> ca.SX:
        """Add the offset.

        Parameters
        ----------
        at : Operands
            Parameters.
        angles_rad : casadi.SX
            True angles, shape (3, 1).

        Returns
        -------
        casadi.SX
            Angles shown, shape (3, 1).
        """
        return angles_rad + on_axis(self.place, self.own(at, "rad"))


def _kind(axis: str) -> EffectKind:
    return EffectKind(
        id=f"zero_offset.{axis}",
        effect=ZeroOffset,
        says=f"the {axis} encoder shows {{rad}} too much",
        equation=r"y = q + z",
        acts_on=f"measurement.{axis}",
        stage=Stage.ZERO,
        numbers=(Parameter("rad", "rad", "offset z", 0.02, Prior(0.0, 0.03, -1.0, 1.0), size=True),),
        source="definition; on travel it shows only beside a spring, a tilt or an eccentricity",
    )


KINDS: Final = tuple(_kind(axis) for axis in AXES)
