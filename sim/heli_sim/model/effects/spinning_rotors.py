"""Effects of the spinning rotors on the rig: reaction torque and angular momentum."""

from __future__ import annotations

from typing import Final

import casadi as ca
from typing_extensions import override

from heli_sim.model.effect import Effect, Operands, Stage, upright_torque_Nm
from heli_sim.model.effects.spec import EffectFamily, EffectSpec, Parameter
from heli_sim.rig.schema import Prior, Quantity


# Reaction torque of the rotors: the air that a rotor turns one way turns the rig the other way.
class RotorReactionTorque(Effect):
    """Torque of each rotor about its thrust axis, in proportion to its thrust."""

    # Each rotor has its own ratio. The signs are equal if both rotors turn the same way, and opposite
    # otherwise.

    @override
    def torque_Nm(self, at: Operands) -> ca.SX:
        torque = self.value(at, "front_m") * at.thrust_N[0] + self.value(at, "back_m") * at.thrust_N[1]
        return upright_torque_Nm(at.state, torque)


TILTS: Final = EffectFamily(
    name="tilt of the thrust",
    unclear="these flights do not show whether it is a zero error or a reaction torque of both rotors",
    sentence="the thrust points {} away from where the pitch encoder shows it",
    unit="rad",
    in_part=True,
)
"""A reaction torque q of both rotors turns the direction of the thrust about the long arm L_a by q / L_a. A
zero error -q / L_a of the pitch encoder has the same torques about elevation and travel. Its constant torque
about pitch cannot be distinguished from a short arm that is not balanced. If the torques of both rotors
differ, no zero error is equivalent."""

ROTOR_REACTION_TORQUE: Final = EffectSpec(
    id="rotor_reaction_torque",
    effect=RotorReactionTorque,
    sentence="the rotors' air drag turns the rig about their axes by {front_m} (front) and {back_m} (back)",
    equation=r"\tau_n = q_f F_f + q_b F_b, \quad \tau = \tau_n (-\sin\phi,\, 0,\, \cos\phi \cos\theta)",
    acts_on="torque.travel",
    stage=Stage.TORQUE,
    numbers=(
        Parameter(
            "front_m",
            "N m/N",
            "torque q_f for each newton in front",
            typical=0.03,
            prior=Prior(mean=0.0, std=0.1, low=-1, high=1),
            size=True,
        ),
        Parameter(
            "back_m",
            "N m/N",
            "torque q_b for each newton at the back",
            typical=-0.03,
            prior=Prior(mean=0.0, std=0.1, low=-1, high=1),
            size=True,
        ),
    ),
    family=TILTS,
    family_numbers={"front_m": -0.5, "back_m": -0.5},
    family_divisor="L_a",
    linearisable=True,
    rank=100,
    source="propeller theory: thrust and drag torque both go with the square of the speed",
)


# Spinning rotors are gyroscopes: a rotation about one axis causes a torque about another axis.
class GyroscopicTorque(Effect):
    """Angular momentum of the rotors along the short arm's upright, in proportion to their thrust."""

    # The momenta of two rotors that turn in opposite directions cancel. Two rotors that turn in the same
    # direction have 0.03 to 0.06 N m s on a rig with 0.2 m propellers. The torque does no work: it moves
    # energy from one axis to another.

    @override
    def torque_Nm(self, at: Operands) -> ca.SX:
        return wheel_torque_Nm(at, self.value(at, "m_s") * (at.thrust_N[0] + at.thrust_N[1]))


def wheel_torque_Nm(at: Operands, momentum_Nms: ca.SX) -> ca.SX:
    """Return the gyroscopic torque of a wheel on the short arm about the three axes, shape (3, 1)."""
    # It is n x omega H, with the angular velocity omega of the short arm and its thrust direction n.
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

GYROSCOPIC_TORQUE: Final = EffectSpec(
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
            typical=0.03,
            prior=Prior(mean=0.0, std=0.15, low=-1, high=1),
            size=True,
        ),
    ),
    family=MOMENTA,
    linearisable=True,
    rank=220,
    source="rigid-body mechanics; going with the thrust, it suits measured flights better than a constant",
)


# Rotors are flywheels: their angular momentum is proportional to their speed, which lags the voltage.
class Flywheel(Effect):
    """Angular momentum of the rotors along the thrust direction, in proportion to the sum of their speeds."""

    # In `gyroscopic_torque`, the momentum is proportional to the thrust instead. Thrust is zero in the dead
    # zone and grows with the square of the speed, so it varies more than the momentum. A speed is expressed
    # as the voltage that holds it. The torque that accelerates the rotors also turns the rig the other way;
    # `spin_up` is its share.

    @override
    def torque_Nm(self, at: Operands) -> ca.SX:
        momentum_per_V, speed_rate = self.value(at, "Nms_per_V"), self.state_rates(at)
        reaction = upright_torque_Nm(at.state, -self.value(at, "spin_up") * momentum_per_V * speed_rate)
        return wheel_torque_Nm(at, momentum_per_V * self.value(at, "both_V")) + reaction

    @override
    def state_rates(self, at: Operands) -> ca.SX:
        return (at.volts_V[0] + at.volts_V[1] - self.value(at, "both_V")) / self.value(at, "s")


FLYWHEEL: Final = EffectSpec(
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
            typical=0.01,
            prior=Prior(mean=0.0, std=0.05, low=-0.3, high=0.3),
            size=True,
        ),
        Parameter(
            "s",
            "s",
            "time constant T of the speed",
            typical=0.1,
            prior=Prior(mean=0.1, std=0.06, low=0.01, high=0.6),
        ),
        Parameter(
            "spin_up", "1", "share s of the torque of spinning up that turns the rig back", typical=0.0
        ),
    ),
    states=(Quantity("both_V", "V", "sum of the rotors' speeds as the voltages that hold them"),),
    family=MOMENTA,
    linearisable=True,
    rank=230,
    source="rigid-body mechanics, and a motor's first-order lag",
)
