"""The rig as point masses on three rigid links: the complete Lagrangian equations.

Generalised coordinates q = (elevation, pitch, travel). From the kinetic energy T = q'' M(q) q' / 2 and the
potential energy V(q),

    M(q) q'' + c(q, q') + dV/dq = Q,    c = d(M q')/dq q' - d(q'' M q' / 2)/dq,

so centrifugal and Coriolis forces (the paper's assumption 1 leaves them out), inertial coupling between the
axes (the short arm's mass hangs below the pitch axis), and gravity with every offset follow by themselves.
Each thrust acts along the short arm's own up axis at its rotor: Q is its virtual work.

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
from heli_sim.model.parts import AXES


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
    """Sums over the masses that elevation turns; all of them lie L_theta below the elevation axis."""

    mass: ca.SX
    x: ca.SX
    xx: ca.SX


class MultibodyModel(Model):
    """Full Lagrangian of the point masses of Table 2, and on top of it `effects`, applied in this order."""

    name = "multibody"
    rig_parameters = ("M_f", "M_b", "M_w", "M_h", "M_l", "L_a", "L_b", "L_h", "L_phi", "L_theta", "L_x", "g")

    @override
    def acceleration(self, at: Operands, thrust_N: ca.SX, torque_Nm: ca.SX) -> ca.SX:
        p = at.parameter
        known = ca.vertcat(*(p[name] for name in self.rig_parameters))
        result = _mechanics(type(self))(_angles(at), _rates(at), thrust_N, torque_Nm, at.locked, known)
        assert isinstance(result, ca.SX)
        return result

    def inertia_kg_m2(self, at: Operands) -> ca.SX:
        """Mass matrix M(q) at the present angles: symmetric, shape (3, 3), in the order elevation, pitch,
        travel.
        """
        return self._inertia_kg_m2(at, _angles(at))

    def energy_J(self, at: Operands) -> ca.SX:
        """Kinetic and potential energy, with that of effects; zero at rest with all masses at the height of
        the axes.
        """
        rates = _rates(at)
        potential_J = self._potential_J(at, _angles(at)) + sum(e.energy_J(at) for e in self.effects)
        return 0.5 * rates.T @ self.inertia_kg_m2(at) @ rates + potential_J

    def thrust_torque_Nm(self, at: Operands, thrust_N: ca.SX) -> ca.SX:
        """Generalised forces of the rotors' `thrust_N`, front and back, shape (2, 1), at the present angles,
        about elevation, pitch and travel, shape (3, 1).
        """
        return self._thrust_Nm(at, _angles(at), thrust_N)

    def _inertia_kg_m2(self, at: Operands, q: ca.SX) -> ca.SX:
        """M(q) from the velocity of a point of each link.

        A point at x of the long arm moves with (elevation' L_theta, travel' r, elevation' x), its distance
        from the vertical being r = x cos + L_theta sin of the elevation. A point of the short arm that pitch
        has brought to (L_a, y, z - L_theta) moves with

            x: -elevation' (z - L_theta) - travel' y cos
            y:  travel' r + pitch' z,            r = L_a cos - (z - L_theta) sin
            z:  travel' y sin + elevation' L_a - pitch' y
        """
        p = at.parameter
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
        p = at.parameter
        long, short = self._long_arm(at), self._short_arm(at, q[1])
        along = long.x + short.mass * p["L_a"]
        above = short.z - p["L_theta"] * (long.mass + short.mass)
        return p["g"] * (along * ca.sin(q[0]) + above * ca.cos(q[0]))

    def _thrust_Nm(self, at: Operands, q: ca.SX, thrust_N: ca.SX) -> ca.SX:
        """Virtual work: at elevation, a difference of the thrusts also turns travel, with arm L_h sin."""
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
        """Return mass, first moments [kg m] and second moments [kg m2] of the pitched short arm about the end
        of the long arm.
        """
        p = at.parameter
        c, s = ca.cos(pitch), ca.sin(pitch)
        # Before it is pitched, every mass lies L_phi below the axis, the rotors L_h beside it.
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
        p = at.parameter
        return _LongArm(
            mass=p["M_l"] + p["M_w"],
            x=p["M_l"] * p["L_x"] - p["M_w"] * p["L_b"],
            xx=p["M_l"] * p["L_x"] ** 2 + p["M_w"] * p["L_b"] ** 2,
        )


@cache
def _mechanics(kind: type[MultibodyModel]) -> ca.Function:
    """Accelerations from angles, rates, thrusts, torques, locks and `rig_parameters`. They are derived once,
    because differentiation takes most of the time, and no effect changes them.
    """
    model = kind()
    q, rates, thrust_N = ca.SX.sym("q", 3), ca.SX.sym("rates", 3), ca.SX.sym("thrust", 2)
    torque_Nm, locked = ca.SX.sym("torque", 3), ca.SX.sym("locked", 3)
    known = ca.SX.sym("known", len(model.rig_parameters))
    parameters = {name: known[i] for i, name in enumerate(model.rig_parameters)}
    at = Operands({}, ca.SX.zeros(2), parameters, ca.SX(0), locked)
    inertia = model._inertia_kg_m2(at, q)
    momentum = inertia @ rates
    coriolis = ca.jtimes(momentum, q, rates) - 0.5 * ca.gradient(ca.dot(rates, momentum), q)
    force = model._thrust_Nm(at, q, thrust_N) - coriolis - ca.gradient(model._potential_J(at, q), q)
    acceleration = _solve(*_with_locks(inertia, force + torque_Nm, locked))
    return ca.Function("mechanics", [q, rates, thrust_N, torque_Nm, locked, known], [acceleration])


def _angles(at: Operands) -> ca.SX:
    return ca.vertcat(*(at.state[f"{axis}_rad"] for axis in AXES))


def _rates(at: Operands) -> ca.SX:
    return ca.vertcat(*(at.state[f"{axis}_rate_rad_s"] for axis in AXES))


def _with_locks(matrix: ca.SX, right: ca.SX, locked: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Keep the block of the free axes in the equations; for a locked axis, set 1 times its acceleration
    = 0.
    """
    free = 1 - locked
    return free @ free.T * matrix + ca.diag(locked), free * right


def _solve(matrix: ca.SX, right: ca.SX) -> ca.SX:
    """Solve for a symmetric positive definite 3 x 3 matrix by L D L': a third of a general solver's work."""
    first, middle, last = 1, 0, 2  # pitch's own inertia is constant, and so is its reciprocal
    over_first = 1 / matrix[first, first]
    low_middle, low_last = matrix[middle, first] * over_first, matrix[last, first] * over_first
    over_middle = 1 / (matrix[middle, middle] - low_middle * matrix[middle, first])
    rest = matrix[last, middle] - low_last * matrix[middle, first]
    low = rest * over_middle
    d_last = matrix[last, last] - low_last * matrix[last, first] - low * rest

    middle_right = right[middle] - low_middle * right[first]
    x_last = (right[last] - low_last * right[first] - low * middle_right) / d_last
    x_middle = middle_right * over_middle - low * x_last
    x_first = right[first] * over_first - low_middle * x_middle - low_last * x_last
    return ca.vertcat(x_middle, x_first, x_last)
