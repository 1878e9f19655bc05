"""Coefficients P_1 to P_18 of equations (30): values printed in the paper, and values from a rig's masses.

The code uses rad, s, and V of the sum U+ = V_f + V_b and the difference U- = V_f - V_b. Tables 3 to 5 print
no units and use different ones; `PRINTED` states the unit of each coefficient.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from heli_sim.rig import Rig

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
    """Compute P_1 to P_18 from a rig's parameters, by the formulas that the paper prints below (30).

    The results are in rad, s and V of U+ and U-.
    """
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
