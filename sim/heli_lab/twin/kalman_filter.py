"""The extended Kalman filter of a twin, with the sensitivities of its state to possible changes of the rig.

Its state z = (x, g, d, c, o) holds the model's state x and the errors o of the zeros of two encoders. About
each axis it holds disturbances (gusts g and a slow drift d) and a constant torque c. Over a step of 10 ms the
linearly implicit midpoint rule predicts

    x+ = x + Gamma (f(x, u) + B (g + d + c)),
    Gamma = (I - h A / 2)^-1 h,   Phi = (I - h A / 2)^-1 (I + h A / 2),

with the Jacobian A of f: the rule by which `heli_lab.estimation` linearises, at the filter's own state. The
sensitivity s of the state to a parameter p is propagated with it: s+ = F s + Gamma df/dp.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt
from heli_host.arrays import Floats
from heli_sim.model.parts import AXES
from scipy.special import erf

from heli_lab.estimation import DisturbanceModel, _kalman
from heli_lab.identify.flight_model import TORQUE_STD_Nm
from heli_lab.twin.likelihood_ratio import ONSETS, Innovation
from heli_lab.twin.twin_model import ZEROS, TwinModel

_COUNT_SHARE: Final = 12.0**-0.5
"""Standard deviation of a zero that is uniformly distributed over a count, in counts."""
_ANGLE_STD_rad: Final = 0.005
_RATE_STD_rad_s: Final = 0.3
_EFFECT_STATE_STD: Final = 0.3
"""Standard deviations of the initial state: angles to some counts, rates from two means over 0.1 s, states of
effects after a simulation from rest."""


_HELD_s: Final = 0.2
"""Length of an excursion of the voltage beyond those of the nominal flights, s: for so long, the effect of
the excess is unknown by as much as it is. A rotor that is braked for a moment, for example. Longer: a
single excursion hides changes for seconds. Shorter: what the rig does there is taken for a change."""
_REPEATS: Final = 10.0
"""Greatest number of measurements, 40 ms apart, of an angle within one count that together count as one,
because their errors are equal, not independent. At 1, slow travel in hover shows 19 nats of dry friction in
ten minutes of nominal flight. More: an axis at rest is hardly measured at all."""
_SLIDES: Final = 2.0 * 2.0**0.5
"""Scale of the smoothed sign of a rate in the derivative by dry friction, in standard errors of the rate. It
is the mean of the sign of an uncertain rate. Less: at rest, quantisation is taken for friction. More: slow
axes show no friction."""


class KalmanFilter:
    """Extended Kalman filter of one free flight.

    Parameters
    ----------
    twin : TwinModel
        Equations and derivatives.
    disturbances : DisturbanceModel
        Gusts, drift and quantisation.
    count_rad : ndarray (3,)
        Angle of one count of each encoder [rad].
    step_s : float
        Length of a step [s].
    block : int
        Number of steps between two measurements.
    state : ndarray (n,)
        Initial state of the model.
    is_changed : bool
        True if the rig has changed before: each possible change is then an unknown constant of the flight.

    Attributes
    ----------
    state_sensitivity : ndarray (order, columns, onsets)
        Error of the filter's state per unit of each change from each onset. `LikelihoodRatio.begin_onset`
        overwrites the columns of replaced onsets.
    """

    def __init__(
        self,
        twin: TwinModel,
        disturbances: DisturbanceModel,
        count_rad: Floats,
        step_s: float,
        block: int,
        state: Floats,
        *,
        is_changed: bool = False,
    ) -> None:
        self.twin, self.disturbances, self.step_s = twin, disturbances, step_s
        nx = self._nx = twin.states
        known = twin.directions.shape[1]
        self._directions = np.hstack((twin.directions, twin.prior_changes)) if is_changed else twin.directions
        """Amount of each free parameter per standard deviation of each unknown error."""
        self._scale_errors = (
            [(known + column, axis, twin.prior_sizes[column]) for column, axis in twin.scales]
            if is_changed
            else []
        )
        """For each unknown encoder scale: its place among the errors, its axis and standard deviation."""
        self._start_rad: Floats = state[:3].copy()
        errors = self._directions.shape[1]
        self._errors = slice(nx + 9 + len(ZEROS), nx + 9 + len(ZEROS) + errors)
        self._zeros = slice(nx + 9, nx + 9 + len(ZEROS))
        order = self._order = self._errors.stop
        self.mean: Floats = np.concatenate((state, np.zeros(order - nx)))
        constant = np.array([TORQUE_STD_Nm[f"torque_{axis}"] for axis in AXES])
        zeros = np.hypot(_COUNT_SHARE * count_rad[: len(ZEROS)], 0.5 * twin.zero_tolerance_rad)
        initial = np.concatenate(
            (
                [_ANGLE_STD_rad] * 3,
                [_RATE_STD_rad_s] * 3,
                [_EFFECT_STATE_STD] * (nx - 6),
                disturbances.fast_std,
                disturbances.slow_std,
                constant,
                zeros,
                np.ones(errors),
            )
        )
        self._root: Floats = np.diag(initial)
        """Square root of the covariance, P = R R'. It cannot give a negative variance; P itself, updated in
        place, does by rounding where a flight contradicts the model."""
        memory = disturbances.memory(step_s)
        self._memory: Floats = np.ones(order)
        self._memory[nx : nx + 6] = memory
        self._noise: Floats = np.zeros((6, order))
        self._noise[:, nx : nx + 6] = np.diag(np.sqrt((1.0 - memory**2) * disturbances.variance))
        self._count_rad = count_rad
        self._variance_rad2: Floats = count_rad**2 / 12.0 * disturbances.quantisation
        self.state_sensitivity: Floats = np.zeros((order, twin.weights.shape[1], ONSETS))
        self._transition: Floats = np.eye(order)
        self._drive: Floats = np.zeros((order, twin.weights.shape[0]))
        self._block_s = block * step_s

    @property
    def covariance(self) -> Floats:
        """Covariance of the errors of the state z, (order, order)."""
        return self._root @ self._root.T

    @property
    def state(self) -> Floats:
        """State of the model, (n,)."""
        return self.mean[: self._nx]

    @property
    def torque_Nm(self) -> Floats:
        """Estimated sum of gusts, drift and constant torque about each axis [N m], (3,)."""
        nx = self._nx
        return np.asarray(self.mean[nx : nx + 9].reshape(3, 3).sum(axis=0))

    @property
    def steady_torque_Nm(self) -> Floats:
        """Estimated sum of drift and constant torque about each axis [N m], (3,)."""
        nx = self._nx
        return np.asarray(self.mean[nx + 3 : nx + 9].reshape(2, 3).sum(axis=0))

    @property
    def zero_rad(self) -> Floats:
        """Estimated errors of the encoder zeros [rad], (2,)."""
        return self.mean[self._zeros]

    def predict(self, t_s: float, volts_V: Floats) -> None:
        """Predict over a step that begins at `t_s`, with the mean acting voltages `volts_V`, (2,)."""
        twin, nx, h = self.twin, self._nx, self.step_s
        point = twin.at(t_s + 0.5 * h, self.state, volts_V, h)
        rates, a, by_torque, by_volts, _, _ = twin.functions.along(point)
        phi, gamma = _kalman.midpoint(a, h)
        phi, gamma = phi[0], gamma[0]
        push = gamma @ by_torque[0]
        drive = np.empty((nx, self._drive.shape[1]))
        # The functions return the negative derivative of the rates by a parameter.
        drive[:, :-1] = -gamma @ rates[0, :, 1:]
        drive[:, -1] = -gamma @ (by_volts[0] @ volts_V)
        rate_std = np.linalg.norm(self._root[3:6], axis=1)
        for place, axis in twin.frictions:
            drive[:, place] *= erf(abs(self.mean[3 + axis]) / (_SLIDES * rate_std[axis]))
        by_error = drive @ self._directions
        transition = np.zeros((self._order, self._order))
        transition[:nx, :nx] = phi
        for first in (nx, nx + 3, nx + 6):
            transition[:nx, first : first + 3] = push
        transition[:nx, self._errors] = by_error
        np.fill_diagonal(transition[nx:, nx:], self._memory[nx:])
        after = (
            self.state + gamma @ rates[0, :, 0] + push @ self.torque_Nm + by_error @ self.mean[self._errors]
        )
        self.mean[nx:] *= self._memory[nx:]
        self.mean[:nx] = after
        if twin.resets is not None:
            (reset,) = twin.resets(twin.at(t_s + h, after, volts_V, h))
            self.mean[:nx] = reset[0, :, 0]
        self._propagate_root(transition, gamma @ by_volts[0], volts_V)
        self._drive = transition @ self._drive
        self._drive[:nx] += drive
        self._transition = transition @ self._transition

    def _propagate_root(self, transition: Floats, by_volts: Floats, volts_V: Floats) -> None:
        """Propagate the root of the covariance. Voltages that no nominal flight shows add noise, by the
        derivatives `by_volts` of the state, (n, 2).
        """
        rows = np.vstack(((transition @ self._root).T, self._noise))
        outside_V = self.twin.uncertainty.outside_V(volts_V)
        if np.any(outside_V > 0.0):
            unknown = np.zeros((2, self._order))
            unknown[:, : self._nx] = (by_volts * (outside_V * (_HELD_s / self.step_s) ** 0.5)).T
            rows = np.vstack((rows, unknown))
        self._root = np.asarray(np.linalg.qr(rows, mode="r")).T

    def propagate_sensitivity(self, ages_s: Floats, is_ramp: npt.NDArray[np.bool_]) -> None:
        """Propagate the sensitivities over the steps since the last call.

        Parameters
        ----------
        ages_s : ndarray (columns, onsets)
            Time from each onset to now [s]; 0 or less for onsets in the future.
        is_ramp : ndarray of bool (columns,)
            True for changes that grow with time at a constant rate.
        """
        amount = np.where(is_ramp[:, None], np.maximum(ages_s - 0.5 * self._block_s, 0.0), 1.0)
        amount = np.where(ages_s > 0.0, amount, 0.0)
        order, columns, onsets = self.state_sensitivity.shape
        moved = self._transition @ self.state_sensitivity.reshape(order, columns * onsets)
        self.state_sensitivity = moved.reshape(order, columns, onsets)
        self.state_sensitivity += (self._drive @ self.twin.weights)[:, :, None] * amount
        self._transition = np.eye(order)
        self._drive = np.zeros_like(self._drive)

    def _measurement_variance(self, samples: int) -> Floats:
        """Variance of the mean of so many `samples` of each angle, (3,)."""
        speed = np.abs(self.mean[3:6])
        crossings = np.minimum(speed * self.step_s / self._count_rad, 1.0)
        # Repeated measurements of an angle within one count carry no new information.
        passed_s = self._count_rad / np.maximum(speed, 1e-6)
        repeats = np.clip(passed_s / self._block_s, 1.0, _REPEATS)
        result: Floats = self._variance_rad2 * repeats / (1.0 + (samples - 1) * crossings)
        return result

    def update(
        self,
        t_s: float,
        measured_rad: Floats,
        samples: int,
        volts_V: Floats,
        amount: Floats,
        onset_rad: Floats,
    ) -> Innovation:
        """Update with a measurement, one axis after the other, and return the normalised innovations.

        Parameters
        ----------
        t_s : float
            Time of the measurement [s].
        measured_rad : ndarray (3,)
            Measured angles [rad].
        samples : int
            Number of samples of which the angles are the mean.
        volts_V : ndarray (2,)
            Acting voltages [V].
        amount : ndarray (columns, onsets)
            1 for onsets in the past, otherwise 0.
        onset_rad : ndarray (scales, onsets)
            For each of the twin's `scales`, the angle of its axis at each onset [rad].
        """
        twin, nx = self.twin, self._nx
        angles, c, by_free = twin.measure(twin.at(t_s, self.state, volts_V, self.step_s))
        # Direct effect of parameters and changes on the measured angles, not by way of the state.
        by_parameter = np.zeros((3, twin.weights.shape[0]))
        by_parameter[:, :-1] = by_free[0]
        by_error = by_parameter @ self._directions
        for place, axis, std in self._scale_errors:
            by_error[axis, place] += std * (self.mean[axis] - self._start_rad[axis])
        predicted = angles[0, :, 0] + np.array([*self.zero_rad, 0.0]) + by_error @ self.mean[self._errors]
        by_change = by_parameter @ twin.weights
        # A change of an encoder's scale counts the angle that its axis has turned since the onset.
        by_scale = {
            axis: (column, (self.mean[axis] - onset_rad[row]) * amount[column])
            for row, (column, axis) in enumerate(twin.scales)
        }
        variance = self._measurement_variance(samples)
        residual = measured_rad - predicted
        value = np.zeros(3)
        sensitivity = np.empty((3, *self.state_sensitivity.shape[1:]))
        order, columns, onsets = self.state_sensitivity.shape
        flat_sensitivity = self.state_sensitivity.reshape(order, columns * onsets)
        change = np.zeros(order)
        for axis in range(3):
            row = np.zeros(order)
            row[:nx] = c[0, axis]
            if axis < len(ZEROS):
                row[self._zeros.start + axis] = 1.0
            row[self._errors] = by_error[axis]
            by_root = self._root.T @ row
            gain = self._root @ by_root
            total = float(by_root @ by_root) + variance[axis]
            scale = total**-0.5
            value[axis] = (residual[axis] - row @ change) * scale
            projection = (row @ flat_sensitivity).reshape(columns, onsets)
            projection = projection + by_change[axis][:, None] * amount
            column, turned_rad = by_scale[axis]
            projection[column] += turned_rad
            projection *= scale
            sensitivity[axis] = projection
            change += gain * (scale * value[axis])
            flat_sensitivity -= np.outer(gain * scale, projection)
            # The measurement update of the root by Potter.
            self._root -= np.outer(gain, by_root) / (total + (total * variance[axis]) ** 0.5)
        self.mean += change
        return Innovation(value, sensitivity)
