"""Gusts: a random torque with a size and a correlation time."""

from __future__ import annotations

from typing import Final

import casadi as ca
from typing_extensions import override

from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.model.effects.spec import EffectSpec, Parameter
from heli_sim.model.parts import AXES, on_axis
from heli_sim.rig.quantity import Prior, Quantity


class RandomTorque(Effect):
    """Ornstein-Uhlenbeck process: white noise through a first-order lag.

    A simulation draws the noise from its seed. Identification cannot know the noise and uses the mean of the
    process, which decays from its value at the start of a window.
    """

    @override
    def torque_Nm(self, at: Operands) -> ca.SX:
        return on_axis(self.place, self.value(at, "now_Nm"))

    @override
    def state_rates(self, at: Operands) -> ca.SX:
        return -self.value(at, "now_Nm") / self.value(at, "s")

    @override
    def diffusion(self, at: Operands, step_s: float, normal: ca.SX) -> ca.SX:
        # Exact sampling: the stationary standard deviation is Nm for any length of step.
        return self.value(at, "Nm") * ca.sqrt(1 - ca.exp(-2 * step_s / self.value(at, "s"))) * normal


def _spec(axis: str, typical_Nm: float) -> EffectSpec:
    return EffectSpec(
        id=f"random_torque.{axis}",
        effect=RandomTorque,
        sentence=f"gusts of {{Nm}} (standard deviation) that last {{s}} push {axis}",
        equation=r"\dot d = -d / T + \sigma \sqrt{2 / T}\, w, \quad \tau = d",
        acts_on=f"torque.{axis}",
        stage=Stage.TORQUE,
        numbers=(
            Parameter(
                "Nm",
                "N m",
                "standard deviation sigma",
                typical_Nm,
                Prior(0.0, typical_Nm, 0.0, 2.0),
                size=True,
            ),
            Parameter("s", "s", "time T over which it forgets", 0.5, Prior(0.5, 0.5, low=0.02, high=20.0)),
        ),
        states=(Quantity("now_Nm", "N m", f"random torque d on the {axis} axis"),),
        noise_inputs=1,
        rank=200,
        source="the simplest coloured noise; Dryden's gusts are of this kind",
    )


SPECS: Final = tuple(_spec(axis, size) for axis, size in zip(AXES, (0.03, 0.005, 0.02), strict=True))
