"""Maximum likelihood in innovations form: parameters of a model and the weather, estimated together.

The Kalman filter of a linearised model (`linear.py`) under weather (`weather.py`) turns measured angles into
innovations, which are white where the model is right, also in closed loop. It is linear in what drives it:
derivatives by the parameters are filtered beside the measurement, and the parameters follow by weighted least
squares with the rig's priors. The weather's numbers maximise the same likelihood. After Kristensen, Madsen
and Jorgensen, Automatica 40 (2004) 225, and Ljung, System Identification, chapter 7.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from heli_lab.identify.functions import Floats, Integers
from heli_lab.innovations import _kalman
from heli_lab.innovations.bordered import inverse_bordered, own_columns, solve_bordered
from heli_lab.innovations.course import Course
from heli_lab.innovations.linear import Blocks, Linear, ModelFunctions
from heli_lab.innovations.unknowns import Unknowns
from heli_lab.innovations.weather import Weather, maximise

# What is left open of the state at the beginning of a window, about the smoothed course: angles and rates
# are known to a count or so; an effect's own state starts as a run from rest has it.
_ANGLE_STD_rad: Final = 0.02
_RATE_STD_rad_s: Final = 0.3
_OWN_STD: Final = 0.3
_MAX_MOVES: Final = 15
_HALVINGS: Final = 4
_LEAST_GAIN: Final = 0.02
"""Share of the gain that derivatives promise that a move must bring."""
_FIRST_TURNS: Final = 2
_TURN_NATS: Final = 0.1
"""Gain of one more turn of parameters and weather below which the estimate counts as converged."""
_WEATHER_SHARE: Final = 0.05
"""Share of what the parameters' next move promises to which the weather is sought before it."""
_CONVERGED_NATS: Final = 0.02
"""Gain that one more move of the parameters may promise before the estimate counts as converged."""


@dataclass(frozen=True)
class Innovations:
    """Innovations of several flights.

    Parameters
    ----------
    flights : tuple of ndarray (m, 1 + k)
        For each flight the error's innovations first, then what one unit of each parameter takes off them
        that the flight depends on; in their standard deviations, the axes of a step one after the other.
    columns : tuple of ndarray (k,)
        For each flight, which parameters these are.
    size : int
        Number of parameters.
    log_variances : ndarray (3,)
        Sum of the logarithms of the variances of each axis.
    """

    flights: tuple[Floats, ...]
    columns: tuple[Integers, ...]
    size: int
    log_variances: Floats

    @property
    def own(self) -> Integers:
        """Parameters that each flight has of its own, shape (flights, k)."""
        return own_columns(self.columns, self.size)

    def information(self) -> Floats:
        """Fisher information of the parameters, shape (f, f)."""
        found = np.zeros((self.size, self.size))
        for one, own in zip(self.flights, self.columns, strict=True):
            found[np.ix_(own, own)] += one[:, 1:].T @ one[:, 1:]
        return found

    def score(self) -> Floats:
        """Derivatives of the log-likelihood by the parameters, shape (f,)."""
        found = np.zeros(self.size)
        for one, own in zip(self.flights, self.columns, strict=True):
            found[own] += one[:, 1:].T @ one[:, 0]
        return found

    def left(self, move: Floats) -> list[Floats]:
        """Innovations of the error of each flight, shape (m,), when the parameters have moved by `move`,
        shape (f,), to first order.
        """
        return [
            one[:, 0] - one[:, 1:] @ move[own] for one, own in zip(self.flights, self.columns, strict=True)
        ]


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
        self.linears, self.columns, self.size = tuple(linears), tuple(columns), size

    def innovations(self, weather: Weather) -> tuple[Floats, Floats]:
        """Filter: the error's innovations first, then what one unit of each parameter takes off them.

        Parameters
        ----------
        weather : Weather
            Torques by chance and quantisation.

        Returns
        -------
        innovations : ndarray (m, 1 + f)
            In their standard deviations; the three axes of a step one after the other, all flights.
        log_variances : ndarray (3,)
            Sum of the logarithms of the variances of each axis.
        """
        by_flight = self.innovations_by_flight(weather)
        every = np.zeros((sum(len(one) for one in by_flight.flights), 1 + self.size))
        low = 0
        for one, own in zip(by_flight.flights, self.columns, strict=True):
            every[low : low + len(one), np.concatenate(([0], 1 + own))] = one
            low += len(one)
        return every, by_flight.log_variances

    def innovations_by_flight(self, weather: Weather) -> Innovations:
        """Filter: the same, of each flight by the parameters alone that it depends on."""
        found, total = [], np.zeros(3)
        for one in self.linears:
            parts = []
            for blocks in one.blocks:
                value, log_variances = self._filter(one, blocks, weather, blocks.drive, blocks.measured_rad)
                parts.append(value)
                total += log_variances
            found.append(np.concatenate(parts))
        return Innovations(tuple(found), self.columns, self.size, total)

    def regressors(
        self, weather: Weather, signals: Iterable[tuple[Floats, Floats | None]]
    ) -> Iterator[Floats]:
        """What one unit of further signals takes off the innovations, shape (m, s) for each flight in turn.

        Parameters
        ----------
        weather : Weather
            Torques by chance and quantisation.
        signals : iterable of (ndarray, ndarray or None)
            For each flight changes of the rates, (n, states, s), and of the measured angles, (n, 3, s). Made
            one by one, they need the memory of one.
        """
        for one, (rates, angles) in zip(self.linears, signals, strict=True):
            found = []
            for blocks, moved in zip(one.blocks, one.over_blocks(rates), strict=True):
                seen = np.zeros((len(moved), 3, moved.shape[2])) if angles is None else angles[blocks.rows]
                found.append(self._filter(one, blocks, weather, -moved, seen)[0])
            yield np.concatenate(found)

    def torque_regressors(
        self, weather: Weather, axis: int, torques_Nm: Sequence[Floats]
    ) -> Iterator[Floats]:
        """What torques about one axis take off the innovations, shape (m, s) for each flight in turn: as
        `regressors`, at a fourth of the cost.

        Parameters
        ----------
        weather : Weather
            Torques by chance and quantisation.
        axis : int
            Number of the axis.
        torques_Nm : sequence of ndarray (n, s)
            For each flight each torque in the steps.
        """
        for one, values in zip(self.linears, torques_Nm, strict=True):
            found = []
            for blocks in one.blocks:
                moved = np.zeros((len(blocks.rows), blocks.transition.shape[1], values.shape[1]))
                for part, at_end in enumerate(blocks.part_input):
                    moved -= at_end[:, :, axis, None] * values[blocks.rows + part][:, None, :]
                seen = np.zeros((len(moved), 3, values.shape[1]))
                found.append(self._filter(one, blocks, weather, moved, seen)[0])
            yield np.concatenate(found)

    def _filter(
        self, one: Linear, blocks: Blocks, weather: Weather, drive: Floats, measured: Floats
    ) -> tuple[Floats, Floats]:
        value, log_variances = _kalman.filter(*self._system(one, blocks, weather), drive, measured)
        return value.reshape(-1, drive.shape[2]), np.array(log_variances)

    def moved(self, move: Floats) -> list[list[tuple[Floats, Floats]]]:
        """Errors of each flight when the parameters have moved by `move`, shape (f,), to first order."""
        return [
            [
                ((blocks.drive @ weight)[:, :, None], (blocks.measured_rad @ weight)[:, :, None])
                for blocks in one.blocks
            ]
            for one, own in zip(self.linears, self.columns, strict=True)
            for weight in [np.concatenate(([1.0], -move[own]))]
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
            one = self.linears[number]
            for blocks, (drive, measured) in zip(one.blocks, signals, strict=True):
                nx = blocks.transition.shape[1]
                mean, variance = _kalman.smooth(*self._system(one, blocks, weather), drive, measured)
                times.append(one.nodes.t_s[blocks.rows])
                values.append(mean[:, nx : nx + 3] + mean[:, nx + 3 :])
                errors.append(np.sqrt(variance[:, nx : nx + 3] + variance[:, nx + 3 :]))
            found.append((np.concatenate(times), np.concatenate(values), np.concatenate(errors)))
        return found

    def _system(self, one: Linear, blocks: Blocks, weather: Weather) -> tuple[Floats, ...]:
        return (
            blocks.transition,
            blocks.part_input,
            blocks.measurement,
            np.ascontiguousarray(blocks.variance_rad2 * weather.quantisation),
            weather.memory(one.course.step_s),
            weather.variance_N2m2,
            _initial_variance(blocks.transition.shape[1]),
        )

    def log_likelihoods(
        self, weathers: Sequence[Weather], error: Sequence[Sequence[tuple[Floats, Floats]]]
    ) -> Floats:
        """Log-likelihood of each axis' innovations of an `error`, as `moved` gives it, under each of several
        weathers, nats, without its constant; shape (w, 3).
        """
        variance = np.array([one.variance_N2m2 for one in weathers])
        scale = np.array([one.quantisation for one in weathers])
        total = np.zeros((len(weathers), 3))
        for one, signals in zip(self.linears, error, strict=True):
            memory = np.array([weather.memory(one.course.step_s) for weather in weathers])
            for blocks, (drive, measured) in zip(one.blocks, signals, strict=True):
                total += _kalman.log_likelihoods(
                    blocks.transition,
                    blocks.part_input,
                    blocks.measurement,
                    blocks.variance_rad2,
                    memory,
                    variance,
                    scale,
                    _initial_variance(blocks.transition.shape[1]),
                    drive,
                    measured,
                )
        return total

    def followed(self, weather: Weather) -> list[Course]:
        """Courses as this model's filter follows them, every step measured."""
        found = []
        for one in self.linears:
            course = one.course
            predicted, filtered = course.predicted.copy(), course.filtered.copy()
            steps = one.steps
            torque_input = steps.Gamma @ steps.by_torque
            for window, rows in zip(one.windows, course.windows, strict=True):
                before, after = _kalman.track(
                    steps.Phi[window],
                    np.ascontiguousarray(torque_input[window])[None],
                    steps.C[window],
                    np.ascontiguousarray(one.variance_rad2[window] * weather.quantisation),
                    weather.memory(course.step_s),
                    weather.variance_N2m2,
                    _initial_variance(one.states),
                    steps.drive[window],
                    steps.angle_error_rad[window],
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
    converged : bool
        Whether the last move promised next to nothing.
    courses : tuple of Course
        The flights.
    functions : ModelFunctions
        The model's equations.
    """

    unknowns: Unknowns
    theta: Floats
    covariance: Floats
    log_likelihood: float
    weather: Weather
    converged: bool
    courses: tuple[Course, ...]
    functions: ModelFunctions

    def filtered(self) -> Filtered:
        """Linearise the model at `theta`; not kept, because of every flight it takes megabytes a minute."""
        return _linearised(self.unknowns, self.courses, self.functions, self.theta)

    def other_weather(self) -> Weather | None:
        """Look for the weather afresh with the parameters as they are; None where it is none that is likelier
        than what was found.
        """
        filtered = self.filtered()
        error = filtered.moved(np.zeros(len(self.theta)))
        other = estimate_weather(filtered, error, Weather.start())
        now, then = filtered.log_likelihoods([self.weather, other], error).sum(axis=1)
        return other if then > now + _TURN_NATS else None


def solve(unknowns: Unknowns, theta: Floats, innovations: Innovations) -> tuple[Floats, Floats, float]:
    """Solve for the move of the parameters that maximises the posterior.

    Parameters
    ----------
    unknowns : Unknowns
        Priors and bounds.
    theta : ndarray (f,)
        Parameters at which the model is linearised.

    Returns
    -------
    move : ndarray (f,)
        Within the bounds.
    covariance : ndarray (f, f)
        Of the parameters.
    value : float
        Logarithm of the posterior at `theta`, nats.
    """
    precision, own = unknowns.std**-2.0, innovations.own
    offset = theta - unknowns.mean
    information = innovations.information() + np.diag(precision)
    gradient = innovations.score() - precision * offset
    squares = sum(float(one[:, 0] @ one[:, 0]) for one in innovations.flights)
    value = -0.5 * (squares + offset @ (precision * offset) + innovations.log_variances.sum())
    low, high = unknowns.bounds
    move = np.zeros(len(theta))
    free = np.ones(len(theta), bool)
    for _ in range(len(theta) + 1):
        rest = gradient - information[:, ~free] @ move[~free]
        # What is held meets nothing, and moves by nothing.
        held = np.where(free[:, None] & free, information, np.diag(np.where(free, 0.0, 1.0)))
        move[free] = solve_bordered(held, np.where(free, rest, 0.0), own)[free]
        over = free & ((theta + move < low) | (theta + move > high))
        if not over.any():
            break
        move[over] = (np.clip(theta + move, low, high) - theta)[over]
        free &= ~over
    covariance = inverse_bordered(information, own)
    return move, covariance, float(value)


def estimate_weather(
    filtered: Filtered,
    error: Sequence[Sequence[tuple[Floats, Floats]]],
    start: Weather,
    enough_nats: float = _CONVERGED_NATS,
) -> Weather:
    """Maximise the likelihood of the innovations of an `error`, as `Filtered.moved` gives it, over the
    weather, from `start` on, to `enough_nats`.
    """
    return maximise(lambda weathers: filtered.log_likelihoods(weathers, error), start, enough_nats)


def _linearised(
    unknowns: Unknowns, courses: Sequence[Course], functions: ModelFunctions, theta: Floats
) -> Filtered:
    linears = [
        Linear(course, functions, unknowns.parameters(theta, index)) for index, course in enumerate(courses)
    ]
    return Filtered(linears, unknowns.columns, len(theta))


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
        return _linearised(self.unknowns, self.courses, self.functions, theta)

    def at(self, theta: Floats, weather: Weather, filtered: Filtered) -> _Point:
        innovations = filtered.innovations_by_flight(weather)
        move, covariance, value = solve(self.unknowns, theta, innovations)
        squares = sum(float(left @ left) for left in innovations.left(move))
        offset = theta + move - self.unknowns.mean
        prior = offset @ (self.unknowns.std**-2.0 * offset)
        after = -0.5 * (squares + prior + innovations.log_variances.sum())
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
            if after.value > point.value + _LEAST_GAIN * share * point.promised:
                return after
            share *= 0.3
        return None

    def weathered(self, point: _Point, enough_nats: float) -> _Point:
        """The weather as likely as it can be, to `enough_nats`."""
        own = point.filtered.moved(np.zeros(len(point.theta)))
        weather = estimate_weather(point.filtered, own, point.weather, enough_nats)
        return self.at(point.theta, weather, point.filtered)

    def run(self, point: _Point) -> tuple[_Point, bool]:
        last = -np.inf
        for _ in range(_MAX_MOVES):
            if point.promised > _CONVERGED_NATS:
                after = self.moved(point)
                if after is None:
                    return self.weathered(point, _CONVERGED_NATS), False
                point = after
            # While parameters still move far the weather follows roughly; then to the end.
            point = self.weathered(point, max(_CONVERGED_NATS, _WEATHER_SHARE * point.promised))
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
        unknowns,
        point.theta,
        point.covariance,
        point.value,
        point.weather,
        converged,
        tuple(courses),
        functions,
    )
