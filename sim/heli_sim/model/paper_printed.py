"""The equations of motion of Makki et al. exactly as printed, (14), (19) and (25), with their misprints.

They are for comparison with `paper`, where they are corrected, and with `multibody`. The list gives every
slip. If an equation cannot be evaluated as printed, the list also gives the reading that is used here:

- Table 2 names two lengths L_h; the 0.45 m one is read as L_b, as its description says.
- Equation (1) is F = k V, (31) is F = k (V - 1). Equation (31) is used, as in P_1 and P_15. As there, it also
  holds below 1 V, where the rotors then pull.
- Equations (8) and (11) repeat the form (phi - delta) of (6); (10) has (phi + delta). With phi signed, as in
  (13) and (18), the form (phi - delta) holds in every scenario. No equation of motion is affected.
- Equation (19) has cos(phi + L_h) for cos(phi + zeta_h), which adds metres to an angle. The sum is taken in
  radians.
- Equation (20) and P_8 are right and contradict (19), from which they follow. Equation (19) is used.
- Equation (21) subtracts the rotors' travel torques from each other; (24) and (25) add them. Equation (25) is
  used.
- Equation (22) is a force, N, in a sum of torques, N m. Its number is used unchanged.
- Equations (22) to (25) have drag ~ psi_dot^2, which accelerates negative travel. Its term A_2 sin(phi)
  accelerates travel at negative pitch.
- Equations (23) to (25) and P_18 have a travel torque. It is (F_f - F_b) L_h sin(phi).
- Equations (27) and (29) change with pitch and elevation, but J_psi_dot psi_dot is left out. Equation (29) is
  named J_theta.
- Table 2's J_theta = 0.8496 kg m2 is no value of (27), whose values are from 0.7675 to 0.8219. Equation (27)
  is used.
- P_5, P_10 and P_14 are the rig's torque_elevation, torque_pitch and torque_travel.
"""

from __future__ import annotations

import casadi as ca
from typing_extensions import override

from heli_sim.model.base import Model, Operands
from heli_sim.model.paper import PaperModel


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
            + p["M_b"] * p["g"] * p["L_h"] / ca.cos(zeta_h) * ca.cos(pitch + p["L_h"])
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
