"""Maximum likelihood in innovations form: parameters of a model and the weather, estimated together.

The Kalman filter of a linearised model (`linear.py`) under weather (`weather.py`) turns measured angles into
innovations, which are white where the model is right, also in closed loop. It is linear in what drives it:
derivatives by the parameters are filtered beside the measurement, and the parameters follow by weighted least
squares with the rig's priors. The weather's numbers maximise the same likelihood. After Kristensen, Madsen
and Jorgensen, Automatica 40 (2004) 225, and Ljung, System Identification, chapter 7.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from heli_lab.identify.functions import Floats, Integers
from heli_lab.innovations import _kalman
from heli_lab.innovations.course import Course
from heli_lab.innovations.linear import Linear, ModelFunctions
from heli_lab.innovations.unknowns import Unknowns
from heli_lab.innovations.weather import Weather, maximise

# What is left open of the state at the beginning of a window, about the smoothed course: angles and rates
# are known to a count or so; an effect's own state starts as a run from rest has it.
_ANGLE_STD_rad: Final = 0.02
_RATE_STD_rad_s: Final = 0.3
_OWN_STD: Final = 0.3
BLOCK_s: Final = 0.04
"""Time from one measurement of the filter to the next. Encoders at rest repeat a count for tens of
milliseconds: taken every 10 ms their errors are correlated (0.15 to 0.43 from one to the next on simulated
flights, 2026-11), and weather of no memory is found; every 40 ms they are white to 0.05. Longer: rotor
lags and delays blur."""
_MAX_MOVES: Final = 15
_HALVINGS: Final = 5
_FIRST_TURNS: Final = 2
_TURN_NATS: Final = 0.1
"""Gain of one more turn of parameters and weather below which the estimate counts as converged."""
_CONVERGED_NATS: Final = 0.02
"""Gain that one more move of the parameters may promise before the estimate counts as converged."""


@dataclass(frozen=True)
class _Blocks:
    """A window in steps of a block: transition, and the torques' input by each step in it."""

    rows: Integers
    transition: Floats
    input: Floats
    measurement: Floats
    variance_rad2: Floats


class Filtered:
    """Innovations of several flights of one model at some parameters, under any weather.

    Parameters
    ----------
    linears : sequence of Linear
        The model along the course of each flight.
    columns : sequence of ndarray
        For each flight, which free parameters its derivatives are of.
    size : int
        Number of free parameters.
    """

    def __init__(self, linears: Sequence[Linear], columns: Sequence[Integers], size: int) -> None:
        self.linears = tuple(linears)
        self.size = size
        self.block = max(1, round(BLOCK_s / linears[0].course.step_s))
        self._windows = [[self._compose(one, window) for window in one.windows] for one in linears]
        self._own: list[list[tuple[Floats, Floats]]] = []
        for number, (one, own) in enumerate(zip(linears, columns, strict=True)):
            nx = one.Phi.shape[1]
            rates = np.zeros((one.rows, nx, size + 1))
            angles = np.zeros((one.rows, 3, size + 1))
            # With the opposite sign the filter gives what a parameter takes off the innovations.
            rates[:, :, 1 + own] = -one.by_parameters
            angles[:, :, 1 + own] = one.angles_by_parameters
            driven = one.Gamma @ rates
            driven[:, :, 0] = self._error_drive(one)
            angles[:, :, 0] = one.angle_error_rad
            self._own.append(self._over_blocks(number, driven, angles))

    @staticmethod
    def _error_drive(one: Linear) -> Floats:
        drive: Floats = np.einsum("nij,nj->ni", one.Gamma, one.defect)
        drive += np.einsum("nij,nj->ni", one.Phi, one.surprise)
        return drive

    def _compose(self, one: Linear, window: slice) -> _Blocks:
        count = (window.stop - window.start) // self.block
        rows = window.start + self.block * np.arange(count)
        transition = np.broadcast_to(np.eye(one.Phi.shape[1]), (count, *one.Phi.shape[1:])).copy()
        parts: list[Floats] = []
        for step in range(self.block):
            phi = one.Phi[rows + step]
            transition = np.asarray(phi @ transition, float)
            parts = [phi @ part for part in parts]
            parts.append(one.Gamma[rows + step] @ one.by_torque[rows + step])
        return _Blocks(
            rows, transition, np.array(parts), np.ascontiguousarray(one.C[rows]), one.variance_rad2[rows]
        )

    def _over_blocks(self, number: int, driven: Floats, angles: Floats) -> list[tuple[Floats, Floats]]:
        """Signals of a flight in steps of a block, for each window."""
        one, found = self.linears[number], []
        for blocks in self._windows[number]:
            together = driven[blocks.rows].copy()
            for step in range(1, self.block):
                together = one.Phi[blocks.rows + step] @ together + driven[blocks.rows + step]
            found.append((together, np.ascontiguousarray(angles[blocks.rows])))
        return found

    def innovations(
        self, weather: Weather, error: Sequence[Sequence[tuple[Floats, Floats]]] | None = None
    ) -> tuple[Floats, Floats]:
        """Filter: the error's innovations first, then what one unit of each parameter takes off them.

        Parameters
        ----------
        weather : Weather
            Torques by chance and quantisation.
        error : sequence, optional
            Other signals in their place, as `moved` gives them.

        Returns
        -------
        innovations : ndarray (m, 1 + f)
            In their standard deviations; the three axes of a step one after the other, all flights.
        log_variances : ndarray (3,)
            Sum of the logarithms of the variances of each axis.
        """
        found, total = [], np.zeros(3)
        for number, signals in enumerate(self._own if error is None else error):
            for blocks, (drive, measured) in zip(self._windows[number], signals, strict=True):
                value, log_variances = _kalman.filter(*self._system(blocks, weather), drive, measured)
                found.append(value.reshape(-1, drive.shape[2]))
                total += np.array(log_variances)
        return np.concatenate(found), total

    def regressors(self, weather: Weather, signals: Sequence[tuple[Floats, Floats | None]]) -> Floats:
        """What one unit of further signals takes off the innovations, shape (m, s).

        Parameters
        ----------
        weather : Weather
            Torques by chance and quantisation.
        signals : sequence of (ndarray, ndarray or None)
            For each flight changes of the rates, (n, states, s), and of the measured angles, (n, 3, s).
        """
        every = []
        for number, (one, (rates, angles)) in enumerate(zip(self.linears, signals, strict=True)):
            seen = np.zeros((one.rows, 3, rates.shape[2])) if angles is None else angles
            every.append(self._over_blocks(number, -(one.Gamma @ rates), seen))
        return self.innovations(weather, every)[0]

    def moved(self, move: Floats) -> list[list[tuple[Floats, Floats]]]:
        """Errors of each flight when the parameters have moved by `move`, shape (f,), to first order."""
        weight = np.concatenate(([1.0], -move))
        return [
            [((drive @ weight)[:, :, None], (measured @ weight)[:, :, None]) for drive, measured in flight]
            for flight in self._own
        ]

    def smoothed_torques(self, weather: Weather, move: Floats) -> list[tuple[Floats, Floats, Floats]]:
        """Torques by chance given each whole flight.

        Parameters
        ----------
        weather : Weather
            Torques by chance and quantisation.
        move : ndarray (f,)
            Move of the parameters beforehand.

        Returns
        -------
        list of (ndarray (k,), ndarray (k, 3), ndarray (k, 3))
            For each flight times since its first sample, gusts and drift together, and their standard error.
        """
        found = []
        for number, signals in enumerate(self.moved(move)):
            times, values, errors = [], [], []
            for blocks, (drive, measured) in zip(self._windows[number], signals, strict=True):
                nx = blocks.transition.shape[1]
                mean, variance = _kalman.smooth(*self._system(blocks, weather), drive, measured)
                times.append(self.linears[number].nodes.t_s[blocks.rows])
                values.append(mean[:, nx : nx + 3] + mean[:, nx + 3 :])
                errors.append(np.sqrt(variance[:, nx : nx + 3] + variance[:, nx + 3 :]))
            found.append((np.concatenate(times), np.concatenate(values), np.concatenate(errors)))
        return found

    def _system(self, blocks: _Blocks, weather: Weather) -> tuple[Floats, ...]:
        nx = blocks.transition.shape[1]
        step_s = self.linears[0].course.step_s
        memory = weather.memory(step_s)
        power = memory[None, :] ** np.arange(self.block)[:, None]
        torque_input = np.concatenate(
            (
                np.einsum("b...a,ba->...a", blocks.input, power[:, :3]),
                np.einsum("b...a,ba->...a", blocks.input, power[:, 3:]),
            ),
            axis=2,
        )
        return (
            blocks.transition,
            np.ascontiguousarray(torque_input),
            blocks.measurement,
            np.ascontiguousarray(blocks.variance_rad2 * weather.quantisation),
            memory**self.block,
            weather.variance_N2m2,
            _initial_variance(nx),
        )

    def followed(self, weather: Weather) -> list[Course]:
        """Courses as this model's filter follows them, every step measured."""
        found = []
        for one in self.linears:
            course = one.course
            predicted, filtered = course.predicted.copy(), course.filtered.copy()
            drive = self._error_drive(one)
            torque_input = one.Gamma @ np.tile(one.by_torque, (1, 1, 2))
            for window, rows in zip(one.windows, course.windows, strict=True):
                before, after = _kalman.track(
                    np.ascontiguousarray(one.Phi[window]),
                    np.ascontiguousarray(torque_input[window]),
                    np.ascontiguousarray(one.C[window]),
                    np.ascontiguousarray(one.variance_rad2[window] * weather.quantisation),
                    weather.memory(course.step_s),
                    weather.variance_N2m2,
                    _initial_variance(one.Phi.shape[1]),
                    np.ascontiguousarray(drive[window])[:, :, None],
                    np.ascontiguousarray(one.angle_error_rad[window])[:, :, None],
                )
                predicted[rows] = course.predicted[rows] + before[:, :6]
                filtered[rows] = course.predicted[rows] + after[:, :6]
            found.append(course.followed(predicted, filtered))
        return found


def _initial_variance(states: int) -> Floats:
    initial = np.array([_ANGLE_STD_rad] * 3 + [_RATE_STD_rad_s] * 3 + [_OWN_STD] * (states - 6))
    return initial**2


@dataclass(frozen=True)
class Estimate:
    """Parameters and weather of largest posterior likelihood.

    Parameters
    ----------
    theta : ndarray (f,)
        Free parameters.
    covariance : ndarray (f, f)
        Their covariance.
    log_likelihood : float
        In nats, up to a constant that all models of the same courses share; priors included.
    filtered : Filtered
        The model linearised at `theta`.
    converged : bool
        Whether the last move promised next to nothing.
    """

    unknowns: Unknowns
    theta: Floats
    covariance: Floats
    log_likelihood: float
    weather: Weather
    filtered: Filtered
    converged: bool


def solve(
    unknowns: Unknowns, theta: Floats, innovations: Floats, log_variances: Floats
) -> tuple[Floats, Floats, float]:
    """Solve for the move of the parameters that maximises the posterior.

    Parameters
    ----------
    unknowns : Unknowns
        Priors and bounds.
    theta : ndarray (f,)
        Parameters at which the model is linearised.
    innovations : ndarray (m, 1 + f)
        As `Filtered.innovations` gives them.
    log_variances : ndarray (3,)
        Sums of the logarithms of the innovations' variances.

    Returns
    -------
    move : ndarray (f,)
        Within the bounds.
    covariance : ndarray (f, f)
        Of the parameters.
    value : float
        Logarithm of the posterior at `theta`, nats.
    """
    error, sensitivity = innovations[:, 0], innovations[:, 1:]
    precision = unknowns.std**-2.0
    offset = theta - unknowns.mean
    information = sensitivity.T @ sensitivity + np.diag(precision)
    gradient = sensitivity.T @ error - precision * offset
    value = -0.5 * (error @ error + offset @ (precision * offset) + log_variances.sum())
    low, high = unknowns.bounds
    move = np.zeros(len(theta))
    free = np.ones(len(theta), bool)
    for _ in range(len(theta) + 1):
        rest = gradient - information[:, ~free] @ move[~free]
        move[free] = np.linalg.solve(information[np.ix_(free, free)], rest[free])
        over = free & ((theta + move < low) | (theta + move > high))
        if not over.any():
            break
        move[over] = (np.clip(theta + move, low, high) - theta)[over]
        free &= ~over
    covariance = np.asarray(np.linalg.inv(information), float)
    return move, covariance, float(value)


def estimate_weather(
    filtered: Filtered, error: Sequence[Sequence[tuple[Floats, Floats]]], start: Weather
) -> Weather:
    """Maximise the likelihood of the innovations of an `error`, as `Filtered.moved` gives it, over the
    weather, from `start` on.
    """

    def value(at: Weather) -> Floats:
        found, log_variances = filtered.innovations(at, error)
        squares = (found[:, 0].reshape(-1, 3) ** 2).sum(axis=0)
        result: Floats = -0.5 * (squares + log_variances)
        return result

    return maximise(value, start)


@dataclass
class _Point:
    """Parameters and weather, and the model linearised there."""

    theta: Floats
    weather: Weather
    filtered: Filtered
    move: Floats
    covariance: Floats
    value: float
    promised: float


class _Ascent:
    """Parameters by Gauss-Newton steps and weather by Newton steps in turn, neither ever downhill."""

    def __init__(self, unknowns: Unknowns, courses: Sequence[Course], functions: ModelFunctions) -> None:
        self.unknowns, self.courses, self.functions = unknowns, courses, functions

    def linearised(self, theta: Floats) -> Filtered:
        linears = [
            Linear(course, self.functions, self.unknowns.parameters(theta, index))
            for index, course in enumerate(self.courses)
        ]
        return Filtered(linears, self.unknowns.columns, len(theta))

    def at(self, theta: Floats, weather: Weather, filtered: Filtered) -> _Point:
        innovations, log_variances = filtered.innovations(weather)
        move, covariance, value = solve(self.unknowns, theta, innovations, log_variances)
        left = innovations[:, 0] - innovations[:, 1:] @ move
        offset = theta + move - self.unknowns.mean
        after = -0.5 * (left @ left + offset @ (self.unknowns.std**-2.0 * offset) + log_variances.sum())
        return _Point(theta, weather, filtered, move, covariance, value, float(after) - value)

    def begun(self, theta: Floats, weather: Weather | None) -> _Point:
        """Where to begin; without weather it is estimated at once, parameters following to first order."""
        filtered = self.linearised(theta)
        point = self.at(theta, weather or Weather.start(), filtered)
        if weather is None:
            for _ in range(_FIRST_TURNS):
                found = estimate_weather(filtered, filtered.moved(point.move), point.weather)
                point = self.at(theta, found, filtered)
        return point

    def moved(self, point: _Point) -> _Point | None:
        """Move the parameters, half as far where that leads down; None where nothing leads up."""
        share = 1.0
        for _ in range(_HALVINGS):
            theta = point.theta + share * point.move
            after = self.at(theta, point.weather, self.linearised(theta))
            if after.value > point.value - _CONVERGED_NATS:
                return after
            share *= 0.3
        return None

    def run(self, point: _Point) -> tuple[_Point, bool]:
        last = -np.inf
        for _ in range(_MAX_MOVES):
            if point.promised > _CONVERGED_NATS:
                after = self.moved(point)
                if after is None:
                    return point, False
                point = after
            # While parameters still move far the weather follows roughly; then to the end.
            own = point.filtered.moved(np.zeros(len(point.theta)))
            weather = estimate_weather(point.filtered, own, point.weather)
            point = self.at(point.theta, weather, point.filtered)
            if point.promised < _CONVERGED_NATS and point.value - last < _TURN_NATS:
                return point, True
            last = point.value
        return point, False


def estimate(
    unknowns: Unknowns,
    courses: Sequence[Course],
    functions: ModelFunctions,
    theta: Floats,
    weather: Weather | None = None,
) -> Estimate:
    """Estimate parameters and weather.

    Parameters
    ----------
    unknowns : Unknowns
        Free parameters of the model in these flights.
    courses : sequence of Course
        The flights.
    functions : ModelFunctions
        The model's equations, with derivatives by `unknowns.quantities`.
    theta : ndarray (f,)
        Parameters to start from.
    weather : Weather, optional
        Weather to start from; what comes out is never less likely than this and `theta`.
    """
    ascent = _Ascent(unknowns, courses, functions)
    point, converged = ascent.run(ascent.begun(theta, weather))
    return Estimate(
        unknowns, point.theta, point.covariance, point.value, point.weather, point.filtered, converged
    )
