"""Effects between an axis and its reading: play, an eccentric disk, and a shifted zero."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import casadi as ca
from typing_extensions import override

from heli_sim.model.effect import AXES, Effect, Operands, Stage, on_axis
from heli_sim.model.effects.spec import ChangeSpec, EffectSpec, Parameter
from heli_sim.model.effects.spinning_rotors import TILTS
from heli_sim.rig.schema import Prior, Quantity


# Play between an axis and its encoder, for example because of a worn coupling or a gear.
class Backlash(Effect):
    """The encoder's shaft does not move until the axis has crossed the play and pushes it."""

    # The rotors are mounted on the arm, so that no drive train has play. The play is between axis and
    # encoder, and changes only the measured angle.

    @override
    def reset_map(self, at: Operands) -> ca.SX:
        angle, half = at.state[f"{self.place}_rad"], 0.5 * self.value(at, "rad")
        return ca.fmin(ca.fmax(self.value(at, "shaft_rad"), angle - half), angle + half)

    @override
    def alternative_starts(self, parameters: Mapping[str, float]) -> tuple[Mapping[str, float], ...]:
        # The measured angle is the middle of the play; the axis may be at either end.
        half_rad = 0.5 * parameters[f"{self.prefix}_rad"]
        return ({f"{self.place}_rad": half_rad}, {f"{self.place}_rad": -half_rad})

    @override
    def with_measured_angles(self) -> Effect:
        direction = Quantity(
            f"{self.prefix}_direction", "1", f"direction in which {self.place} has moved last"
        )
        return BacklashOfKnownSide(
            name=self.name,
            parameters=self.parameters,
            values=self.values,
            states=(direction,),
            priors=self.priors,
            stage=self.stage,
            direction_of={direction.name: self.place},
        )

    @override
    def measured_rad(self, at: Operands, angles_rad: ca.SX) -> ca.SX:
        index, shaft = AXES.index(self.place), self.reset_map(at)
        error_rad = shaft - at.state[f"{self.place}_rad"]
        return angles_rad + ca.vertcat(*(error_rad if i == index else ca.SX(0) for i in range(3)))


class BacklashOfKnownSide(Effect):
    """Backlash along a measured flight: the encoder's shaft lags behind its moving axis by half the play."""

    # Unlike the play operator of `Backlash`, this form is linear in the play. The measured angles are already
    # those of the shaft; the play operator would apply the play to them a second time.

    @override
    def measured_rad(self, at: Operands, angles_rad: ca.SX) -> ca.SX:
        error_rad = -0.5 * self.value(at, "rad") * self.value(at, "direction")
        return angles_rad + on_axis(self.place, error_rad)


def _backlash(axis: str) -> EffectSpec:
    return EffectSpec(
        id=f"backlash.{axis}",
        effect=Backlash,
        sentence=f"the {axis} encoder has a play of {{rad}}",
        equation=r"y \to \min(\max(y, q - b/2), q + b/2)",
        acts_on=f"measurement.{axis}",
        stage=Stage.PLAY,
        numbers=(
            Parameter(
                "rad",
                "rad",
                "whole play b",
                typical=0.01,
                prior=Prior(mean=0.0, std=0.03, low=0.0, high=0.3),
                size=True,
                # Not 0: there the shaft has no memory of its side, and the angle no derivative by b.
                neutral=1e-6,
            ),
        ),
        states=(Quantity("shaft_rad", "rad", f"angle y of the {axis} encoder's shaft"),),
        measured_as={"shaft_rad": axis},
        rank=160,
        source="play operator; the play lies between axis and encoder, since no gear drives the arm",
    )


BACKLASHS: Final = tuple(_backlash(axis) for axis in AXES)


# An encoder disc that is mounted off centre adds a sine of the angle to the measured angle.
class EncoderEccentricity(Effect):
    """Error with the sine and the cosine of the shaft's angle, once or several times a revolution."""

    @override
    def measured_rad(self, at: Operands, angles_rad: ca.SX) -> ca.SX:
        angle_rad = self.value(at, "order") * angles_rad[AXES.index(self.place)]
        error_rad = self.value(at, "sin_rad") * ca.sin(angle_rad) + self.value(at, "cos_rad") * ca.cos(
            angle_rad
        )
        return angles_rad + on_axis(self.place, error_rad)


def _encoder_eccentricity(axis: str) -> EffectSpec:
    return EffectSpec(
        id=f"encoder_eccentricity.{axis}",
        effect=EncoderEccentricity,
        sentence=(
            f"the {axis} encoder has an error of {{sin_rad}} with the sine and {{cos_rad}} with the cosine, "
            "periods per revolution: {order}"
        ),
        equation=r"y = q + a \sin n q + b \cos n q",
        acts_on=f"measurement.{axis}",
        stage=Stage.SHAFT,
        numbers=(
            Parameter(
                "sin_rad",
                "rad",
                "error a with the sine",
                typical=0.02,
                prior=Prior(mean=0.0, std=0.02, low=-0.5, high=0.5),
                size=True,
            ),
            Parameter(
                "cos_rad",
                "rad",
                "error b with the cosine",
                typical=0.0,
                prior=Prior(mean=0.0, std=0.02, low=-0.5, high=0.5),
                size=True,
            ),
            Parameter("order", "count", "periods n per revolution", typical=1.0, grid=(1.0, 2.0)),
        ),
        rank=170,
        source="geometry: a disc whose centre is off runs out once a revolution, an oval one twice",
    )


ENCODER_ECCENTRICITIES: Final = tuple(_encoder_eccentricity(axis) for axis in AXES)


# An encoder shows zero although the axis is not level.
class ZeroOffset(Effect):
    """Constant error of one encoder, larger than the one or two counts that remain after each zeroing."""

    @override
    def measured_rad(self, at: Operands, angles_rad: ca.SX) -> ca.SX:
        return angles_rad + on_axis(self.place, self.value(at, "rad"))


def _zero_offset(axis: str) -> EffectSpec:
    return EffectSpec(
        id=f"zero_offset.{axis}",
        effect=ZeroOffset,
        sentence=f"the {axis} encoder shows {{rad}} too much",
        equation=r"y = q + z",
        acts_on=f"measurement.{axis}",
        stage=Stage.ZERO,
        numbers=(
            Parameter(
                "rad",
                "rad",
                "offset z",
                typical=0.02,
                prior=Prior(mean=0.0, std=0.1, low=-1.0, high=1.0),
                size=True,
            ),
        ),
        change=ChangeSpec(
            sizes=(0.03,),
            positive=f"the {axis} encoder shows {{}} too much",
            negative=f"the {axis} encoder shows {{}} too little",
        ),
        family=TILTS if axis == "pitch" else None,
        family_numbers={"rad": 1.0} if axis == "pitch" else {},
        rank=180,
        source="definition; on travel it shows only beside a spring, a tilt or an eccentricity",
    )


ZERO_OFFSETS: Final = tuple(_zero_offset(axis) for axis in AXES)
