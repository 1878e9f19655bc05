"""Spinning rotors are gyroscopes: a rotation about one axis causes a torque about another axis."""

from __future__ import annotations

from typing import Final

import casadi as ca
from typing_extensions import override

from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.model.effects.spec import EffectFamily, EffectSpec, Parameter
from heli_sim.rig.quantity import Prior


class GyroscopicTorque(Effect):
    """Angular momentum of the rotors along the short arm's upright, in proportion to their thrust.

    The momenta of two rotors that turn in opposite directions cancel. Two rotors that turn in the same
    direction have 0.03 to 0.06 N m s on a rig with 0.2 m propellers. The torque does no work: it moves energy
    from one axis to another.
    """

    @override
    def torque_Nm(self, at: Operands) -> ca.SX:
        return wheel_torque_Nm(at, self.value(at, "m_s") * (at.thrust_N[0] + at.thrust_N[1]))


def wheel_torque_Nm(at: Operands, momentum_Nms: ca.SX) -> ca.SX:
    """Return the gyroscopic torque of a wheel on the short arm about the three axes, shape (3, 1).

    It is n x omega H, with the angular velocity omega of the short arm and its thrust direction n.
    """
    state = at.state
    cos_elevation, sin_elevation = ca.cos(state["elevation_rad"]), ca.sin(state["elevation_rad"])
    cos_pitch, sin_pitch = ca.cos(state["pitch_rad"]), ca.sin(state["pitch_rad"])
    elevation_rad_s, pitch_rad_s = state["elevation_rate_rad_s"], state["pitch_rate_rad_s"]
    travel_rad_s = state["travel_rate_rad_s"]
    return momentum_Nms * ca.vertcat(
        cos_pitch * (pitch_rad_s - sin_elevation * travel_rad_s),
        -cos_pitch * elevation_rad_s - cos_elevation * sin_pitch * travel_rad_s,
        sin_elevation * cos_pitch * elevation_rad_s + cos_elevation * sin_pitch * pitch_rad_s,
    )


MOMENTA: Final = EffectFamily(
    name="angular momentum of the rotors",
    unclear="these flights do not show whether it goes with the thrust or with the voltage",
)
"""About a hover, thrust and voltage rise and fall together."""

SPEC: Final = EffectSpec(
    id="gyroscopic_torque",
    effect=GyroscopicTorque,
    sentence=(
        "the rotors spin the same way, with an angular momentum of {m_s} for each newton of their thrust"
    ),
    equation=(
        r"H = h (F_f + F_b), \quad \tau = H (\cos\phi\, (\dot\phi - \dot\psi \sin\theta),\, "
        r"-\dot\theta \cos\phi - \dot\psi \cos\theta \sin\phi,\, "
        r"\dot\theta \sin\theta \cos\phi + \dot\phi \cos\theta \sin\phi)"
    ),
    acts_on="torque.pitch",
    stage=Stage.TORQUE,
    numbers=(
        Parameter(
            "m_s",
            "N m s/N",
            "angular momentum h for each newton, up positive",
            0.03,
            Prior(0.0, 0.15, -1, 1),
            size=True,
        ),
    ),
    family=MOMENTA,
    linearisable=True,
    rank=220,
    source="rigid-body mechanics; going with the thrust, it suits measured flights better than a constant",
)
