"""Visibility of each cause: what it contributes along a flight, above disturbances and tolerances."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.rig import Rig
from heli_sim.rig.rig import count_rad

from heli_benchmark.cases.clean import TRAIN_S
from heli_benchmark.cases.disturbed import DisturbedCase
from heli_benchmark.effects.disturbances import DisturbanceModel
from heli_benchmark.plant import STEP_S, HiddenEffect, MujocoPlant, TrueTrajectory

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


def true_torque_Nm(case: DisturbedCase, flight: int, duration_s: float) -> tuple[Floats, Floats]:
    """Return times and torques of the hidden unlisted causes along a flight, shapes (n,) and (n, 3)."""
    trajectory = case.fly(flight, duration_s)[1]
    rig = case.rig()
    listed, unlisted = len(case.effects), len(case.unlisted)
    # Effects may have a memory, so each rig gets new ones: listed, unlisted, then disturbances.
    others = [*case.hidden(flight)[:listed], *case.hidden(flight)[listed + unlisted :]]
    with_equation, without_equation = (
        replayed.accelerations(trajectory, replayed.forces(trajectory), FINE)
        for replayed in (ReplayedRig(rig, case.hidden(flight)), ReplayedRig(rig, others))
    )
    halves = len(trajectory.time_s) // steps(trajectory)
    middle = slice(halves // 2, steps(trajectory) * halves, halves)
    inertia = inertia_kg_m2(rig, trajectory.angles_rad[middle])
    torque = np.einsum("nij,nj->ni", inertia, with_equation - without_equation)
    return np.asarray(GRID_S * (np.arange(len(torque)) + 0.5), float), np.asarray(torque, float)


def torque_correlation(
    true_s: Floats, true_Nm: Floats, proposed_s: Floats, proposed_Nm: Floats
) -> tuple[int, float]:
    """Correlate proposed torques with the true ones, about the axis on which the true ones vary most.
    Shapes: `true_s, proposed_s` (n,), `true_Nm, proposed_Nm` (n, 3). Returns `axis`, `correlation`.
    """
    overlap = (true_s >= proposed_s[0]) & (true_s <= proposed_s[-1])
    axis = int(np.argmax(true_Nm[overlap].std(axis=0)))
    truth = true_Nm[overlap, axis]
    proposal = np.interp(true_s[overlap], proposed_s, proposed_Nm[:, axis])
    if not truth.std() or not proposal.std():
        return axis, 0.0
    return axis, float(np.corrcoef(truth, proposal)[0, 1])


_SMALL = 1e-4
_START_RAD, _START_RAD_S = 0.02, 0.2
_OTHER_CAUSE = 10.0
"""Prior of the size of another cause, in multiples of its true size: it may have any size."""
_MECHANICAL = ("M_f", "M_b", "M_w", "M_h", "M_l", "L_a", "L_b", "L_h", "L_phi", "L_theta", "L_x")
_FRICTIONS = ("friction_elevation", "friction_pitch", "friction_travel")


@dataclass(frozen=True)
class CauseContribution:
    """Contribution of a cause along a trajectory."""

    torque_Nm: Floats  # (n, 3): Torques about the axes
    encoder_error_rad: Floats  # (n, 3): Errors of the measured angles


def visibility(case: DisturbedCase, duration_s: float = TRAIN_S) -> dict[str, float]:
    """Return the standard deviations by which each cause exceeds the disturbances of a training flight. Only
    the part of a cause counts that no other cause and no error of a parameter can imitate.
    """
    names = [*(name for name, _ in case.effects), *(f"off-{name}" for name, _ in case.unlisted)]
    if not names:
        return {}
    _, trajectory = case.fly(0, duration_s)
    rig = case.rig()
    linearised = LinearisedRig(trajectory, rig, case.disturbances)
    with_all = ReplayedRig(rig, case.hidden(0))
    forces = with_all.forces(trajectory)
    acceleration = with_all.accelerations(trajectory, forces)

    def contribution(cause: int) -> CauseContribution:
        """Subtract a replay without this cause from the replay with all."""
        effects = case.hidden(0)  # Effects may have a memory, so each replay gets new ones.
        without_cause = ReplayedRig(rig, [*effects[:cause], *effects[cause + 1 :]])
        forces_without = without_cause.forces(trajectory) if acts_by_itself(effects[cause]) else forces
        difference = acceleration - without_cause.accelerations(trajectory, forces_without)
        encoder_error_rad = forces.encoder_rad - forces_without.encoder_rad
        return CauseContribution(linearised.torque(difference, FINE), encoder_error_rad)

    causes = [contribution(cause) for cause in range(len(names))]
    others = imitators(rig, trajectory, forces, linearised)
    innovations = linearised.innovations([*causes, *others])
    return {name: residual_norm(innovations, i, len(causes)) for i, name in enumerate(names)}


def imitators(
    rig: Rig, trajectory: TrueTrajectory, forces: Forces, linearised: LinearisedRig
) -> list[CauseContribution]:
    """Return the contribution of an error of each parameter by one standard deviation of its prior."""
    nothing = np.zeros((steps(trajectory), 3))
    base = ReplayedRig(rig, ()).accelerations(trajectory, forces, FINE)
    contributions = []

    def std(name: str) -> float:
        return 0.5 * rig[name].tolerance  # a tolerance is two standard deviations

    for name in (*_MECHANICAL, *_FRICTIONS):
        if std(name):
            changed_rig = ReplayedRig(rig.replace(**{name: rig[name].value + std(name)}), ())
            change = changed_rig.accelerations(trajectory, forces, FINE) - base
            contributions.append(CauseContribution(linearised.torque(change, 1), nothing))
    # Errors of the thrust gain and of the dead zone change the thrusts directly.
    gain = rig["thrust_gain"].value
    is_on = np.abs(forces.thrust_N) > 0.0
    for thrust_change_N in (
        forces.thrust_N * std("thrust_gain") / gain,
        -gain * std("dead_zone") * np.sign(forces.thrust_N) * is_on,
    ):
        changed = Forces(forces.thrust_N + thrust_change_N, forces.torque_Nm, forces.encoder_rad)
        change = ReplayedRig(rig, ()).accelerations(trajectory, changed, FINE) - base
        contributions.append(CauseContribution(linearised.torque(change, 1), nothing))
    for i, axis in enumerate(("elevation", "pitch", "travel")):
        constant = np.zeros((steps(trajectory), 3))
        constant[:, i] = 1.0
        contributions.append(CauseContribution(constant * std(f"torque_{axis}"), nothing))
        if axis != "travel":  # whose zero is free
            offset = constant * math.radians(std(f"offset_{axis}"))
            contributions.append(CauseContribution(nothing, offset))
    return contributions


class LinearisedRig:
    """A rig linearised about a trajectory, and the Kalman filter for its disturbances that whitens."""

    def __init__(self, trajectory: TrueTrajectory, rig: Rig, disturbances: DisturbanceModel) -> None:
        halves = len(trajectory.time_s) // steps(trajectory)
        middle = slice(halves // 2, steps(trajectory) * halves, halves)
        self._inertia = inertia_kg_m2(rig, trajectory.angles_rad[middle])
        self._inverse_inertia = np.linalg.inv(self._inertia)
        forces = ReplayedRig(rig, ()).forces(trajectory)
        self._acceleration_by_state = _jacobians(rig, trajectory, forces)
        self._disturbances = disturbances
        self._encoder_covariance = np.diag(count_rad(rig) ** 2 / 12.0)

    def torque(self, acceleration: Floats, parts: int) -> Floats:
        """Return the torques of an `acceleration`, rad/s2, given in `parts` of a step, as means of the steps,
        shape (n, 3).
        """
        mean = acceleration.reshape(-1, parts, 3).mean(axis=1)
        return np.asarray(np.einsum("nij,nj->ni", self._inertia, mean))

    def innovations(self, contributions: Sequence[CauseContribution]) -> Floats:
        """Return the normalised innovations of `contributions`, shape (3 n, their number)."""
        # The error of the filter obeys a stable equation, so the unstable rig is not simulated.
        torques = np.stack([cause.torque_Nm for cause in contributions], axis=2)
        encoder_errors = np.stack([cause.encoder_error_rad for cause in contributions], axis=2)
        # States of the error: angles, rates, gusts and drift; the encoders measure the angles.
        output = np.eye(3, 12)
        disturbances = self._disturbances
        gust_decay = math.exp(-GRID_S / disturbances.correlation_time_s)
        gusts = _GaussMarkov(np.array(disturbances.gusts_Nm), gust_decay)
        drift_decay = math.exp(-GRID_S / disturbances.drift_s)
        drift = _GaussMarkov(np.array(disturbances.slow_std_Nm), drift_decay)
        process_covariance = np.zeros((12, 12))
        for start, (std_Nm, decay) in ((6, gusts), (9, drift)):
            process_covariance[start : start + 3, start : start + 3] = np.diag(std_Nm**2 * (1.0 - decay**2))
        start_variances = [_START_RAD**2] * 3 + [_START_RAD_S**2] * 3
        covariance = np.diag([*start_variances, *gusts.std_Nm**2, *drift.std_Nm**2])
        error = np.zeros((12, len(contributions)))
        whitened = np.empty((len(torques), 3, len(contributions)))
        for k in range(len(torques)):
            innovation_covariance = output @ covariance @ output.T + self._encoder_covariance
            innovation = output @ error + encoder_errors[k]
            whitened[k] = np.linalg.solve(np.linalg.cholesky(innovation_covariance), innovation)
            gain = np.linalg.solve(innovation_covariance, output @ covariance).T
            error = error - gain @ innovation
            covariance = covariance - gain @ output @ covariance
            transition, input_matrix = self._discrete_step(k, gusts.decay, drift.decay)
            error = transition @ error + input_matrix @ torques[k]
            covariance = transition @ covariance @ transition.T + process_covariance
            covariance = 0.5 * (covariance + covariance.T)  # rounding would make it asymmetric
        return whitened.reshape(-1, len(contributions))

    def _discrete_step(self, k: int, gust_decay: float, drift_decay: float) -> tuple[Floats, Floats]:
        """Return the transition matrix of a step, (12, 12), and the input matrix of a torque, (12, 3)."""
        h = GRID_S
        a = np.zeros((6, 6))
        a[:3, 3:] = np.eye(3)
        a[3:] = self._acceleration_by_state[k]
        b = np.vstack([np.zeros((3, 3)), self._inverse_inertia[k]])
        # exp(a h) to third order: the time constants of the rig are tenths of a second.
        motion = np.eye(6) + h * a + h**2 / 2.0 * a @ a + h**3 / 6.0 * a @ a @ a
        by_torque = (h * np.eye(6) + h**2 / 2.0 * a + h**3 / 6.0 * a @ a) @ b
        transition = np.zeros((12, 12))
        transition[:6, :6], transition[:6, 6:9], transition[:6, 9:] = motion, by_torque, by_torque
        transition[6:9, 6:9], transition[9:, 9:] = gust_decay * np.eye(3), drift_decay * np.eye(3)
        return transition, np.vstack([by_torque, np.zeros((6, 3))])


class _GaussMarkov(NamedTuple):
    """A disturbance about three axes: its stationary standard deviations, and its decay over a step."""

    std_Nm: Floats
    decay: float


def residual_norm(innovations: Floats, which: int, causes: int) -> float:
    """Return the norm of a column of innovations that the other columns leave, each with a normal prior of
    its coefficient (ridge regression). Shapes: `innovations` (rows, columns), first those of all `causes`.
    """
    column = innovations[:, which]
    others = np.delete(innovations, which, axis=1)
    # In units of the standard deviations of the priors.
    others[:, : causes - 1] *= _OTHER_CAUSE
    gram = others.T @ others + np.eye(others.shape[1])
    correlation = others.T @ column
    remaining = column @ column - correlation @ np.linalg.solve(gram, correlation)
    return math.sqrt(max(float(remaining), 0.0))


def _jacobians(rig: Rig, trajectory: TrueTrajectory, forces: Forces) -> Floats:
    """Return the derivatives of the accelerations by angles and rates at each step, shape (n, 3, 6)."""
    nominal = ReplayedRig(rig, ())
    base = nominal.accelerations(trajectory, forces, FINE)
    jacobians = np.empty((steps(trajectory), 3, 6))
    for i in range(6):
        perturbed = trajectory.perturbed(i, _SMALL)
        jacobians[:, :, i] = (nominal.accelerations(perturbed, forces, FINE) - base) / _SMALL
    return jacobians
