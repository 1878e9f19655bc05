"""Play between an axis and its encoder, for example because of a worn coupling or a gear."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import casadi as ca
from typing_extensions import override

from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.model.effects.spec import EffectSpec, Parameter
from heli_sim.model.parts import AXES, on_axis
from heli_sim.rig.quantity import Prior, Quantity


class Backlash(Effect):
    """The encoder's shaft does not move until the axis has crossed the play and pushes it.

    The rotors are mounted on the arm, so that no drive train has play. The play is between axis and encoder,
    and changes only the measured angle.
    """

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
    """Backlash along a measured flight: the encoder's shaft lags behind its moving axis by half the play.

    Unlike the play operator of `Backlash`, this form is linear in the play. The measured angles are already
    those of the shaft; the play operator would apply the play to them a second time.
    """

    @override
    def measured_rad(self, at: Operands, angles_rad: ca.SX) -> ca.SX:
        error_rad = -0.5 * self.value(at, "rad") * self.value(at, "direction")
        return angles_rad + on_axis(self.place, error_rad)


def _spec(axis: str) -> EffectSpec:
    return EffectSpec(
        id=f"backlash.{axis}",
        effect=Backlash,
        sentence=f"the {axis} encoder has a play of {{rad}}",
        equation=r"y \to \min(\max(y, q - b/2), q + b/2)",
        acts_on=f"measurement.{axis}",
        stage=Stage.PLAY,
        # Without any play the shaft has no memory of which side it lies on, and the size no derivative.
        numbers=(
            Parameter(
                "rad", "rad", "whole play b", 0.01, Prior(0.0, 0.03, 0.0, 0.3), size=True, neutral=1e-6
            ),
        ),
        states=(Quantity("shaft_rad", "rad", f"angle y of the {axis} encoder's shaft"),),
        measured_as={"shaft_rad": axis},
        rank=160,
        source="play operator; the play lies between axis and encoder, since no gear drives the arm",
    )


SPECS: Final = tuple(_spec(axis) for axis in AXES)
