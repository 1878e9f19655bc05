"""How plain each cause is in its weather, in standard deviations of what chance and other numbers can do.

An effect acts along the true course as torques and as errors of the encoders (`replay.py`). A change that
small obeys the rig's equations linearised about the course. A Kalman filter that knows the weather (strength,
memory, drift) and the encoders' counts turns the effect, and what each other number of the rig could do, into
innovations of unit variance. What remains of the effect's innovations, when the other numbers have imitated
what they can within what is known of them, and the other causes all that they can, is a number of standard
deviations: the square root of twice the logarithm of the likelihood ratio that a test finds which knows all
but the sizes, from the flight to learn from alone. The encoders' errors are taken for white; where an axis
creeps over its counts they last longer.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from heli_host.arrays import Floats
from heli_sim.rig import Rig
from heli_sim.rig.encoders import count_rad

from tests.blind.cases import TRAIN_S
from tests.blind.course import ReferenceTrajectory
from tests.blind.disturbances import DisturbanceModel
from tests.blind.disturbed_case import DisturbedCase
from tests.blind.replay import FINE, GRID_S, Forces, Rebuilt, inertia_kg_m2, pushes, steps

_SMALL = 1e-4
_START_RAD, _START_RAD_S = 0.02, 0.2
_OTHER_CAUSE = 10.0
"""Another cause may have any size: this many times its own, in standard deviations."""
_MECHANICAL = ("M_f", "M_b", "M_w", "M_h", "M_l", "L_a", "L_b", "L_h", "L_phi", "L_theta", "L_x")
_FRICTIONS = ("friction_elevation", "friction_pitch", "friction_travel")


@dataclass(frozen=True)
class Pushes:
    """What something does along a course.

    Parameters
    ----------
    torque_Nm : ndarray (n, 3)
        Torques about the axes, by which the motion changes.
    seen_rad : ndarray (n, 3)
        Errors of the angles seen.
    """

    torque_Nm: Floats
    seen_rad: Floats


def visibility(case: DisturbedCase, duration_s: float = TRAIN_S) -> dict[str, float]:
    """Standard deviations by which each cause stands out of the weather of the flight to learn from.

    Parameters
    ----------
    case : DisturbedCase
        The case.
    duration_s : float
        How long that flight is.

    Returns
    -------
    dict of float
        By name, listed effects first; a law that is on no list begins with ``off-``.
    """
    names = [*(name for name, _ in case.effects), *(f"off-{name}" for name, _ in case.unlisted)]
    if not names:
        return {}
    course = case.flown(0, duration_s)[1]
    rig = case.rig()
    line = Line(course, rig, case.disturbances)
    acting = Rebuilt(rig, case.hidden(0))
    forces = acting.forces(course)
    acceleration = acting.accelerations(course, forces)
    causes = []
    for i in range(len(names)):
        every = case.hidden(0)
        rest = Rebuilt(rig, [*every[:i], *every[i + 1 :]])
        left = rest.forces(course) if pushes(every[i]) else forces
        lost = acceleration - rest.accelerations(course, left)
        causes.append(Pushes(line.torque(lost, FINE), forces.seen_rad - left.seen_rad))
    others = imitators(rig, course, forces, line)
    white = line.innovations([*causes, *others])
    return {name: line.remaining(white, i, len(causes)) for i, name in enumerate(names)}


def imitators(rig: Rig, course: ReferenceTrajectory, forces: Forces, line: Line) -> list[Pushes]:
    """What each number of the rig does along a course when it is one standard deviation of its prior off.

    Parameters
    ----------
    rig : Rig
        The true rig; a tolerance is two standard deviations.
    course : ReferenceTrajectory
        Where it flew.
    forces : Forces
        What acted.
    line : Line
        The rig linearised about the course.
    """
    nothing = np.zeros((steps(course), 3))
    base = Rebuilt(rig, ()).accelerations(course, forces, FINE)
    found = []

    def off(name: str) -> float:
        return 0.5 * rig[name].tolerance

    for name in (*_MECHANICAL, *_FRICTIONS):
        if off(name):
            other = Rebuilt(rig.replace(**{name: rig[name].value + off(name)}), ())
            change = other.accelerations(course, forces, FINE) - base
            found.append(Pushes(line.torque(change, 1), nothing))
    gain = rig["thrust_gain"].value
    on = np.abs(forces.thrust_N) > 0.0
    for thrust in (
        forces.thrust_N * off("thrust_gain") / gain,
        -gain * off("dead_zone") * np.sign(forces.thrust_N) * on,
    ):
        pushed = Forces(forces.thrust_N + thrust, forces.torque_Nm, forces.seen_rad)
        change = Rebuilt(rig, ()).accelerations(course, pushed, FINE) - base
        found.append(Pushes(line.torque(change, 1), nothing))
    for i, axis in enumerate(("elevation", "pitch", "travel")):
        steady = np.zeros((steps(course), 3))
        steady[:, i] = 1.0
        found.append(Pushes(steady * off(f"torque_{axis}"), nothing))
        if i < 2:
            found.append(Pushes(nothing, steady * math.radians(off(f"offset_{axis}"))))
    return found


class Line:
    """A rig linearised about a course, in its weather: the Kalman filter that whitens."""

    def __init__(self, course: ReferenceTrajectory, rig: Rig, disturbances: DisturbanceModel) -> None:
        halves = len(course.time_s) // steps(course)
        middle = slice(halves // 2, steps(course) * halves, halves)
        self._inertia = inertia_kg_m2(rig, course.angles_rad[middle])
        self._push = np.linalg.inv(self._inertia)
        forces = Rebuilt(rig, ()).forces(course)
        self._by_state = _jacobians(rig, course, forces)
        self._weather = disturbances
        self._noise = np.diag(count_rad(rig) ** 2 / 12.0)

    def torque(self, acceleration: Floats, parts: int) -> Floats:
        """Torques that make accelerations given in so many `parts` of a step, each step's mean, (n, 3)."""
        mean = acceleration.reshape(-1, parts, 3).mean(axis=1)
        return np.asarray(np.einsum("nij,nj->ni", self._inertia, mean))

    def innovations(self, pushes: Sequence[Pushes]) -> Floats:
        """Innovations of unit variance that each of `pushes` leaves, (3 n, number of them).

        The filter's error obeys a stable equation of its own; no course of the unstable rig is needed.
        """
        torques = np.stack([one.torque_Nm for one in pushes], axis=2)
        seen = np.stack([one.seen_rad for one in pushes], axis=2)
        h, see = GRID_S, np.eye(3, 12)
        gusts = np.array(self._weather.gusts_Nm), math.exp(-h / self._weather.correlation_time_s)
        drift = np.array(self._weather.slow_std_Nm), math.exp(-h / self._weather.drift_s)
        kicks = np.zeros((12, 12))
        for start, (size, keep) in ((6, gusts), (9, drift)):
            kicks[start : start + 3, start : start + 3] = np.diag(size**2 * (1.0 - keep**2))
        covariance = np.diag([_START_RAD**2] * 3 + [_START_RAD_S**2] * 3 + [*gusts[0] ** 2, *drift[0] ** 2])
        error = np.zeros((12, len(pushes)))
        white = np.empty((len(torques), 3, len(pushes)))
        for k in range(len(torques)):
            spread = see @ covariance @ see.T + self._noise
            surprise = see @ error + seen[k]
            white[k] = np.linalg.solve(np.linalg.cholesky(spread), surprise)
            gain = np.linalg.solve(spread, see @ covariance).T
            error = error - gain @ surprise
            covariance = covariance - gain @ see @ covariance
            step, pushed = self._step(k, gusts[1], drift[1])
            error = step @ error + pushed @ torques[k]
            covariance = step @ covariance @ step.T + kicks
            covariance = 0.5 * (covariance + covariance.T)
        return white.reshape(-1, len(pushes))

    def remaining(self, white: Floats, which: int, causes: int) -> float:
        """Length of one column of innovations beyond what all others imitate at the price of their priors.

        Parameters
        ----------
        white : ndarray (rows, columns)
            Of causes, then of numbers that are one standard deviation off.
        which : int
            The cause asked about.
        causes : int
            How many columns are causes.
        """
        column = white[:, which]
        others = np.delete(white, which, axis=1)
        others[:, : causes - 1] *= _OTHER_CAUSE
        bent = others.T @ others + np.eye(others.shape[1])
        toward = others.T @ column
        left = column @ column - toward @ np.linalg.solve(bent, toward)
        return math.sqrt(max(float(left), 0.0))

    def _step(self, k: int, gust_keeps: float, drift_keeps: float) -> tuple[Floats, Floats]:
        """Transition of a step, (12, 12), and what a torque within it does, (12, 3)."""
        h = GRID_S
        a = np.zeros((6, 6))
        a[:3, 3:] = np.eye(3)
        a[3:] = self._by_state[k]
        b = np.vstack([np.zeros((3, 3)), self._push[k]])
        # exp(a h) to the third order: the rig's own times are tenths of a second.
        moved = np.eye(6) + h * a + h**2 / 2.0 * a @ a + h**3 / 6.0 * a @ a @ a
        pushed = (h * np.eye(6) + h**2 / 2.0 * a + h**3 / 6.0 * a @ a) @ b
        step = np.zeros((12, 12))
        step[:6, :6], step[:6, 6:9], step[:6, 9:] = moved, pushed, pushed
        step[6:9, 6:9], step[9:, 9:] = gust_keeps * np.eye(3), drift_keeps * np.eye(3)
        return step, np.vstack([pushed, np.zeros((6, 3))])


def _jacobians(rig: Rig, course: ReferenceTrajectory, forces: Forces) -> Floats:
    """Derivatives of the accelerations to angles and rates at each step, (n, 3, 6)."""
    plain = Rebuilt(rig, ())
    base = plain.accelerations(course, forces, FINE)
    found = np.empty((steps(course), 3, 6))
    for i in range(6):
        moved = course.moved(i, _SMALL)
        found[:, :, i] = (plain.accelerations(moved, forces, FINE) - base) / _SMALL
    return found
