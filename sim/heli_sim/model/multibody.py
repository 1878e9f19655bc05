"""The rig as point masses on three rigid links: the full Lagrangian, nothing left out.

Generalised coordinates q = (elevation, pitch, travel). With the positions p_i(q) of the masses,

    M(q) q'' + c(q, q') + g(q) = Q,    M = sum m_i J_i' J_i,    J_i = d p_i / d q,

so centrifugal and Coriolis forces (the paper's assumption 1 leaves them out), inertial coupling between the
axes (the short arm's mass hangs below the pitch axis), and gravity with every offset follow by themselves.
Each thrust acts along the short arm's own up axis at its rotor: Q is its virtual work.

Frames: at q = 0 the long arm points along +x, z is up, and the front rotor is at -y. Elevation turns about -y,
pitch about -x, travel about +z.
"""

from __future__ import annotations

import casadi as ca

from heli_sim.model.base import Model, Situation


def _about_x(angle: ca.SX) -> ca.SX:
    c, s = ca.cos(angle), ca.sin(angle)
    return ca.vertcat(ca.horzcat(1, 0, 0), ca.horzcat(0, c, -s), ca.horzcat(0, s, c))


def _about_y(angle: ca.SX) -> ca.SX:
    c, s = ca.cos(angle), ca.sin(angle)
    return ca.vertcat(ca.horzcat(c, 0, s), ca.horzcat(0, 1, 0), ca.horzcat(-s, 0, c))


def _about_z(angle: ca.SX) -> ca.SX:
    c, s = ca.cos(angle), ca.sin(angle)
    return ca.vertcat(ca.horzcat(c, -s, 0), ca.horzcat(s, c, 0), ca.horzcat(0, 0, 1))


class MultibodyModel(Model):
    """Full Lagrangian of the point masses of Table 2.

    Parameters
    ----------
    effects : tuple of Effect
        Effects on top of the model, applied in this order.
    """

    name = "multibody"
    rig_parameters = ("M_f", "M_b", "M_w", "M_h", "M_l", "L_a", "L_b", "L_h", "L_phi", "L_theta", "L_x", "g")

    def acceleration(self, at: Situation, thrust_N: ca.SX, torque_Nm: ca.SX) -> ca.SX:
        """Solve the equations of motion for the accelerations.

        Parameters
        ----------
        at : Situation
            Present state, voltages and parameters.
        thrust_N : casadi.SX
            Thrust of the front and the back rotor, shape (2, 1).
        torque_Nm : casadi.SX
            Friction and other torques about the three axes, shape (3, 1).

        Returns
        -------
        casadi.SX
            Acceleration of elevation, pitch and travel in rad/s2, shape (3, 1).
        """
        # The Jacobians are taken with symbols of their own: an effect may hand in angles that are expressions.
        q, rates = ca.SX.sym("q", 3), ca.SX.sym("rates", 3)
        arm = _about_z(q[2]) @ _about_y(-q[0])
        body = arm @ _about_x(-q[1])
        masses, rotors = self._points(at, arm, body)

        inertia, potential_J = ca.SX.zeros(3, 3), ca.SX(0)
        for mass_kg, position_m in masses:
            jacobian = ca.jacobian(position_m, q)
            inertia += mass_kg * jacobian.T @ jacobian
            potential_J += mass_kg * at.parameter["g"] * position_m[2]
        momentum = inertia @ rates
        coriolis = ca.jtimes(momentum, q, rates) - 0.5 * ca.gradient(ca.dot(rates, momentum), q)
        force = -coriolis - ca.gradient(potential_J, q)
        for index, position_m in enumerate(rotors):
            force += ca.jacobian(position_m, q).T @ body[:, 2] * thrust_N[index]

        state = at.state
        now = ca.vertcat(state["elevation_rad"], state["pitch_rad"], state["travel_rad"])
        now_rates = ca.vertcat(*(state[f"{axis}_rate_rad_s"] for axis in ("elevation", "pitch", "travel")))
        inertia, force = ca.substitute([inertia, force], [q, rates], [now, now_rates])
        return ca.solve(inertia, force + torque_Nm)

    def inertia_kg_m2(self, at: Situation) -> ca.SX:
        """Mass matrix M(q) at the present angles.

        Parameters
        ----------
        at : Situation
            Present state and parameters.

        Returns
        -------
        casadi.SX
            Symmetric, shape (3, 3), in the order elevation, pitch, travel.
        """
        q = ca.SX.sym("q", 3)
        arm = _about_z(q[2]) @ _about_y(-q[0])
        masses, _ = self._points(at, arm, arm @ _about_x(-q[1]))
        jacobians = [(mass_kg, ca.jacobian(position_m, q)) for mass_kg, position_m in masses]
        inertia = sum((mass_kg * j.T @ j for mass_kg, j in jacobians), ca.SX.zeros(3, 3))
        angles = ca.vertcat(*(at.state[f"{axis}_rad"] for axis in ("elevation", "pitch", "travel")))
        return ca.substitute(inertia, q, angles)

    def energy_J(self, at: Situation) -> ca.SX:
        """Kinetic plus potential energy, zero at level and at rest in the axes' height.

        Parameters
        ----------
        at : Situation
            Present state and parameters.

        Returns
        -------
        casadi.SX
            Energy in J.
        """
        state = at.state
        rates = ca.vertcat(*(state[f"{axis}_rate_rad_s"] for axis in ("elevation", "pitch", "travel")))
        arm = _about_z(state["travel_rad"]) @ _about_y(-state["elevation_rad"])
        masses, _ = self._points(at, arm, arm @ _about_x(-state["pitch_rad"]))
        height = sum((mass_kg * position_m[2] for mass_kg, position_m in masses), ca.SX(0))
        return 0.5 * rates.T @ self.inertia_kg_m2(at) @ rates + at.parameter["g"] * height

    def _points(
        self, at: Situation, arm: ca.SX, body: ca.SX
    ) -> tuple[list[tuple[ca.SX, ca.SX]], list[ca.SX]]:
        """Masses with their positions, and the points where the thrusts act (front, back)."""
        p = at.parameter
        pitch_axis = ca.vertcat(p["L_a"], 0, -p["L_theta"])

        def on_arm(x_m: ca.SX) -> ca.SX:
            return arm @ ca.vertcat(x_m, 0, -p["L_theta"])

        def on_body(y_m: ca.SX, z_m: ca.SX) -> ca.SX:
            return arm @ pitch_axis + body @ ca.vertcat(0, y_m, z_m)

        none = ca.SX(0)
        masses = [
            (p["M_l"], on_arm(p["L_x"])),
            (p["M_w"], on_arm(-p["L_b"])),
            (p["M_h"], on_body(none, -p["L_phi"])),
            (p["M_f"], on_body(-p["L_h"], -p["L_phi"])),
            (p["M_b"], on_body(p["L_h"], -p["L_phi"])),
        ]
        return masses, [on_body(-p["L_h"], none), on_body(p["L_h"], none)]
