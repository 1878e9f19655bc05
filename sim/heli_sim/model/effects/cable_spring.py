"""A cable acts like a spring when an axis turns."""

from __future__ import annotations

from typing import Final

import casadi as ca
from typing_extensions import override

from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.model.effects.spec import ChangeSpec, EffectSpec, Parameter
from heli_sim.model.parts import on_axis
from heli_sim.rig.quantity import Prior


class CableSpring(Effect):
    """Torque towards the angle at which the cable is relaxed, in proportion to the distance from it."""

    @override
    def torque_Nm(self, at: Operands) -> ca.SX:
        return on_axis(self.place, -self.value(at, "Nm_per_rad") * self._deflection_rad(at))

    @override
    def energy_J(self, at: Operands) -> ca.SX:
        return 0.5 * self.value(at, "Nm_per_rad") * self._deflection_rad(at) ** 2

    def _deflection_rad(self, at: Operands) -> ca.SX:
        return at.state[f"{self.place}_rad"] - self.value(at, "rest_rad")


def _spec(axis: str) -> EffectSpec:
    return EffectSpec(
        id=f"cable_spring.{axis}",
        effect=CableSpring,
        sentence=f"a cable pulls {axis} with {{Nm_per_rad}} towards {{rest_rad}}",
        equation=r"\tau = -k (q - q_0)",
        acts_on=f"torque.{axis}",
        stage=Stage.TORQUE,
        numbers=(
            Parameter(
                "Nm_per_rad", "N m/rad", "stiffness k", 0.05, Prior(0.0, 0.5, low=-2.0, high=5.0), size=True
            ),
            Parameter("rest_rad", "rad", "rest angle q_0", 0.0, Prior(0.0, 0.5, low=-6.3, high=6.3)),
        ),
        linearisable=True,
        change=ChangeSpec(
            (0.1, 0.03),
            f"a cable pulls {axis} with {{}}",
            f"a cable pushes {axis} with {{}}",
            # About an angle at rest a cable is a stiffness and a constant torque.
            numbers=(f"cable_spring_{axis}_Nm_per_rad", f"torque_{axis}"),
        ),
        rank=130,
        source="Hooke; a constant pull beside it is the rig's torque_" + axis,
    )


SPECS: Final = (_spec("elevation"), _spec("travel"))
