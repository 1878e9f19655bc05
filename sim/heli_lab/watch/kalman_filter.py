"""The extended Kalman filter of a twin, with the sensitivities of its state to possible changes of the rig.

The state of the filter is z = (x, g, d, c, o, p). It contains the model's state x, the errors o of the zeros
of two encoders, and the errors p of the rig's parameters. For each axis it contains a gust g, a slow drift d
and a constant torque c. Over a step of 10 ms, the linearly implicit midpoint rule predicts

    x+ = x + Gamma (f(x, u) + B (g + d + c)),
    Gamma = (I - h A / 2)^-1 h,   Phi = (I - h A / 2)^-1 (I + h A / 2),

with the Jacobian A of f at the filter's state. `fit.estimation` linearises by the same rule. Let F be
the transition of z. The sensitivity s of z to a change v of a parameter is propagated by
s+ = F s + Gamma df/dv.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
from heli_host.data.arrays import Floats
from heli_sim.model.effect import AXES

from heli_lab.fit import _kalman
from heli_lab.fit.flight_model import TORQUE_STD_Nm
from heli_lab.fit.grey_box import DisturbanceModel
from heli_lab.watch.likelihood_ratio import ONSETS, Innovation, independent_copy
from heli_lab.watch.twin_model import ZEROS, TwinModel

_ROUNDING_STD_COUNTS: Final = 12.0**-0.5
"""Standard deviation of a zero that is uniformly distributed over a count, in counts."""
_ANGLE_STD_rad: Final = 1.0
"""Standard deviation of the initial angles, rad: they are unknown before the first measurement. An encoder
shows the sum of an angle and the error of its zero. Smaller: the first measurement is evidence against each
error of a zero, which then appears as a torque."""
_RATE_STD_rad_s: Final = 0.3
"""Standard deviation of the initial rates, which are means over 0.1 s, rad/s."""
_EFFECT_STATE_STD: Final = 0.3
"""Standard deviation of the initial states of effects, which are simulated from rest, SI."""


_EXCURSION_s: Final = 0.2
"""Typical length of an excursion of the voltage beyond those of the nominal flights, s, such as a rotor that
is braked for a moment. Over this time, the effect of the excess is uncertain by its own size. Longer: a
single excursion hides changes for seconds. Shorter: the effect of unknown voltages is taken for a change."""
_MAX_REPEATS: Final = 10.0
"""Greatest number of measurements, 40 ms apart, of an angle within one count that together count as one,
because their errors are equal, not independent. At 1, slow travel in hover shows 19 nats of dry friction in
ten minutes of nominal flight. More: an axis at rest is hardly measured at all."""
_SIGN_WIDTH_STDS: Final = 2.0 * 2.0**0.5
"""Scale of the smoothed sign of a rate in the derivative by dry friction, in standard errors of the rate. It
is the mean of the sign of an uncertain rate. Less: at rest, quantisation is taken for friction. More: slow
axes show no friction."""

_RATES: Final = slice(3, 6)
"""Rates among the model's states: the first states are the angles of the three axes, then come their rates.
"""


class _ScaleError(NamedTuple):
    """An unknown encoder scale, as one of the unknown errors."""

    error_index: int
    axis: int
    std: float  # Standard deviation of the scale


class KalmanFilter:
    """Extended Kalman filter of one free flight."""

    # `count_rad` has shape (3,). `state` has shape (n,). `mean` has shape (order,). `state_sensitivity` has
    # shape (order, columns, onsets). `differences_rad, stds_rad` has shape (3,).

    def __init__(
        self,
        twin: TwinModel,
        disturbances: DisturbanceModel,
        count_rad: Floats,
        step_s: float,
        steps_per_block: int,
        state: Floats,
        *,
        is_changed: bool = False,
    ) -> None:
        self.twin, self.disturbances, self.step_s = twin, disturbances, step_s
        self._count_rad, self._block_s = count_rad, steps_per_block * step_s
        # Amount of each free parameter, and of the supply, per standard deviation of each unknown error,
        # (free parameters + 1, errors). After a change, the possible changes are unknown errors too.
        self._directions: Floats = twin.directions
        self._scale_errors: list[_ScaleError] = []
        if is_changed:
            first_change = twin.directions.shape[1]
            self._directions = np.hstack((twin.directions, twin.prior_changes))
            self._scale_errors = [
                _ScaleError(first_change + column, axis, twin.prior_sizes[column])
                for column, axis in twin.scales
            ]
        self.differences_rad, self.stds_rad = np.zeros(3), np.ones(3)
        self.left_out: int | None = None
        self._start_rad: Floats = state[:3].copy()
        # Parts of z: model's state, gusts, drift and constant torques about three axes, zeros, errors.
        nx = self._nx = twin.states
        error_count = self._directions.shape[1]
        gusts_and_drift = slice(nx, nx + 6)
        self._torques = slice(nx, nx + 9)  # Gusts, drift and constant torques
        self._zeros = slice(self._torques.stop, self._torques.stop + len(ZEROS))
        self._errors = slice(self._zeros.stop, self._zeros.stop + error_count)
        order = self._order = self._errors.stop
        self.mean: Floats = np.concatenate((state, np.zeros(order - nx)))
        # Square root of the covariance, P = R R'. It cannot give a negative variance; P itself, updated in
        # place, does by rounding if a flight contradicts the model.
        self._root: Floats = np.diag(self._initial_std(error_count))
        # Autocorrelation of each part of z over a step, (order,), and roots of the process noise, (6, order).
        autocorrelation = disturbances.autocorrelation(step_s)
        self._autocorrelation: Floats = np.ones(order)
        self._autocorrelation[gusts_and_drift] = autocorrelation
        self._noise: Floats = np.zeros((6, order))
        noise_variance = (1.0 - autocorrelation**2) * disturbances.variance
        self._noise[:, gusts_and_drift] = np.diag(np.sqrt(noise_variance))
        self._variance_rad2: Floats = count_rad**2 / 12.0 * disturbances.quantisation
        # Since the last measurement: transition of z, (order, order), and its derivative by each free
        # parameter, (order, parameters + 1).
        self._transition: Floats = np.eye(order)
        self._parameter_sensitivity: Floats = np.zeros((order, twin.weights.shape[0]))
        self._watches_changes = twin.weights.shape[1] > 0
        # Transition of z over a step; only the rows of the model's state differ from step to step.
        self._step_transition: Floats = np.diag(self._autocorrelation)
        # 1 in the triangle of the root; above it, LAPACK keeps the reflections.
        self._root_mask: Floats = np.tri(order)
        self.state_sensitivity: Floats = np.zeros((order, twin.weights.shape[1], ONSETS))

    def copy(self) -> KalmanFilter:
        """Return a filter with the same state, which develops independently."""
        return independent_copy(self)

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
        return np.asarray(self.mean[self._torques].reshape(3, 3).sum(axis=0))

    @property
    def steady_torque_Nm(self) -> Floats:
        """Estimated sum of drift and constant torque about each axis [N m], (3,)."""
        _, drift_Nm, constant_Nm = self.mean[self._torques].reshape(3, 3)
        return np.asarray(drift_Nm + constant_Nm)

    @property
    def zero_rad(self) -> Floats:
        """Estimated errors of the encoder zeros [rad], (2,)."""
        return self.mean[self._zeros]

    def _initial_std(self, error_count: int) -> Floats:
        """Return the standard deviation of each part of z before the first measurement, (order,)."""
        zero_rounding_rad = _ROUNDING_STD_COUNTS * self._count_rad[: len(ZEROS)]
        return np.concatenate(
            (
                [_ANGLE_STD_rad] * 3,
                [_RATE_STD_rad_s] * 3,
                [_EFFECT_STATE_STD] * (self._nx - 6),
                self.disturbances.fast_std,
                self.disturbances.slow_std,
                [TORQUE_STD_Nm[f"torque_{axis}"] for axis in AXES],
                np.hypot(zero_rounding_rad, 0.5 * self.twin.zero_tolerance_rad),
                np.ones(error_count),
            )
        )

    def predict(self, t_s: float, volts_V: Floats) -> None:
        """Predict over a step that begins at `t_s`, with the mean acting voltages `volts_V`, (2,)."""
        twin, nx, h = self.twin, self._nx, self.step_s
        # Derivatives of the rates at the middle of the step, in arrays whose first index is the only point.
        middle = twin.functions.along(twin.at(t_s + 0.5 * h, self.state, volts_V, h))
        phi, gamma = (matrices[0] for matrices in _kalman.midpoint(middle.by_state, h))
        state_by_torque = gamma @ middle.by_disturbance[0]
        state_by_parameter = np.empty((nx, self._parameter_sensitivity.shape[1]))
        # The functions return the negative derivative of the rates by a parameter.
        state_by_parameter[:, :-1] = -gamma @ middle.rates[0, :, 1:]
        state_by_parameter[:, -1] = -gamma @ (middle.by_input[0] @ volts_V)
        # Dry friction has the sign of the rate. The mean sign of an uncertain rate is smaller than one.
        for column, axis in twin.frictions:
            rate_std_rad_s = np.linalg.norm(self._root[_RATES][axis])
            rate_stds = abs(self.mean[_RATES][axis]) / (_SIGN_WIDTH_STDS * rate_std_rad_s)
            state_by_parameter[:, column] *= math.erf(rate_stds)
        state_by_error = state_by_parameter @ self._directions
        transition = self._step_transition
        transition[:nx, :nx] = phi
        # Gusts, drift and constant torques all act as torques: the same block three times, in a view.
        transition[:nx, self._torques].reshape(nx, 3, 3)[:] = state_by_torque[:, None]
        transition[:nx, self._errors] = state_by_error
        predicted = (
            self.state
            + gamma @ middle.rates[0, :, 0]
            + state_by_torque @ self.torque_Nm
            + state_by_error @ self.mean[self._errors]
        )
        self.mean[nx:] *= self._autocorrelation[nx:]
        self.mean[:nx] = predicted
        if twin.resets is not None:
            (reset,) = twin.resets(twin.at(t_s + h, predicted, volts_V, h))
            self.mean[:nx] = reset[0, :, 0]
        self._propagate_root(transition, gamma @ middle.by_input[0], volts_V)
        if self._watches_changes:
            self._parameter_sensitivity = transition @ self._parameter_sensitivity
            self._parameter_sensitivity[:nx] += state_by_parameter
            self._transition = transition @ self._transition

    def _propagate_root(self, transition: Floats, by_volts: Floats, volts_V: Floats) -> None:
        """Propagate the root of the covariance by a QR decomposition (array algorithm). Shapes: `transition`
        (order, order), `by_volts` (n, 2), `volts_V` (2,).
        """
        # P+ = F P F' + Q = M' M for the rows M = (F R, Q^1/2)'. The triangle of its QR decomposition is R+'.
        rows = np.vstack(((transition @ self._root).T, self._noise))
        outside_V = self.twin.uncertainty.outside_V(volts_V)
        if np.any(outside_V > 0.0):
            voltage_noise = np.zeros((2, self._order))
            std_V = outside_V * (_EXCURSION_s / self.step_s) ** 0.5
            voltage_noise[:, : self._nx] = (by_volts * std_V).T
            rows = np.vstack((rows, voltage_noise))
        packed, _ = np.linalg.qr(rows, mode="raw")
        self._root = packed[:, : self._order] * self._root_mask

    def propagate_sensitivity(self, ages_s: Floats, is_ramp: npt.NDArray[np.bool_]) -> None:
        """Propagate the sensitivities over the steps since the last call, s+ = F s + G w a. Shapes: `ages_s`
        (columns, onsets), `is_ramp` (columns,).
        """
        # `predict` accumulates the transition F of z, and the derivative G of z by the free parameters. A
        # unit of each change adds the twin's `weights` w to these parameters. The amount a of a change is 0
        # before its onset. After it, the amount of a step is 1, and the amount of a ramp is the time since
        # the onset at the middle of the block.
        if not self._watches_changes:
            return
        ramp_s = np.maximum(ages_s - 0.5 * self._block_s, 0.0)
        amount = np.where(ages_s > 0.0, np.where(is_ramp[:, None], ramp_s, 1.0), 0.0)
        order, columns, onsets = self.state_sensitivity.shape
        propagated = self._transition @ self.state_sensitivity.reshape(order, columns * onsets)
        self.state_sensitivity = propagated.reshape(order, columns, onsets)
        self.state_sensitivity += (self._parameter_sensitivity @ self.twin.weights)[:, :, None] * amount
        self._transition = np.eye(order)
        self._parameter_sensitivity = np.zeros_like(self._parameter_sensitivity)

    def _measurement_variance(self, samples: int) -> Floats:
        """Return the variance of the mean of this number of `samples` of each angle, (3,) [rad2]."""
        speed_rad_s = np.abs(self.mean[3:6])
        # The samples of a mean have independent rounding errors as far as the axis moves by a count per step.
        crossings = np.minimum(speed_rad_s * self.step_s / self._count_rad, 1.0)
        # Repeated measurements of an angle within one count carry no new information.
        time_per_count_s = self._count_rad / np.maximum(speed_rad_s, 1e-6)
        repeats = np.clip(time_per_count_s / self._block_s, 1.0, _MAX_REPEATS)
        variance_rad2: Floats = self._variance_rad2 * repeats / (1.0 + (samples - 1) * crossings)
        return variance_rad2

    def update(
        self,
        t_s: float,
        measured_rad: Floats,
        samples: int,
        volts_V: Floats,
        amount: Floats,
        onset_rad: Floats,
    ) -> Innovation:
        """Update with a measurement, one axis after the other, and return the normalised innovations. Shapes:
        `measured_rad` (3,), `volts_V` (2,), `amount` (columns, onsets), `onset_rad` (scales, onsets).
        """
        angles, by_state, by_parameter = self.twin.measure(
            self.twin.at(t_s, self.state, volts_V, self.step_s)
        )
        direct = np.zeros((3, self.twin.weights.shape[0]))
        direct[:, :-1] = by_parameter[0]
        by_error = direct @ self._directions
        for error_index, axis, std in self._scale_errors:
            by_error[axis, error_index] += std * (self.mean[axis] - self._start_rad[axis])
        output_matrix = np.zeros((3, self._order))
        output_matrix[:, : self._nx] = by_state[0]
        output_matrix[: len(ZEROS), self._zeros] = np.eye(len(ZEROS))
        output_matrix[:, self._errors] = by_error
        # Increase of the measured angles by each change directly, and not through the state.
        direct_changes = (direct @ self.twin.weights)[:, :, None] * amount
        for row, (column, axis) in enumerate(self.twin.scales):
            direct_changes[axis, column] += (self.mean[axis] - onset_rad[row]) * amount[column]
        predicted_rad = angles[0, :, 0] + np.array([*self.zero_rad, 0.0]) + by_error @ self.mean[self._errors]
        return self._update_axes(
            measured_rad - predicted_rad, output_matrix, direct_changes, self._measurement_variance(samples)
        )

    def _update_axes(
        self, residual_rad: Floats, output_matrix: Floats, direct_changes: Floats, variance_rad2: Floats
    ) -> Innovation:
        """Update mean, root and sensitivities with one angle after the other. Shapes: `residual_rad` (3,),
        `output_matrix` (3, order), `direct_changes` (3, columns, onsets), `variance_rad2` (3,).
        """
        innovation = np.zeros(3)
        sensitivity = np.empty((3, *self.state_sensitivity.shape[1:]))
        order, columns, onsets = self.state_sensitivity.shape
        # A view, so that its changes are those of `self.state_sensitivity`.
        state_sensitivity = self.state_sensitivity.reshape(order, columns * onsets)
        correction = np.zeros(order)
        for axis, output_row in enumerate(output_matrix):
            root_row = self._root.T @ output_row
            covariance = self._root @ root_row  # of z with this angle
            innovation_variance = float(root_row @ root_row) + variance_rad2[axis]
            scale = innovation_variance**-0.5
            self.differences_rad[axis] = residual_rad[axis] - output_row @ correction
            self.stds_rad[axis] = 1.0 / scale
            if axis == self.left_out:
                sensitivity[axis] = 0.0
                continue
            innovation[axis] = self.differences_rad[axis] * scale
            sensitivity[axis] = (output_row @ state_sensitivity).reshape(columns, onsets)
            sensitivity[axis] += direct_changes[axis]
            sensitivity[axis] *= scale
            correction += covariance * (scale * innovation[axis])
            state_sensitivity -= np.outer(covariance * scale, sensitivity[axis])
            # Measurement update of the root by Potter.
            potter = innovation_variance + (innovation_variance * variance_rad2[axis]) ** 0.5
            self._root -= np.outer(covariance, root_row) / potter
        self.mean += correction
        return Innovation(innovation, sensitivity)
