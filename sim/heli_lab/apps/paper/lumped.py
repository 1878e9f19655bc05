"""The paper's equations of motion (30), with the lumped coefficients P_1 to P_18 as parameters.

Signs and terms are those of (30), including P_18 and the drag, which (30) states as psi'^2 instead of psi'
|psi'|. The two are equal in the bench tests, because travel only moves forwards there. P_1 and P_15 contain
the dead zone of the rotors, 1 V, so that the equations only hold above this voltage.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca
from heli_sim.model.base import Effect, Model, Operands
from heli_sim.rig.quantity import Prior, Quantity
from typing_extensions import override

from heli_lab.apps.paper.coefficients import PRINTED


class Coefficients(Effect):
    """Coefficients P_1 to P_18 of the paper's equations (30) as parameters, in rad, s and V of U+ and U-."""

    def __init__(self, values: Mapping[str, float], prior_std: Mapping[str, float]) -> None:
        super().__init__(
            "coefficients",
            parameters=tuple(
                Quantity(printed.name, printed.si_unit, f"factor of {printed.term} in (30)")
                for printed in PRINTED
            ),
            values=dict(values),
            priors={name: Prior(values[name], std) for name, std in prior_std.items()},
        )


class LumpedModel(Model):
    """Equations of motion (30) of the paper; theta, phi and psi are elevation, pitch and travel."""

    name = "lumped"
    rig_parameters = ()

    def __init__(self, coefficients: Coefficients) -> None:
        super().__init__((coefficients,))

    @override
    def acceleration(self, at: Operands, thrust_N: ca.SX, torque_Nm: ca.SX) -> ca.SX:
        """Return the accelerations of elevation, pitch and travel by equations (30) [rad/s2]."""
        p, state = at.parameter, at.state
        theta, phi = state["elevation_rad"], state["pitch_rad"]
        travel_rate2 = state["travel_rate_rad_s"] ** 2
        sum_V, difference_V = at.volts_V[0] + at.volts_V[1], at.volts_V[0] - at.volts_V[1]
        return ca.vertcat(
            (p["P_1"] + p["P_6"] * sum_V) * ca.cos(phi)
            + p["P_2"] * ca.cos(theta)
            + p["P_3"] * ca.sin(theta)
            + p["P_4"] * state["elevation_rate_rad_s"]
            + p["P_5"],
            p["P_7"] * ca.cos(phi)
            + p["P_8"] * ca.sin(phi)
            + p["P_9"] * state["pitch_rate_rad_s"]
            + p["P_10"]
            + p["P_11"] * difference_V,
            p["P_12"] * state["travel_rate_rad_s"]
            + p["P_13"] * travel_rate2
            + p["P_14"]
            + (p["P_15"] + p["P_16"] * travel_rate2 + p["P_17"] * sum_V + p["P_18"] * difference_V)
            * ca.sin(phi),
        )
