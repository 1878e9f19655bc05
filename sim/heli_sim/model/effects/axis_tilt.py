"""The travel axis is not vertical, so that gravity turns travel towards the low side."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import casadi as ca
from typing_extensions import override

from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.model.effects.spec import EffectSpec, Parameter
from heli_sim.model.parts import AXES
from heli_sim.rig.quantity import Prior


class AxisTilt(Effect):
    """Gravity of all masses, if the true vertical leans in the frame of the rig.

    The upward vertical leans by `x_rad` towards the direction of the long arm at travel 0, and by `y_rad`
    towards its direction after a quarter turn of positive travel.
    """

    @override
    def torque_Nm(self, at: Operands) -> ca.SX:
        # Minus the gradient of the potential that the tilt adds.
        q = ca.SX.sym("q", 3)
        torque = -ca.gradient(self._potential_J(at, q), q)
        return ca.substitute(torque, q, ca.vertcat(*(at.state[f"{axis}_rad"] for axis in AXES)))

    @override
    def energy_J(self, at: Operands) -> ca.SX:
        return self._potential_J(at, ca.vertcat(*(at.state[f"{axis}_rad"] for axis in AXES)))

    def _potential_J(self, at: Operands, q: ca.SX) -> ca.SX:
        """Return the potential energy that the tilt adds at the angles `q`."""
        x, y = self.value(at, "x_rad"), self.value(at, "y_rad")
        angle2 = x**2 + y**2
        # Change of the unit vector by the lean a: horizontal part sin|a| (x, y)/|a|, vertical part cos|a| -
        # 1. Taylor series to 4th order have derivatives at 0, and are exact enough up to 1 rad.
        up = ca.vertcat(ca.vertcat(x, y) * (1 - angle2 / 6 + angle2**2 / 120), -angle2 / 2 + angle2**2 / 24)
        return at.parameter["g"] * ca.dot(up, _moment_kg_m(at.parameter, q))


def _moment_kg_m(p: Mapping[str, ca.SX], q: ca.SX) -> ca.SX:
    """Return the sum of mass times position of the five masses, in the frame of the rig, shape (3, 1)."""
    cos_elevation, sin_elevation = ca.cos(q[0]), ca.sin(q[0])
    cos_pitch, sin_pitch = ca.cos(q[1]), ca.sin(q[1])
    short_arm_kg = p["M_f"] + p["M_b"] + p["M_h"]
    # At pitch 0, the masses of the short arm are L_phi below its axis, and the rotors L_h to either side.
    y_level, z_level = (p["M_b"] - p["M_f"]) * p["L_h"], -p["L_phi"] * short_arm_kg
    y, z = y_level * cos_pitch + z_level * sin_pitch, z_level * cos_pitch - y_level * sin_pitch
    x = p["M_l"] * p["L_x"] - p["M_w"] * p["L_b"] + short_arm_kg * p["L_a"]
    z = z - p["L_theta"] * (p["M_l"] + p["M_w"] + short_arm_kg)
    along, up = x * cos_elevation - z * sin_elevation, x * sin_elevation + z * cos_elevation
    return ca.vertcat(along * ca.cos(q[2]) - y * ca.sin(q[2]), along * ca.sin(q[2]) + y * ca.cos(q[2]), up)


SPEC: Final = EffectSpec(
    id="axis_tilt",
    effect=AxisTilt,
    sentence="the travel axis leans by {x_rad} towards the arm at travel 0 and by {y_rad} across",
    equation=r"U = g\, \boldsymbol{n} \cdot \sum m_j \boldsymbol{r}_j,\ \boldsymbol{n} \approx (a_x, a_y, 1)",
    acts_on="torque.travel",
    stage=Stage.TORQUE,
    numbers=(
        Parameter("x_rad", "rad", "lean a_x towards the arm", 0.03, Prior(0.0, 0.1, -0.5, 0.5), size=True),
        Parameter("y_rad", "rad", "lean a_y across the arm", 0.0, Prior(0.0, 0.1, -0.5, 0.5), size=True),
    ),
    needs=("M_f", "M_b", "M_w", "M_h", "M_l", "L_a", "L_b", "L_h", "L_phi", "L_theta", "L_x", "g"),
    linearisable=True,
    rank=140,
    source="potential of the five masses of Table 2",
)
