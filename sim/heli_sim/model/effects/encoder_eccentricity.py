"""An encoder disc that is mounted off centre adds a sine of the angle to the measured angle."""

from __future__ import annotations

from typing import Final

import casadi as ca
from typing_extensions import override

from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.model.effects.spec import EffectSpec, Parameter
from heli_sim.model.parts import AXES, on_axis
from heli_sim.rig.quantity import Prior


class EncoderEccentricity(Effect):
    """Error with the sine and the cosine of the shaft's angle, once or several times a revolution."""

    @override
    def measured_rad(self, at: Operands, angles_rad: ca.SX) -> ca.SX:
        angle_rad = self.value(at, "order") * angles_rad[AXES.index(self.place)]
        error_rad = self.value(at, "sin_rad") * ca.sin(angle_rad) + self.value(at, "cos_rad") * ca.cos(
            angle_rad
        )
        return angles_rad + on_axis(self.place, error_rad)


def _spec(axis: str) -> EffectSpec:
    return EffectSpec(
        id=f"encoder_eccentricity.{axis}",
        effect=EncoderEccentricity,
        sentence=(
            f"the {axis} encoder has an error of {{sin_rad}} with the sine and {{cos_rad}} with the cosine, "
            "{order} periods a revolution"
        ),
        equation=r"y = q + a \sin n q + b \cos n q",
        acts_on=f"measurement.{axis}",
        stage=Stage.SHAFT,
        numbers=(
            Parameter(
                "sin_rad", "rad", "error a with the sine", 0.02, Prior(0.0, 0.02, -0.5, 0.5), size=True
            ),
            Parameter(
                "cos_rad", "rad", "error b with the cosine", 0.0, Prior(0.0, 0.02, -0.5, 0.5), size=True
            ),
            Parameter("order", "count", "periods n a revolution", 1.0, grid=(1.0, 2.0)),
        ),
        rank=170,
        source="geometry: a disc whose centre is off runs out once a revolution, an oval one twice",
    )


SPECS: Final = tuple(_spec(axis) for axis in AXES)
