"""Reaction torque of the rotors: the air that a rotor turns one way turns the rig the other way."""

from __future__ import annotations

from typing import Final

import casadi as ca
from typing_extensions import override

from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.model.effects.spec import EffectFamily, EffectSpec, Parameter
from heli_sim.model.parts import upright_torque_Nm
from heli_sim.rig.quantity import Prior


class RotorReactionTorque(Effect):
    """Torque of each rotor about its thrust axis, in proportion to its thrust.

    Each rotor has its own ratio. The signs are equal if both rotors turn the same way, and opposite
    otherwise.
    """

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

SPEC: Final = EffectSpec(
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
            0.03,
            Prior(0.0, 0.1, -1, 1),
            size=True,
        ),
        Parameter(
            "back_m",
            "N m/N",
            "torque q_b for each newton at the back",
            -0.03,
            Prior(0.0, 0.1, -1, 1),
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
