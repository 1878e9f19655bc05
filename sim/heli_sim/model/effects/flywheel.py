"""Rotors are flywheels: their angular momentum is proportional to their speed, which lags the voltage."""

from __future__ import annotations

from typing import Final

import casadi as ca
from typing_extensions import override

from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.model.effects.gyroscopic_torque import MOMENTA, wheel_torque_Nm
from heli_sim.model.effects.spec import EffectSpec, Parameter
from heli_sim.model.parts import upright_torque_Nm
from heli_sim.rig.quantity import Prior, Quantity


class Flywheel(Effect):
    """Angular momentum of the rotors along the thrust direction, in proportion to the sum of their speeds.

    In `gyroscopic_torque`, the momentum is proportional to the thrust instead. Thrust is zero in the dead
    zone and grows with the square of the speed, so it varies more than the momentum. A speed is expressed as
    the voltage that holds it. The torque that accelerates the rotors also turns the rig the other way;
    `spin_up` is its share.
    """

    @override
    def torque_Nm(self, at: Operands) -> ca.SX:
        momentum_per_V, speed_rate = self.value(at, "Nms_per_V"), self.state_rates(at)
        reaction = upright_torque_Nm(at.state, -self.value(at, "spin_up") * momentum_per_V * speed_rate)
        return wheel_torque_Nm(at, momentum_per_V * self.value(at, "both_V")) + reaction

    @override
    def state_rates(self, at: Operands) -> ca.SX:
        return (at.volts_V[0] + at.volts_V[1] - self.value(at, "both_V")) / self.value(at, "s")


SPEC: Final = EffectSpec(
    id="flywheel",
    effect=Flywheel,
    sentence=(
        "the rotors spin the same way, with an angular momentum of {Nms_per_V} for each volt, "
        "which follows the voltage with a lag of {s}"
    ),
    equation=(
        r"T \dot w = V_f + V_b - w, \quad H = h w, \quad \tau = H (\cos\phi\, (\dot\phi - "
        r"\dot\psi \sin\theta),\, -\dot\theta \cos\phi - \dot\psi \cos\theta \sin\phi,\, "
        r"\dot\theta \sin\theta \cos\phi + \dot\phi \cos\theta \sin\phi) "
        r"- s \dot H (-\sin\phi,\, 0,\, \cos\phi \cos\theta)"
    ),
    acts_on="torque.pitch",
    stage=Stage.TORQUE,
    numbers=(
        Parameter(
            "Nms_per_V",
            "N m s/V",
            "angular momentum h for each volt, up positive",
            0.01,
            Prior(0.0, 0.05, -0.3, 0.3),
            size=True,
        ),
        Parameter("s", "s", "time constant T of the speed", 0.1, Prior(0.1, 0.06, low=0.01, high=0.6)),
        Parameter("spin_up", "1", "share s of the torque of spinning up that turns the rig back", 0.0),
    ),
    states=(Quantity("both_V", "V", "sum of the rotors' speeds as the voltages that hold them"),),
    family=MOMENTA,
    linearisable=True,
    rank=230,
    source="rigid-body mechanics, and a motor's first-order lag",
)
