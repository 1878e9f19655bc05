"""The paper's equations of motion (30), with the lumped coefficients P_1 to P_18 as parameters.

The coefficients have printed values, and values computed from masses, lengths and friction. Signs and terms
are those of (30), including P_18 and the drag, which (30) states as psi'^2 instead of psi' |psi'|. The two
are equal in the bench tests, because travel only moves forwards there. P_1 and P_15 contain the dead zone of
the rotors, 1 V, so that the equations only hold above this voltage.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import casadi as ca
import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.model.base import Effect, Model, Operands
from heli_sim.model.plant import runge_kutta_step
from heli_sim.rig import Rig
from heli_sim.rig.schema import Prior, Quantity
from typing_extensions import override

from heli_lab.apps.paper.experiments import TABLE_DEG, BenchTest

DEG: Final = math.degrees(1.0)


@dataclass(frozen=True)
class Printed:
    """A coefficient of (30) as printed in a table of the paper."""

    name: str  # P_1 to P_18
    table: int  # Number of the table: 3, 4 or 5
    value: float  # value, tolerance: Printed value and tolerance
    tolerance: float
    unit: str  # Unit in which the printed value is most plausible; the tables state none
    per_si: float  # Factor from rad, s and V of U+ and U- to this unit
    term: str  # Term of (30) that the coefficient multiplies

    @property
    def si_unit(self) -> str:
        """Unit of the coefficient in rad, s and V of U+ and U-."""
        return self.unit.replace("deg", "rad").removesuffix(" each")


PRINTED: Final[tuple[Printed, ...]] = (
    Printed("P_7", 3, 6.61464, 0.1, "rad/s2", 1.0, "cos phi"),
    Printed("P_8", 3, -6.323, 0.4, "rad/s2", 1.0, "sin phi"),
    Printed("P_9", 3, -1.395, 0.5, "1/s", 1.0, "phi'"),
    Printed("P_10", 3, -5.974, 0.7, "rad/s2", 1.0, "1"),
    Printed("P_11", 3, 96.728, 0.5, "deg/s2/V", DEG, "U-"),
    Printed("P_1", 4, -56.57475, 1.0, "deg/s2", DEG, "cos phi"),
    Printed("P_2", 4, 0.83576, 0.5, "deg/s2", DEG, "cos theta"),
    Printed("P_3", 4, -0.06123, 0.1, "deg/s2", DEG, "sin theta"),
    Printed("P_4", 4, -0.3366, 0.01, "1/s", 1.0, "theta'"),
    Printed("P_5", 4, -380.789, 5.0, "deg/s2", DEG, "1"),
    # 2: the input is the voltage of each motor, not their sum.
    Printed("P_6", 4, 59.201, 1.0, "deg/s2/V each", 2.0 * DEG, "cos phi U+"),
    Printed("P_12", 5, -0.0072, 0.01, "1/s", 1.0, "psi'"),
    Printed("P_13", 5, -0.0006, 0.0003, "1/rad", 1.0, "psi'^2"),
    Printed("P_14", 5, 0.003, 0.001, "rad/s2", 1.0, "1"),
    Printed("P_15", 5, -0.00022, 0.0001, "rad/s2", 1.0, "sin phi"),
    Printed("P_16", 5, -0.224, 0.01, "1/rad", 1.0, "psi'^2 sin phi"),
    Printed("P_17", 5, -0.03, 0.002, "rad/s2/V", 1.0, "sin phi U+"),
    Printed("P_18", 5, 0.01, 0.001, "rad/s2/V", 1.0, "sin phi U-"),
)
"""Tables 3, 4 and 5, in their order."""


def printed_inertias_kg_m2(rig: Rig, elevation_rad: float = 0.0, pitch_rad: float = 0.0) -> dict[str, float]:
    """Compute J_theta, J_phi and J_psi [kg m^2] by (27), (28) and (29) as printed in the paper."""
    value = {name: number.value for name, number in rig.items()}
    rotors_kg, rotor_distance2_m2 = value["M_f"] + value["M_b"], value["L_h"] ** 2 + value["L_phi"] ** 2
    arm_offset2_m2, cos_elevation = value["L_theta"] ** 2, math.cos(elevation_rad)
    return {
        "J_theta": rotors_kg * (rotor_distance2_m2 * math.sin(pitch_rad) ** 2 + value["L_a"] ** 2)
        + value["M_l"] * (value["L_x"] ** 2 + arm_offset2_m2)
        + value["M_w"] * (value["L_b"] ** 2 + arm_offset2_m2)
        + value["M_h"] * (value["L_a"] ** 2 + arm_offset2_m2),
        "J_phi": rotors_kg * rotor_distance2_m2 + value["M_h"] * value["L_phi"] ** 2,
        "J_psi": rotors_kg
        * (rotor_distance2_m2 * math.cos(pitch_rad) ** 2 + (value["L_a"] * cos_elevation) ** 2)
        + (
            value["M_l"] * value["L_x"] ** 2
            + value["M_w"] * value["L_b"] ** 2
            + value["M_h"] * value["L_a"] ** 2
        )
        * cos_elevation**2,
    }


def analytic(rig: Rig, corrected: bool = True) -> dict[str, float]:
    """Compute P_1 to P_18 from a rig's parameters, by the formulas that the paper prints below (30)."""
    # The results are in rad, s and V of U+ and U-.
    value = {name: number.value for name, number in rig.items()}
    inertia = printed_inertias_kg_m2(rig)
    j_theta, j_phi, j_psi = (inertia[name] for name in ("J_theta", "J_phi", "J_psi"))
    gain_N_per_V, offset_N = value["thrust_gain"], 2.0 * value["thrust_gain"] * value["dead_zone"]
    tilting_weight_N = (value["M_f"] + value["M_b"] + value["M_h"]) * value["g"]
    drag = 0.5 * value["air_density"] * value["L_a"] ** (3 if corrected else 2) / j_psi
    return {
        "P_1": -offset_N * value["L_a"] / j_theta,
        "P_2": (
            value["M_w"] * value["L_b"] * value["g"]
            - tilting_weight_N * value["L_a"]
            - value["M_l"] * value["g"] * value["L_x"]
        )
        / j_theta,
        "P_3": -(tilting_weight_N + (value["M_w"] + value["M_l"]) * value["g"]) * value["L_theta"] / j_theta,
        "P_4": -value["friction_elevation"] / j_theta,
        "P_5": value["torque_elevation"] / j_theta,
        "P_6": gain_N_per_V * value["L_a"] / j_theta,
        "P_7": (value["M_b"] - value["M_f"]) * value["g"] * value["L_h"] / j_phi,
        "P_8": -tilting_weight_N * value["L_phi"] / j_phi,
        "P_9": -value["friction_pitch"] / j_phi,
        "P_10": value["torque_pitch"] / j_phi,
        "P_11": gain_N_per_V * value["L_h"] / j_phi,
        "P_12": -value["friction_travel"] / j_psi,
        "P_13": -drag * value["drag_area_arm"],
        "P_14": value["torque_travel"] / j_psi,
        "P_15": -offset_N * value["L_a"] / j_psi,
        "P_16": -drag * value["drag_area_body"],
        "P_17": gain_N_per_V * value["L_a"] / j_psi,
        "P_18": 0.0 if corrected else gain_N_per_V * value["L_h"] / j_psi,
    }


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


_STEP_s: Final = 0.01
"""Longest step of the integration [s]."""


@dataclass(frozen=True)
class SensitivityCase:
    """One curve of the figure: a step response with some coefficients changed."""

    label: str  # Text in the legend
    changes: Mapping[str, float]  # Factors on coefficients, by name; 0 neglects a coefficient


CASES: Final[tuple[SensitivityCase, ...]] = (
    SensitivityCase("as in Table 2", {}),
    SensitivityCase("case 1: gravity moment P_2 + 10 %", {"P_2": 1.1}),
    SensitivityCase("case 2: thrust P_6 + 10 %", {"P_6": 1.1}),
    SensitivityCase("pendulum P_3 neglected", {"P_3": 0.0}),
    SensitivityCase("friction P_4 neglected", {"P_4": 0.0}),
    SensitivityCase("dead zone P_1 neglected", {"P_1": 0.0}),
)
"""The paper's text mentions small changes in its cases 1 and 2, and neglected parameters."""


def response_deg(coefficients: Mapping[str, float], test: BenchTest, t_s: Floats) -> Floats:
    """Simulate the elevation of (30) after a step of both voltages, with pitch and travel locked. Shapes:
    `t_s` (n,); returns (n,).
    """
    # The arm starts on its table; there is no upper stop. The integration is a fourth-order Runge-Kutta
    # method.
    p, sum_V = coefficients, test.front_V + test.back_V
    table_rad = math.radians(TABLE_DEG)
    constant_rad_s2 = p["P_1"] + p["P_5"] + p["P_6"] * sum_V

    def derivative(state: Floats, _: float) -> Floats:
        """Return rate and acceleration of elevation from elevation [rad] and its rate [rad/s]."""
        elevation_rad, rate_rad_s = state
        acceleration_rad_s2 = (
            constant_rad_s2
            + p["P_2"] * math.cos(elevation_rad)
            + p["P_3"] * math.sin(elevation_rad)
            + p["P_4"] * rate_rad_s
        )
        return np.array([rate_rad_s, acceleration_rad_s2])

    state = np.array([table_rad, 0.0])
    row_s = float(t_s[1] - t_s[0])
    substeps = max(1, math.ceil(row_s / _STEP_s))
    elevations_rad = np.empty(t_s.size)
    for row in range(t_s.size):
        elevations_rad[row] = state[0]
        for _ in range(substeps):
            state = runge_kutta_step(derivative, state, row_s / substeps)
            if state[0] <= table_rad:
                # The table stops a falling arm, and does not hold one that rises.
                state = np.array([table_rad, max(state[1], 0.0)])
    return np.degrees(elevations_rad)
