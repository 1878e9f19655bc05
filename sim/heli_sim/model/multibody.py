"""The rig as point masses on three rigid links: the complete Lagrangian equations.

Generalised coordinates q = (elevation, pitch, travel). From the kinetic energy T = q'' M(q) q' / 2 and the
potential energy V(q),

    M(q) q'' + c(q, q') + dV/dq = Q,    c = d(M q')/dq q' - d(q'' M q' / 2)/dq,

follow the centrifugal and Coriolis forces (which the paper's assumption 1 omits), the inertial coupling of
the axes (the mass of the short arm hangs below the pitch axis), and gravity with every offset. Each thrust
acts at its rotor along the up axis of the short arm; Q is its virtual work.

Positions and velocities are written in a frame that turns with the long arm: x along it, z up at level, the
front rotor at -y. Elevation turns about -y, pitch about -x, travel about the vertical. Therefore M and V do
not depend on travel. They depend on the five masses only through sums over each link (`_short_arm`,
`_long_arm`), which do not change during a flight.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import casadi as ca
from typing_extensions import override

from heli_sim.model.base import Model, Operands
from heli_sim.model.effect import AXES


@dataclass(frozen=True)
class _ShortArm:
    """Sums over the masses that pitch turns, in the arm's frame relative to the pitch axis."""

    mass: ca.SX
    y: ca.SX  # sum of m y
    z: ca.SX
    yy: ca.SX  # sum of m y^2
    zz: ca.SX
    yz: ca.SX


@dataclass(frozen=True)
class _LongArm:
    """Sums over the masses that elevation turns; each mass is L_theta below the elevation axis."""

    mass: ca.SX
    x: ca.SX
    xx: ca.SX


class MultibodyModel(Model):
    """Full Lagrangian of the point masses in Table 2 of the paper, with optional `effects`."""

    name = "multibody"
    rig_parameters = ("M_f", "M_b", "M_w", "M_h", "M_l", "L_a", "L_b", "L_h", "L_phi", "L_theta", "L_x", "g")

    @override
    def acceleration(self, at: Operands, thrust_N: ca.SX, torque_Nm: ca.SX) -> ca.SX:
        p = at.parameter
        constants = ca.vertcat(*(p[name] for name in self.rig_parameters))
        result = _mechanics(type(self))(_angles(at), _rates(at), thrust_N, torque_Nm, at.locked, constants)
        assert isinstance(result, ca.SX)
        return result

    def inertia_kg_m2(self, at: Operands) -> ca.SX:
        """Return the mass matrix M(q), shape (3, 3), in the order elevation, pitch, travel."""
        return self._inertia_kg_m2(at, _angles(at))

    def energy_J(self, at: Operands) -> ca.SX:
        """Return the kinetic and potential energy, including that of effects.

        It is zero at rest with all masses at the height of the axes.
        """
        rates = _rates(at)
        potential_J = self._potential_J(at, _angles(at)) + sum(e.energy_J(at) for e in self.effects)
        return 0.5 * rates.T @ self.inertia_kg_m2(at) @ rates + potential_J

    def thrust_torque_Nm(self, at: Operands, thrust_N: ca.SX) -> ca.SX:
        """Return the torques of the rotors about elevation, pitch and travel, shape (3, 1).

        Parameters
        ----------
        thrust_N : casadi.SX
            Thrust of the front and the back rotor, shape (2, 1).
        """
        return self._thrust_Nm(at, _angles(at), thrust_N)

    def _inertia_kg_m2(self, at: Operands, q: ca.SX) -> ca.SX:
        """Derive M(q) from the velocity of a point of each link.

        A point at x of the long arm moves with (elevation' L_theta, travel' r, elevation' x), where
        r = x cos(elevation) + L_theta sin(elevation) is its distance from the travel axis. A point of the
        short arm whose place, after pitch, is (L_a, y, z - L_theta) moves with

            x: -elevation' (z - L_theta) - travel' y cos
            y:  travel' r + pitch' z,            r = L_a cos - (z - L_theta) sin
            z:  travel' y sin + elevation' L_a - pitch' y
        """
        p = at.parameter
        # Cosine and sine of the elevation.
        c, s = ca.cos(q[0]), ca.sin(q[0])
        long, short = self._long_arm(at), self._short_arm(at, q[1])
        L_a, L_theta = p["L_a"], p["L_theta"]
        below_zz = short.zz - L_theta * (2 * short.z - L_theta * short.mass)  # sum of m (z - L_theta)^2
        below_z = short.z - L_theta * short.mass
        below_yz = short.yz - L_theta * short.y

        elevation = long.xx + long.mass * L_theta**2 + below_zz + short.mass * L_a**2
        pitch = short.yy + short.zz
        r_long = long.xx * c**2 + 2 * long.x * L_theta * c * s + long.mass * L_theta**2 * s**2
        r_short = short.mass * L_a**2 * c**2 - 2 * L_a * below_z * c * s + below_zz * s**2
        travel = r_long + r_short + short.yy

        elevation_pitch = -L_a * short.y
        elevation_travel = below_yz * c + L_a * short.y * s
        pitch_travel = L_a * short.z * c - (short.zz - L_theta * short.z + short.yy) * s
        return ca.vertcat(
            ca.horzcat(elevation, elevation_pitch, elevation_travel),
            ca.horzcat(elevation_pitch, pitch, pitch_travel),
            ca.horzcat(elevation_travel, pitch_travel, travel),
        )

    def _potential_J(self, at: Operands, q: ca.SX) -> ca.SX:
        """Return the potential energy of gravity at the angles `q`, V(q)."""
        p = at.parameter
        long, short = self._long_arm(at), self._short_arm(at, q[1])
        moment_along_kg_m = long.x + short.mass * p["L_a"]
        moment_up_kg_m = short.z - p["L_theta"] * (long.mass + short.mass)
        return p["g"] * (moment_along_kg_m * ca.sin(q[0]) + moment_up_kg_m * ca.cos(q[0]))

    def _thrust_Nm(self, at: Operands, q: ca.SX, thrust_N: ca.SX) -> ca.SX:
        """Return the generalised forces Q of the thrusts at the angles `q`, from their virtual work."""
        # If the arm is raised, a difference of the thrusts also turns travel, with the lever L_h
        # sin(elevation).
        p = at.parameter
        c, s = ca.cos(q[0]), ca.sin(q[0])
        total_N, difference_N = thrust_N[0] + thrust_N[1], thrust_N[0] - thrust_N[1]
        up_N, sideways_N = total_N * ca.cos(q[1]), total_N * ca.sin(q[1])
        return ca.vertcat(
            p["L_a"] * up_N,
            p["L_h"] * difference_N,
            (p["L_a"] * c + p["L_theta"] * s) * sideways_N - p["L_h"] * difference_N * s,
        )

    def _short_arm(self, at: Operands, pitch: ca.SX) -> _ShortArm:
        """Return the sums of the short arm at a `pitch`: mass, first [kg m] and second moments [kg m2]."""
        p = at.parameter
        # Cosine and sine of the pitch, by which the masses are turned below.
        c, s = ca.cos(pitch), ca.sin(pitch)
        # At pitch 0, every mass is L_phi below the axis, and the rotors are L_h to either side.
        mass = p["M_f"] + p["M_b"] + p["M_h"]
        y, z = (p["M_b"] - p["M_f"]) * p["L_h"], -p["L_phi"] * mass
        yy, zz, yz = (p["M_f"] + p["M_b"]) * p["L_h"] ** 2, p["L_phi"] ** 2 * mass, -p["L_phi"] * y
        return _ShortArm(
            mass,
            y=y * c + z * s,
            z=z * c - y * s,
            yy=yy * c**2 + 2 * yz * c * s + zz * s**2,
            zz=yy * s**2 - 2 * yz * c * s + zz * c**2,
            yz=(zz - yy) * c * s + yz * (c**2 - s**2),
        )

    def _long_arm(self, at: Operands) -> _LongArm:
        """Return the sums of the long arm and the counterweight."""
        p = at.parameter
        return _LongArm(
            mass=p["M_l"] + p["M_w"],
            x=p["M_l"] * p["L_x"] - p["M_w"] * p["L_b"],
            xx=p["M_l"] * p["L_x"] ** 2 + p["M_w"] * p["L_b"] ** 2,
        )


@cache
def _mechanics(kind: type[MultibodyModel]) -> ca.Function:
    """Return the accelerations as a function of angles, rates, thrusts, torques, locks and
    `rig_parameters`.
    """
    # Differentiation takes most of the time, so the function of a class is built once; no effect changes it.
    model = kind()
    q, rates, thrust_N = ca.SX.sym("q", 3), ca.SX.sym("rates", 3), ca.SX.sym("thrust", 2)
    torque_Nm, locked = ca.SX.sym("torque", 3), ca.SX.sym("locked", 3)
    constants = ca.SX.sym("known", len(model.rig_parameters))
    parameters = {name: constants[i] for i, name in enumerate(model.rig_parameters)}
    # The inertia, the forces and the energy need neither states nor voltages; they get the angles apart.
    at = Operands({}, ca.SX.zeros(2), parameters, ca.SX(0), locked)
    # Lagrange: M q'' = Q - (M' q' - 1/2 d(q' M q')/dq) - dU/dq.
    inertia = model._inertia_kg_m2(at, q)
    momentum = inertia @ rates
    coriolis = ca.jtimes(momentum, q, rates) - 0.5 * ca.gradient(ca.dot(rates, momentum), q)
    force = model._thrust_Nm(at, q, thrust_N) - coriolis - ca.gradient(model._potential_J(at, q), q)
    acceleration = _solve_ldl(*_with_locks(inertia, force + torque_Nm, locked))
    return ca.Function("mechanics", [q, rates, thrust_N, torque_Nm, locked, constants], [acceleration])


def _angles(at: Operands) -> ca.SX:
    return ca.vertcat(*(at.state[f"{axis}_rad"] for axis in AXES))


def _rates(at: Operands) -> ca.SX:
    return ca.vertcat(*(at.state[f"{axis}_rate_rad_s"] for axis in AXES))


def _with_locks(matrix: ca.SX, right_side: ca.SX, locked: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Replace the equation of each locked axis by "acceleration = 0"; return matrix and right-hand side."""
    free = 1 - locked
    return free @ free.T * matrix + ca.diag(locked), free * right_side


def _solve_ldl(matrix: ca.SX, right_side: ca.SX) -> ca.SX:
    """Solve for a symmetric positive definite 3 x 3 matrix by L D L': a third of a general solver's work."""
    # Pitch is eliminated first, because its inertia, and so its reciprocal, is constant in flight.
    first, middle, last = 1, 0, 2
    inverse_first = 1 / matrix[first, first]
    factor_middle, factor_last = matrix[middle, first] * inverse_first, matrix[last, first] * inverse_first
    inverse_middle = 1 / (matrix[middle, middle] - factor_middle * matrix[middle, first])
    cross_term = matrix[last, middle] - factor_last * matrix[middle, first]
    factor_cross = cross_term * inverse_middle
    d_last = matrix[last, last] - factor_last * matrix[last, first] - factor_cross * cross_term

    middle_right = right_side[middle] - factor_middle * right_side[first]
    x_last = (right_side[last] - factor_last * right_side[first] - factor_cross * middle_right) / d_last
    x_middle = middle_right * inverse_middle - factor_cross * x_last
    x_first = right_side[first] * inverse_first - factor_middle * x_middle - factor_last * x_last
    return ca.vertcat(x_middle, x_first, x_last)
