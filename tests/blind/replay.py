"""What each cause does along the course that was flown: torques about the axes and errors of the encoders.

The true course is that of a flight with somebody who looked on. Every cause is taken away in turn, the rig is
put where it was at each moment, and the difference in acceleration, times the inertia, is the torque of the
cause. Nothing here knows what a cause is: what MuJoCo does without it is all that counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from heli_host.arrays import Floats
from heli_sim.rig import Rig

from tests.blind.course import ReferenceTrajectory
from tests.blind.mujoco_rig import STEP_S, Hidden, MujocoPlant

GRID_S = 0.02
"""Step of the oracle. Gusts last 0.3 s and more and rotors lag by a tenth: nothing that counts is faster."""
_HALVES = round(GRID_S / STEP_S)
FINE = 4
"""Parts of a step in which MuJoCo is asked: dry friction turns over within one."""


def steps(course: ReferenceTrajectory) -> int:
    """Whole steps of the grid in a `course`."""
    return len(course.time_s) // _HALVES


@dataclass(frozen=True)
class Forces:
    """What acts in a step of the grid's parts, and what the encoders see.

    Parameters
    ----------
    thrust_N : ndarray (parts, 2)
        Thrusts, each part's mean.
    torque_Nm : ndarray (parts, 3)
        Torques besides those of MuJoCo itself, likewise.
    seen_rad : ndarray (steps, 3)
        Angles that the encoders show, before they count.
    """

    thrust_N: Floats
    torque_Nm: Floats
    seen_rad: Floats


@dataclass
class Rebuilt:
    """A rig with some of what is hidden, that is put onto a course instead of flying it.

    Parameters
    ----------
    rig : Rig
        Its numbers.
    hidden : sequence of Hidden
        What is hidden in it, made afresh: some of it remembers.
    """

    rig: Rig
    hidden: Sequence[Hidden]
    _plant: MujocoPlant = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self._plant = MujocoPlant(self.rig, self.hidden)

    def forces(self, course: ReferenceTrajectory) -> Forces:
        """Thrusts and torques along a `course`."""
        plant, parts = self._plant, steps(course) * FINE
        halves = _HALVES // FINE
        thrust, torque = np.zeros((parts, 2)), np.zeros((parts, 3))
        seen = np.empty((steps(course), 3))
        # Where the arm stands at power-up is believed to be level.
        start = np.zeros(6)
        for one in self.hidden:
            one.rest(start)
        for k in range(steps(course) * _HALVES):
            at = course.moment(k)
            plant.act(at)
            thrust[k // halves] += at.thrust_N
            torque[k // halves] += at.torque_Nm
            if k % 2 == 0:
                shown = plant.seen(at.angles_rad)
                if k % _HALVES == 0:
                    seen[k // _HALVES] = shown - start[:3]
        return Forces(thrust / halves, torque / halves, seen)

    def accelerations(self, course: ReferenceTrajectory, forces: Forces, every: int = 1) -> Floats:
        """Accelerations where the course is, under given forces, rad/s2, (parts / every, 3).

        Parameters
        ----------
        course : ReferenceTrajectory
            Where the rig is put.
        forces : Forces
            What acts on it.
        every : int
            Ask at each so manieth part only.
        """
        plant, halves = self._plant, _HALVES // FINE
        found = np.empty((len(forces.thrust_N) // every, 3))
        for i in range(len(found)):
            part = i * every
            k = part * halves + halves * every // 2
            for one in plant.hidden:
                one.during(course.moment(k), plant.physics)
            found[i] = plant.acceleration(
                course.angles_rad[k], course.rates_rad_s[k], forces.thrust_N[part], forces.torque_Nm[part]
            )
        return found


def inertia_kg_m2(rig: Rig, angles_rad: Floats) -> Floats:
    """Inertia matrices at given angles.

    Parameters
    ----------
    rig : Rig
        Gives the masses.
    angles_rad : ndarray (n, 3)
        Elevation, pitch and travel.

    Returns
    -------
    ndarray (n, 3, 3)
        By axis and axis.
    """
    plant = MujocoPlant(rig, ())
    found = np.empty((len(angles_rad), 3, 3))
    still, none = np.zeros(3), np.zeros(2)
    for i, angles in enumerate(angles_rad):
        rest = plant.acceleration(angles, still, none, still)
        answers = [plant.acceleration(angles, still, none, torque) - rest for torque in np.eye(3)]
        found[i] = np.linalg.inv(np.array(answers).T)
    return found


def pushes(one: Hidden) -> bool:
    """Whether something hidden acts otherwise than by MuJoCo's own model."""
    hooks = ("rest", "volts", "thrust", "torque", "measured")
    return any(getattr(type(one), hook) is not getattr(Hidden, hook) for hook in hooks)
