"""The extended Kalman filter that flies beside a rig: causal, a step at a time.

Its state is the model's, torques by chance (gusts and a slow drift about each axis), a constant torque about
each axis, and the error of the zeros of two encoders, z = (x, g, d, c, o). Over a step of 10 ms the linearly
implicit midpoint rule predicts

    x+ = x + Gamma (f(x, u) + B (g + d + c)),
    Gamma = (I - h A / 2)^-1 h,   Phi = (I - h A / 2)^-1 (I + h A / 2),

with the Jacobian A of f: the rule by which `heli_lab.estimation` linearises, at the filter's own state. What
a parameter p that the model does not know of has moved follows beside it: s+ = F s + Gamma df/dp.
"""

from __future__ import annotations

from typing import Final

import casadi as ca
import numpy as np
import numpy.typing as npt
from heli_host.arrays import Floats
from heli_sim.model.base import Effect, Model
from heli_sim.model.parts import AXES
from heli_sim.rig import Rig
from scipy.special import erf

from heli_lab.estimation import AlongTrajectory, DisturbanceModel, Trajectory, _kalman
from heli_lab.identify.flight_model import TORQUE_STD_Nm, model_functions
from heli_lab.twin.changes import SCALES, SUPPLY, Change, changes_of, extended, free_numbers
from heli_lab.twin.likelihood_ratio import ONSETS, Innovation

ZEROS: Final = ("offset_elevation", "offset_pitch")
"""Encoders whose zero shows; that of travel changes nothing that a torque does not."""
_COUNT_SHARE: Final = 12.0**-0.5
"""Standard deviation of a zero that lies anywhere within a count, in counts."""
_ANGLE_STD_rad: Final = 0.005
_RATE_STD_rad_s: Final = 0.3
_OWN_STD: Final = 0.3
"""What is left open of the state where the filter begins: an angle to some counts, a rate that two means of
0.1 s give, an effect's own state after a run from rest."""


_REPEATS: Final = 10.0
"""Measurements, 40 ms apart, of an angle that stays within a count, that are worth one. Their errors are
the same, not independent: at 1, travel that creeps in hover shows 19 nats of dry friction in ten minutes of
healthy flight. More: an axis at rest is hardly measured at all."""
_SLIDES: Final = 2.0 * 2.0**0.5
"""Standard errors of a rate, times the root of 2, at which two thirds of a dry friction's derivative count:
the mean of a sign that is not known, at twice the filter's standard error. Less: at rest, where friction
holds and has no side, quantisation is taken for it. More: slow axes show no friction."""


class TwinModel:
    """A rig's equations with the derivatives that the filter needs.

    Parameters
    ----------
    model : Model
        Equations with the rig's effects; those that chance drives are weather and left out.
    rig : Rig
        Its numbers.

    Attributes
    ----------
    changes : tuple of Change
        What may change of it.
    parameters : ndarray (p,)
        All numbers of the extended model.
    """

    def __init__(self, model: Model, rig: Rig) -> None:
        calm = type(model)(tuple(effect for effect in model.effects if not effect.noise_inputs))
        self.rig, self.model = rig, calm
        self.changes: tuple[Change, ...] = changes_of(calm)
        more = extended(calm)
        self.functions = model_functions(more, free_numbers(self.changes))
        more = self.functions.model.source
        self.plain = model_functions(more, ())
        """The same without derivatives by what may change: quicker."""
        self.parameters: Floats = more.parameter_values(rig)
        names = self.functions.names
        self.delay_s = float(self.parameters[names.index(more.delay)]) if more.delay else 0.0
        dead_zone_V = more.dead_zone_V(self.parameters)
        self.least_V = -np.inf if dead_zone_V is None else dead_zone_V
        """Voltage below which a motor does nothing."""
        self.states = len(more.states)
        self.frictions = [
            (place, axis)
            for axis, name in enumerate(AXES)
            for place, free in enumerate(self.functions.free)
            if free == f"coulomb_friction_{name}_Nm"
        ]
        """Place of each axis' dry friction among the numbers, and the axis."""
        self.measure = self._measurement(more)
        resets = any(type(effect).reset_map is not Effect.reset_map for effect in calm.effects)
        self.resets = self._resets(more) if resets else None
        self.weights: Floats = self._weights()
        """What a unit of each number of each change is of the numbers that the model is differentiated by,
        shape (numbers + 1, columns); the last row is the supply."""
        entries = [entry for change in self.changes for entry in change.numbers]
        self.scales = [
            (column, AXES.index(SCALES[entry])) for column, entry in enumerate(entries) if entry in SCALES
        ]
        """Column of each encoder's scale among the numbers of the changes, and its axis."""
        tolerances = [rig[name].tolerance for name in ZEROS]
        self.zero_tolerance_rad: Floats = np.deg2rad(tolerances)

    def _weights(self) -> Floats:
        free = self.functions.free
        columns = [entry for change in self.changes for entry in change.numbers]
        weights = np.zeros((len(free) + 1, len(columns)))
        for column, entry in enumerate(columns):
            for name in entry.split("+"):
                if name not in SCALES:
                    weights[len(free) if name == SUPPLY else free.index(name), column] = 1.0
        return weights

    def _symbols(self, model: Model) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        return (
            ca.SX.sym("x", len(model.states)),
            ca.SX.sym("u", 2),
            ca.SX.sym("t"),
            ca.SX.sym("p", len(model.parameters)),
        )

    def _measurement(self, model: Model) -> AlongTrajectory:
        x, u, t, p = self._symbols(model)
        angles = model.measurement(x, u, p, t)
        by = ca.vertcat(*(p[i] for i in self.functions.places))
        wanted = [angles, ca.jacobian(angles, x), ca.jacobian(angles, by)]
        return AlongTrajectory(ca.Function("measure", [x, u, t, p], [ca.densify(w) for w in wanted]))

    def _resets(self, model: Model) -> AlongTrajectory:
        x, u, t, p = self._symbols(model)
        return AlongTrajectory(ca.Function("resets", [x, u, t, p], [ca.densify(model.reset_map(x, u, p, t))]))

    def at(self, t_s: float, state: Floats, volts_V: Floats, step_s: float) -> Trajectory:
        """Make the point of a course at which functions are evaluated: time `t_s`, `state` of shape (n,) or
        (k, n), voltages `volts_V`, (2,), in a step of `step_s`.
        """
        rows = np.atleast_2d(state)
        return Trajectory(
            np.full(len(rows), t_s),
            rows,
            np.broadcast_to(volts_V, (len(rows), 2)),
            step_s,
            self.parameters,
        )


class KalmanFilter:
    """Follows one free flight.

    Parameters
    ----------
    twin : TwinModel
        Equations.
    disturbances : DisturbanceModel
        Torques by chance and quantisation.
    count_rad : ndarray (3,)
        One count of each encoder.
    step_s : float
        Length of a step.
    block : int
        Steps from one measurement to the next.
    state : ndarray (n,)
        State of the model to begin with.

    Attributes
    ----------
    moved : ndarray (order, columns, onsets)
        What one unit of each change from each onset has moved of the filter's error; written by who keeps
        the onsets.
    """

    def __init__(
        self,
        twin: TwinModel,
        disturbances: DisturbanceModel,
        count_rad: Floats,
        step_s: float,
        block: int,
        state: Floats,
    ) -> None:
        self.twin, self.disturbances, self.step_s = twin, disturbances, step_s
        nx = self._nx = twin.states
        order = self._order = nx + 9 + len(ZEROS)
        self.mean: Floats = np.concatenate((state, np.zeros(9 + len(ZEROS))))
        constant = np.array([TORQUE_STD_Nm[f"torque_{axis}"] for axis in AXES])
        zeros = np.hypot(_COUNT_SHARE * count_rad[: len(ZEROS)], 0.5 * twin.zero_tolerance_rad)
        initial = np.concatenate(
            (
                [_ANGLE_STD_rad] * 3,
                [_RATE_STD_rad_s] * 3,
                [_OWN_STD] * (nx - 6),
                disturbances.fast_std,
                disturbances.slow_std,
                constant,
                zeros,
            )
        )
        self.covariance: Floats = np.diag(initial**2)
        memory = disturbances.memory(step_s)
        self._memory: Floats = np.ones(order)
        self._memory[nx : nx + 6] = memory
        self._noise: Floats = np.zeros(order)
        self._noise[nx : nx + 6] = (1.0 - memory**2) * disturbances.variance
        self._count_rad = count_rad
        self._variance_rad2: Floats = count_rad**2 / 12.0 * disturbances.quantisation
        self.moved: Floats = np.zeros((order, twin.weights.shape[1], ONSETS))
        self._transition: Floats = np.eye(order)
        self._drive: Floats = np.zeros((order, twin.weights.shape[0]))
        self._block_s = block * step_s

    @property
    def state(self) -> Floats:
        """State of the model, (n,)."""
        return self.mean[: self._nx]

    @property
    def torque_Nm(self) -> Floats:
        """Torques by chance and constant ones about each axis, (3,)."""
        nx = self._nx
        return np.asarray(self.mean[nx : nx + 9].reshape(3, 3).sum(axis=0))

    @property
    def steady_torque_Nm(self) -> Floats:
        """The slow drift and the constant torque about each axis, (3,)."""
        nx = self._nx
        return np.asarray(self.mean[nx + 3 : nx + 9].reshape(2, 3).sum(axis=0))

    def predict(self, t_s: float, volts_V: Floats) -> None:
        """Go on by a step that begins at `t_s`, with the mean voltages `volts_V` that acted, shape (2,)."""
        twin, nx, h = self.twin, self._nx, self.step_s
        point = twin.at(t_s + 0.5 * h, self.state, volts_V, h)
        rates, a, by_torque, by_volts, _, _ = twin.functions.along(point)
        phi, gamma = _kalman.midpoint(a, h)
        phi, gamma = phi[0], gamma[0]
        push = gamma @ by_torque[0]
        transition = np.zeros((self._order, self._order))
        transition[:nx, :nx] = phi
        for first in (nx, nx + 3, nx + 6):
            transition[:nx, first : first + 3] = push
        np.fill_diagonal(transition[nx:, nx:], self._memory[nx:])
        after = self.state + gamma @ rates[0, :, 0] + push @ self.torque_Nm
        self.mean[nx:] *= self._memory[nx:]
        self.mean[:nx] = after
        if twin.resets is not None:
            (reset,) = twin.resets(twin.at(t_s + h, after, volts_V, h))
            self.mean[:nx] = reset[0, :, 0]
        self.covariance = transition @ self.covariance @ transition.T
        self.covariance[np.diag_indices(self._order)] += self._noise
        drive = np.empty((nx, self._drive.shape[1]))
        # The functions give what a parameter takes off the rates.
        drive[:, :-1] = -gamma @ rates[0, :, 1:]
        drive[:, -1] = -gamma @ (by_volts[0] @ volts_V)
        rate_std = np.sqrt(np.diagonal(self.covariance)[3:6])
        for place, axis in twin.frictions:
            drive[:, place] *= erf(abs(self.mean[3 + axis]) / (_SLIDES * rate_std[axis]))
        self._drive = transition @ self._drive
        self._drive[:nx] += drive
        self._transition = transition @ self._transition

    def move(self, ages_s: Floats, grows: npt.NDArray[np.bool_]) -> None:
        """Move what changes have moved on to the end of the steps since the last call.

        Parameters
        ----------
        ages_s : ndarray (columns, onsets)
            Time from each onset to now; 0 or less where it is still to come.
        grows : ndarray of bool (columns,)
            Whether a column grows with its age.
        """
        amount = np.where(grows[:, None], np.maximum(ages_s - 0.5 * self._block_s, 0.0), 1.0)
        amount = np.where(ages_s > 0.0, amount, 0.0)
        order, columns, onsets = self.moved.shape
        moved = self._transition @ self.moved.reshape(order, columns * onsets)
        self.moved = moved.reshape(order, columns, onsets)
        self.moved += (self._drive @ self.twin.weights)[:, :, None] * amount
        self._transition = np.eye(order)
        self._drive = np.zeros_like(self._drive)

    def update(
        self,
        t_s: float,
        measured_rad: Floats,
        samples: int,
        volts_V: Floats,
        amount: Floats,
        onset_rad: Floats,
    ) -> Innovation:
        """Take a measurement in, one axis after the other.

        Parameters
        ----------
        t_s : float
            When.
        measured_rad : ndarray (3,)
            Angles.
        samples : int
            How many samples they are the mean of.
        volts_V : ndarray (2,)
            Voltages.
        amount : ndarray (columns, onsets)
            How much of each change there is by then: 1, or its age.
        onset_rad : ndarray (scales, onsets)
            For each of the twin's `scales`, the angle of its axis at each onset.
        """
        twin, nx = self.twin, self._nx
        angles, c, by_free = twin.measure(twin.at(t_s, self.state, volts_V, self.step_s))
        foretold = angles[0, :, 0] + np.array([*self.mean[-len(ZEROS) :], 0.0])
        direct = np.zeros((3, twin.weights.shape[0]))
        direct[:, :-1] = by_free[0]
        shown = direct @ twin.weights
        turned = {
            axis: (column, (self.mean[axis] - onset_rad[row]) * amount[column])
            for row, (column, axis) in enumerate(twin.scales)
        }
        speed = np.abs(self.mean[3:6])
        crossings = np.minimum(speed * self.step_s / self._count_rad, 1.0)
        # An angle that stays within a count tells the same again and again.
        passed_s = self._count_rad / np.maximum(speed, 1e-6)
        repeats = np.clip(passed_s / self._block_s, 1.0, _REPEATS)
        variance = self._variance_rad2 * repeats / (1.0 + (samples - 1) * crossings)
        surprise = measured_rad - foretold
        value = np.zeros(3)
        sensitivity = np.empty((3, *self.moved.shape[1:]))
        order, columns, onsets = self.moved.shape
        moved = self.moved.reshape(order, columns * onsets)
        change = np.zeros(order)
        for axis in range(3):
            row = np.zeros(order)
            row[:nx] = c[0, axis]
            if axis < len(ZEROS):
                row[axis - len(ZEROS)] = 1.0
            gain = self.covariance @ row
            total = float(row @ gain) + variance[axis]
            scale = total**-0.5
            value[axis] = (surprise[axis] - row @ change) * scale
            projection = (row @ moved).reshape(columns, onsets) + shown[axis][:, None] * amount
            column, counted = turned[axis]
            projection[column] += counted
            projection *= scale
            sensitivity[axis] = projection
            change += gain * (scale * value[axis])
            moved -= np.outer(gain * scale, projection)
            self.covariance -= np.outer(gain, gain) / total
        self.mean += change
        return Innovation(value, sensitivity)


def start_state(twin: TwinModel, t_s: Floats, angles_rad: Floats, volts_V: Floats, step_s: float) -> Floats:
    """Find the state at the last of some measured steps.

    Parameters
    ----------
    twin : TwinModel
        Equations.
    t_s : ndarray (n,)
        Beginning of each step.
    angles_rad : ndarray (n, 3)
        Measured angles there.
    volts_V : ndarray (n, 2)
        Mean voltages of each.
    step_s : float
        Length of a step.

    Returns
    -------
    ndarray (states,)
    """
    span = min(10, len(t_s) - 1)
    rates = np.gradient(angles_rad, step_s, axis=0) if len(t_s) > 1 else np.zeros_like(angles_rad)
    rate = (angles_rad[-1] - angles_rad[-1 - span]) / (span * step_s) if span else np.zeros(3)
    state = np.concatenate((angles_rad[-1], rate))
    offset = np.deg2rad([twin.rig[name].value for name in ZEROS])
    state[: len(ZEROS)] -= offset
    if twin.functions.extra_states:
        course = Trajectory(
            t_s + 0.5 * step_s, np.hstack((angles_rad, rates)), volts_V, step_s, twin.parameters
        )
        state = np.concatenate((state, twin.functions.integrate(course, np.sign(rates))[-2]))
    return state
