"""Contribution of each cause along a recorded trajectory: torques about the axes and errors of the encoders.

Each cause is removed in turn, and the rig is put into each recorded state. The difference of the
accelerations times the inertia is the torque of the cause. The method needs no equation of a cause, only
MuJoCo with and without it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.rig import Rig

from heli_benchmark.engine.plant import STEP_S, HiddenEffect, MujocoPlant
from heli_benchmark.engine.true_trajectory import TrueTrajectory

GRID_S = 0.02
"""Step of the analysis. Disturbances last 0.3 s and more, and rotors lag by 0.1 s."""
_HALVES = round(GRID_S / STEP_S)
FINE = 4
"""Parts of a step at which MuJoCo is evaluated: dry friction may reverse within a step."""


def steps(trajectory: TrueTrajectory) -> int:
    """Return the number of whole steps of the grid in a trajectory."""
    return len(trajectory.time_s) // _HALVES


@dataclass(frozen=True)
class Forces:
    """Thrusts and torques in each part of a step, and the angles at the encoders."""

    thrust_N: Floats  # (parts, 2): Thrusts, mean of each part
    torque_Nm: Floats  # (parts, 3): Torques in addition to those of MuJoCo, mean of each part
    encoder_rad: Floats  # (steps, 3): Angles at the encoders, before quantisation


@dataclass
class ReplayedRig:
    """A rig with some of the hidden effects, which is put into recorded states instead of flying."""

    rig: Rig  # Its parameters
    hidden: Sequence[HiddenEffect]  # Effects in it, newly created because some have a memory
    _plant: MujocoPlant = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self._plant = MujocoPlant(self.rig, self.hidden)

    def forces(self, trajectory: TrueTrajectory) -> Forces:
        """Return thrusts and torques along a trajectory."""
        plant, parts = self._plant, steps(trajectory) * FINE
        halves = _HALVES // FINE
        thrust, torque = np.zeros((parts, 2)), np.zeros((parts, 3))
        encoder_rad = np.empty((steps(trajectory), 3))
        # The board takes the angles at power-up for level.
        start = np.zeros(6)
        for effect in self.hidden:
            effect.rest(start)
        for k in range(steps(trajectory) * _HALVES):
            at = trajectory.moment(k)
            plant.act(at)
            thrust[k // halves] += at.thrust_N
            torque[k // halves] += at.torque_Nm
            if k % 2 == 0:
                # An encoder with play depends on each earlier angle.
                shown_rad = plant.encoder_angles_rad(at.angles_rad)
                if k % _HALVES == 0:
                    encoder_rad[k // _HALVES] = shown_rad - start[:3]
        return Forces(thrust / halves, torque / halves, encoder_rad)

    def accelerations(self, trajectory: TrueTrajectory, forces: Forces, stride: int = 1) -> Floats:
        """Return accelerations along a trajectory under given forces, rad/s2, shape (parts / stride, 3)."""
        plant, halves = self._plant, _HALVES // FINE
        accelerations_rad_s2 = np.empty((len(forces.thrust_N) // stride, 3))
        for i in range(len(accelerations_rad_s2)):
            part = i * stride
            k = part * halves + halves * stride // 2
            for effect in plant.hidden:
                effect.during(trajectory.moment(k), plant.physics)
            accelerations_rad_s2[i] = plant.acceleration(
                trajectory.angles_rad[k],
                trajectory.rates_rad_s[k],
                forces.thrust_N[part],
                forces.torque_Nm[part],
            )
        return accelerations_rad_s2


def inertia_kg_m2(rig: Rig, angles_rad: Floats) -> Floats:
    """Return the inertia matrices at given angles. Shapes: `angles_rad` (n, 3); returns (n, 3, 3)."""
    plant = MujocoPlant(rig, ())
    inertias = np.empty((len(angles_rad), 3, 3))
    zeros, no_thrust = np.zeros(3), np.zeros(2)
    for i, angles in enumerate(angles_rad):
        bias = plant.acceleration(angles, zeros, no_thrust, zeros)
        # Columns of the inverse inertia: accelerations by a torque of 1 N m about each axis.
        per_torque = [plant.acceleration(angles, zeros, no_thrust, torque) - bias for torque in np.eye(3)]
        inertias[i] = np.linalg.inv(np.array(per_torque).T)
    return inertias


def acts_by_itself(effect: HiddenEffect) -> bool:
    """Return whether an `effect` acts outside of the model of MuJoCo."""
    hooks = ("rest", "volts", "thrust", "torque", "measured")
    return any(getattr(type(effect), hook) is not getattr(HiddenEffect, hook) for hook in hooks)
