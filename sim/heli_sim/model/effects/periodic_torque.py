"""A torque that oscillates at a fixed frequency, for example by an unbalanced shaft or a shaking table."""

from __future__ import annotations

from typing import Final

import casadi as ca
import numpy as np
from typing_extensions import override

from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.model.effects.spec import EffectSpec, Parameter
from heli_sim.model.parts import AXES, on_axis
from heli_sim.rig.quantity import Prior

_HIGHEST_Hz: Final = 5.0
"""Highest frequency of the search; above it, the inertia of an axis hides the effect of the torque."""


class PeriodicTorque(Effect):
    """A torque that is the sum of a sine and a cosine of time."""

    @override
    def torque_Nm(self, at: Operands) -> ca.SX:
        phase = 2 * np.pi * self.value(at, "Hz") * at.time_s
        torque = self.value(at, "sin_Nm") * ca.sin(phase) + self.value(at, "cos_Nm") * ca.cos(phase)
        return on_axis(self.place, torque)


def _frequencies_Hz(seconds: float) -> tuple[float, ...]:
    """Return the frequencies at which a fit starts.

    Their spacing is half the difference that a flight of `seconds` can resolve.
    """
    return tuple(np.arange(0.05, _HIGHEST_Hz, 0.5 / seconds).tolist())


def _spec(axis: str, typical_Nm: float) -> EffectSpec:
    wide = Prior(0.0, 2 * typical_Nm, -1.0, 1.0)
    return EffectSpec(
        id=f"periodic_torque.{axis}",
        effect=PeriodicTorque,
        sentence=f"a torque of {{sin_Nm}} (sine) and {{cos_Nm}} (cosine) shakes {axis} at {{Hz}}",
        equation=r"\tau = a \sin 2\pi f t + b \cos 2\pi f t",
        acts_on=f"torque.{axis}",
        stage=Stage.TORQUE,
        numbers=(
            Parameter("sin_Nm", "N m", "amplitude a of the sine", typical_Nm, wide, size=True),
            Parameter("cos_Nm", "N m", "amplitude b of the cosine", 0.0, wide, size=True),
            Parameter(
                "Hz", "Hz", "frequency f", 0.5, Prior(0.5, 2.0, low=0.01, high=20.0), grid=_frequencies_Hz
            ),
        ),
        rank=190,
        source="definition",
    )


SPECS: Final = tuple(_spec(axis, size) for axis, size in zip(AXES, (0.05, 0.01, 0.03), strict=True))
