"""The rotor that leads in travel meets undisturbed air, and gives more thrust than the one in its wake."""

from __future__ import annotations

from typing import Final

import casadi as ca
from typing_extensions import override

from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.model.effects.spec import EffectSpec, Parameter
from heli_sim.rig.quantity import Prior


class EdgewiseFlow(Effect):
    """The leading rotor gains thrust and the other one loses it, in proportion to the edgewise speed.

    A rotor that moves in its own plane takes in more air at its leading edge, and so does a pair of rotors.
    The resulting torque raises the leading side. It opposes the pitch that drives travel, and so stabilises
    the rig.
    """

    @override
    def thrust_N(self, at: Operands, thrust_N: ca.SX) -> ca.SX:
        state, p = at.state, at.parameter
        cos_elevation, sin_elevation = ca.cos(state["elevation_rad"]), ca.sin(state["elevation_rad"])
        around_m_s = (p["L_a"] * cos_elevation + p["L_theta"] * sin_elevation) * state["travel_rate_rad_s"]
        up_m_s = p["L_a"] * state["elevation_rate_rad_s"]
        pitch = state["pitch_rad"]
        edgewise_m_s = around_m_s * ca.cos(pitch) - up_m_s * ca.sin(pitch)
        # Positive travel moves the back rotor ahead of the front one.
        return thrust_N * (1 + self.value(at, "s_per_m") * edgewise_m_s * ca.vertcat(-1, 1))


SPEC: Final = EffectSpec(
    id="edgewise_flow",
    effect=EdgewiseFlow,
    sentence=(
        "the rotor that leads in travel gains a share of {s_per_m} of its thrust, and the other loses it"
    ),
    equation=(
        r"F_f \to F_f (1 - c\, v), \quad F_b \to F_b (1 + c\, v), "
        r"\quad v = L_a (\dot\psi \cos\theta \cos\phi - \dot\theta \sin\phi)"
    ),
    acts_on="thrust",
    stage=Stage.INFLOW,
    numbers=(
        Parameter("s_per_m", "s/m", "share c for each m/s", 0.08, Prior(0.0, 0.3, 0.0, 1.0), size=True),
    ),
    needs=("L_a", "L_theta"),
    linearisable=True,
    rank=210,
    source="helicopter theory: a rotor in edgewise flow has more inflow at its trailing edge, and pitches up",
)
