"""Equations (30) of Makki et al. with the physical coefficients printed below them, misprints corrected.

Corrections, each against what is printed:

- Table 2 names two lengths L_h; the 0.45 m one is L_b.
- Inertias are (27) to (29) at level (theta = phi = 0), as (30) treats them as constants. Table 2's
  J_theta = 0.8496 kg m2 is not used: (27) gives 0.7675. Equation (29) is J_psi, though it is printed as
  J_theta.
- Equation (19) has cos(phi + L_h) for cos(phi + zeta_h). Equation (20) and P_8 are right.
- P_1 and P_15 (the constant -2k) stand for the 1 V dead zone of (31), and would push downwards at 0 V. Here
  the dead zone is in the thrust itself: no thrust below it.
- The drag of (22) is a force; its torque about the vertical has the arm L_a, which P_13 and P_16 lack. It
  opposes motion (psi_dot |psi_dot|), also at negative pitch (|sin phi|).
- P_18 is left out. It makes (F_f - F_b) L_h sin phi a torque about the vertical. The horizontal thrust
  component F sin phi acts along the tangent at the arm's end. Its moment has the arm L_a for both rotors.
- D_theta, D_phi and D_psi (P_5, P_10, P_14), the unknown constants, are zero.
"""

from __future__ import annotations

import casadi as ca
from typing_extensions import override

from heli_sim.model.base import Model, Operands


class PaperModel(Model):
    """The paper's model: three uncoupled inertias, gravity, thrust, viscous friction, drag on travel; on top
    of it `effects`, applied in this order.
    """

    name = "paper"
    rig_parameters = (
        *("M_f", "M_b", "M_w", "M_h", "M_l", "L_a", "L_b", "L_h", "L_phi", "L_theta", "L_x", "g"),
        *("air_density", "drag_area_arm", "drag_area_body"),
    )

    def inertia_kg_m2(self, at: Operands) -> ca.SX:
        """J_theta (27), J_phi (28) and J_psi (29) at level, about the elevation, pitch and travel axes, shape
        (3, 1).
        """
        p = at.parameter
        rotors = p["M_f"] + p["M_b"]
        L_theta2 = p["L_theta"] ** 2
        short_arm2 = p["L_h"] ** 2 + p["L_phi"] ** 2
        elevation = (
            rotors * p["L_a"] ** 2
            + p["M_l"] * (p["L_x"] ** 2 + L_theta2)
            + p["M_w"] * (p["L_b"] ** 2 + L_theta2)
            + p["M_h"] * (p["L_a"] ** 2 + L_theta2)
        )
        pitch = rotors * short_arm2 + p["M_h"] * p["L_phi"] ** 2
        travel = (
            rotors * (short_arm2 + p["L_a"] ** 2)
            + p["M_l"] * p["L_x"] ** 2
            + p["M_w"] * p["L_b"] ** 2
            + p["M_h"] * p["L_a"] ** 2
        )
        return ca.vertcat(elevation, pitch, travel)

    @override
    def acceleration(self, at: Operands, thrust_N: ca.SX, torque_Nm: ca.SX) -> ca.SX:
        # Right-hand sides of (16), (20) and (25), divided by the inertias.
        p, state = at.parameter, at.state
        elevation, pitch = state["elevation_rad"], state["pitch_rad"]
        total_N = thrust_N[0] + thrust_N[1]
        difference_N = thrust_N[0] - thrust_N[1]

        body_N = (p["M_f"] + p["M_b"] + p["M_h"]) * p["g"]
        weight_N, arm_N = p["M_w"] * p["g"], p["M_l"] * p["g"]
        # tan(zeta) = L_theta / L: each product L tan(zeta) of (16) is L_theta.
        elevation_Nm = (
            total_N * ca.cos(pitch) * p["L_a"]
            + (weight_N * p["L_b"] - body_N * p["L_a"] - arm_N * p["L_x"]) * ca.cos(elevation)
            - (body_N + weight_N + arm_N) * p["L_theta"] * ca.sin(elevation)
        )
        # Likewise L_h tan(zeta_h) of (20) is L_phi.
        pitch_Nm = (
            difference_N * p["L_h"]
            + (p["M_b"] - p["M_f"]) * p["g"] * p["L_h"] * ca.cos(pitch)
            - body_N * p["L_phi"] * ca.sin(pitch)
        )
        travel_Nm = total_N * ca.sin(pitch) * p["L_a"] - self._drag_Nm(at)
        return (ca.vertcat(elevation_Nm, pitch_Nm, travel_Nm) + torque_Nm) / self.inertia_kg_m2(at)

    def _drag_Nm(self, at: Operands) -> ca.SX:
        """Return the torque of the air on the arm about travel: quadratic drag at the speed of the rotors,
        L_a times the rate, with the lever L_a again.
        """
        # A pitched body has a larger area in the direction of travel.
        p = at.parameter
        rate = at.state["travel_rate_rad_s"]
        area = p["drag_area_arm"] + p["drag_area_body"] * ca.fabs(ca.sin(at.state["pitch_rad"]))
        return 0.5 * p["air_density"] * area * p["L_a"] ** 3 * rate * ca.fabs(rate)


class PaperPrintedModel(Model):
    """The paper's equations as printed, and on top of them `effects`, applied in this order."""

    name = "paper_printed"
    rig_parameters = PaperModel.rig_parameters

    def inertia_kg_m2(self, at: Operands) -> ca.SX:
        """J_theta (27), J_phi (28) and J_psi (29) at the present angles, about the elevation, pitch and
        travel axes, shape (3, 1).
        """
        p = at.parameter
        elevation, pitch = at.state["elevation_rad"], at.state["pitch_rad"]
        rotors, L_theta2 = p["M_f"] + p["M_b"], p["L_theta"] ** 2
        short_arm2 = p["L_h"] ** 2 + p["L_phi"] ** 2
        about_elevation = (
            rotors * (short_arm2 * ca.sin(pitch) ** 2 + p["L_a"] ** 2)
            + p["M_l"] * (p["L_x"] ** 2 + L_theta2)
            + p["M_w"] * (p["L_b"] ** 2 + L_theta2)
            + p["M_h"] * (p["L_a"] ** 2 + L_theta2)
        )
        about_pitch = rotors * short_arm2 + p["M_h"] * p["L_phi"] ** 2
        level2 = ca.cos(elevation) ** 2
        about_travel = (
            rotors * (short_arm2 * ca.cos(pitch) ** 2 + p["L_a"] ** 2 * level2)
            + (p["M_l"] * p["L_x"] ** 2 + p["M_w"] * p["L_b"] ** 2 + p["M_h"] * p["L_a"] ** 2) * level2
        )
        return ca.vertcat(about_elevation, about_pitch, about_travel)

    @override
    def acceleration(self, at: Operands, thrust_N: ca.SX, torque_Nm: ca.SX) -> ca.SX:
        # Right-hand sides of (14), (19) and (25), divided by the inertias. The paper does not cut the thrust
        # off below the dead zone: it is put back.
        p, state = at.parameter, at.state
        elevation, pitch = state["elevation_rad"], state["pitch_rad"]
        rate = state["travel_rate_rad_s"]
        straight_N = thrust_N + p["thrust_gain"] * ca.fmin(at.volts_V - p["dead_zone"], 0.0)
        total_N, difference_N = straight_N[0] + straight_N[1], straight_N[0] - straight_N[1]

        zeta_a, zeta_w = ca.atan(p["L_theta"] / p["L_a"]), ca.atan(p["L_theta"] / p["L_b"])
        zeta_x, zeta_h = ca.atan(p["L_theta"] / p["L_x"]), ca.atan(p["L_phi"] / p["L_h"])
        body_N = (p["M_f"] + p["M_b"] + p["M_h"]) * p["g"]
        elevation_Nm = (
            total_N * ca.cos(pitch) * p["L_a"]
            - body_N * p["L_a"] / ca.cos(zeta_a) * ca.cos(elevation - zeta_a)
            + p["M_w"] * p["g"] * p["L_b"] / ca.cos(zeta_w) * ca.cos(elevation + zeta_w)
            - p["M_l"] * p["g"] * p["L_x"] / ca.cos(zeta_x) * ca.cos(elevation - zeta_x)
        )
        pitch_Nm = (
            difference_N * p["L_h"]
            + p["M_b"] * p["g"] * p["L_h"] / ca.cos(zeta_h) * ca.cos(pitch + p["L_h"])  # L_h as printed
            - p["M_f"] * p["g"] * p["L_h"] / ca.cos(zeta_h) * ca.cos(pitch - zeta_h)
            - p["M_h"] * p["g"] * p["L_phi"] * ca.sin(pitch)
        )
        drag = 0.5 * p["air_density"] * (rate * p["L_a"]) ** 2
        travel_Nm = (
            total_N * ca.sin(pitch) * p["L_a"]
            + difference_N * p["L_h"] * ca.sin(pitch)
            - drag * p["drag_area_arm"]
            - drag * p["drag_area_body"] * ca.sin(pitch)
        )
        return (ca.vertcat(elevation_Nm, pitch_Nm, travel_Nm) + torque_Nm) / self.inertia_kg_m2(at)
