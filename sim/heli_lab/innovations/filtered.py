"""Innovations of flights: the model along their courses, filtered under any weather."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from heli_lab.identify.functions import Floats, Integers
from heli_lab.innovations import _kalman
from heli_lab.innovations.bordered import own_columns
from heli_lab.innovations.course import Course
from heli_lab.innovations.linear import Blocks, Linear
from heli_lab.innovations.weather import Weather
from heli_lab.threads import shared_out

# What is left open of the state at the beginning of a window, about the smoothed course: angles and rates
# are known to a count or so; an effect's own state starts as a run from rest has it.
_ANGLE_STD_rad: Final = 0.02
_RATE_STD_rad_s: Final = 0.3
_OWN_STD: Final = 0.3
_FOUR: Final = 4
"""Weathers whose log-likelihoods cost as much as that of one."""


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
        information = np.zeros((self.size, self.size))
        for flight, columns in zip(self.flights, self.columns, strict=True):
            information[np.ix_(columns, columns)] += flight[:, 1:].T @ flight[:, 1:]
        return information

    def score(self) -> Floats:
        """Derivatives of the log-likelihood by the parameters, shape (f,)."""
        score = np.zeros(self.size)
        for flight, columns in zip(self.flights, self.columns, strict=True):
            score[columns] += flight[:, 1:].T @ flight[:, 0]
        return score

    @cached_property
    def log_likelihoods(self) -> Floats:
        """Log-likelihood of each axis' innovations of the error, nats, without its constant; shape (3,)."""
        squares = sum(
            (np.square(flight[:, 0]).reshape(-1, 3).sum(axis=0) for flight in self.flights), start=np.zeros(3)
        )
        values: Floats = -0.5 * (squares + self.log_variances)
        return values

    def left(self, move: Floats) -> list[Floats]:
        """Innovations of the error of each flight, shape (m,), when the parameters have moved by `move`,
        shape (f,), to first order.
        """
        return [
            flight[:, 0] - flight[:, 1:] @ move[columns]
            for flight, columns in zip(self.flights, self.columns, strict=True)
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
        every = np.zeros((sum(len(flight) for flight in by_flight.flights), 1 + self.size))
        low = 0
        for flight, columns in zip(by_flight.flights, self.columns, strict=True):
            every[low : low + len(flight), np.concatenate(([0], 1 + columns))] = flight
            low += len(flight)
        return every, by_flight.log_variances

    def innovations_by_flight(self, weather: Weather) -> Innovations:
        """Filter: the same, of each flight by the parameters alone that it depends on."""
        every = [(linear, blocks) for linear in self.linears for blocks in linear.blocks]
        parts = iter(
            shared_out(lambda part: self._filter(*part, weather, part[1].drive, part[1].measured_rad), every)
        )
        flights, total = [], np.zeros(3)
        for linear in self.linears:
            values = []
            for _ in linear.blocks:
                value, log_variances = next(parts)
                values.append(value)
                total += log_variances
            flights.append(np.concatenate(values))
        return Innovations(tuple(flights), self.columns, self.size, total)

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
        for linear, (rates, angles) in zip(self.linears, signals, strict=True):
            parts = []
            for blocks, moved in zip(linear.blocks, linear.over_blocks(rates), strict=True):
                seen = np.zeros((len(moved), 3, moved.shape[2])) if angles is None else angles[blocks.rows]
                parts.append(self._filter(linear, blocks, weather, -moved, seen)[0])
            yield np.concatenate(parts)

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
        for linear, values in zip(self.linears, torques_Nm, strict=True):
            parts = []
            for blocks in linear.blocks:
                moved = np.zeros((len(blocks.rows), blocks.transition.shape[1], values.shape[1]))
                for part, at_end in enumerate(blocks.part_input):
                    moved -= at_end[:, :, axis, None] * values[blocks.rows + part][:, None, :]
                seen = np.zeros((len(moved), 3, values.shape[1]))
                parts.append(self._filter(linear, blocks, weather, moved, seen)[0])
            yield np.concatenate(parts)

    def _filter(
        self, linear: Linear, blocks: Blocks, weather: Weather, drive: Floats, measured: Floats
    ) -> tuple[Floats, Floats]:
        value, log_variances = _kalman.filter(*self._system(linear, blocks, weather), drive, measured)
        return value.reshape(-1, drive.shape[2]), np.array(log_variances)

    def moved(self, move: Floats) -> list[list[tuple[Floats, Floats]]]:
        """Errors of each flight when the parameters have moved by `move`, shape (f,), to first order."""
        return [
            [
                ((blocks.drive @ weight)[:, :, None], (blocks.measured_rad @ weight)[:, :, None])
                for blocks in linear.blocks
            ]
            for linear, columns in zip(self.linears, self.columns, strict=True)
            for weight in [np.concatenate(([1.0], -move[columns]))]
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
        result = []
        for number, signals in enumerate(self.moved(move)):
            times, values, errors = [], [], []
            linear = self.linears[number]
            for blocks, (drive, measured) in zip(linear.blocks, signals, strict=True):
                nx = blocks.transition.shape[1]
                mean, variance = _kalman.smooth(*self._system(linear, blocks, weather), drive, measured)
                times.append(linear.nodes.t_s[blocks.rows])
                values.append(mean[:, nx : nx + 3] + mean[:, nx + 3 :])
                errors.append(np.sqrt(variance[:, nx : nx + 3] + variance[:, nx + 3 :]))
            result.append((np.concatenate(times), np.concatenate(values), np.concatenate(errors)))
        return result

    def _system(self, linear: Linear, blocks: Blocks, weather: Weather) -> tuple[Floats, ...]:
        return (
            blocks.transition,
            blocks.part_input,
            blocks.measurement,
            np.ascontiguousarray(blocks.variance_rad2 * weather.quantisation),
            weather.memory(linear.course.step_s),
            weather.variance_N2m2,
            _initial_variance(blocks.transition.shape[1]),
        )

    def log_likelihoods(
        self, weathers: Sequence[Weather], error: Sequence[Sequence[tuple[Floats, Floats]]]
    ) -> Floats:
        """Log-likelihood of each axis' innovations of an `error`, as `moved` gives it, under each of several
        weathers, nats, without its constant; shape (w, 3).
        """
        every = [
            (linear, blocks, signal, slice(low, low + _FOUR))
            for linear, signals in zip(self.linears, error, strict=True)
            for blocks, signal in zip(linear.blocks, signals, strict=True)
            for low in range(0, len(weathers), _FOUR)
        ]
        total = np.zeros((len(weathers), 3))
        parts = shared_out(lambda part: self._log_likelihoods(*part[:3], weathers[part[3]]), every)
        for (*_, some), values in zip(every, parts, strict=True):
            total[some] += values
        return total

    def _log_likelihoods(
        self, linear: Linear, blocks: Blocks, signal: tuple[Floats, Floats], weathers: Sequence[Weather]
    ) -> Floats:
        values: Floats = _kalman.log_likelihoods(
            blocks.transition,
            blocks.part_input,
            blocks.measurement,
            blocks.variance_rad2,
            np.array([weather.memory(linear.course.step_s) for weather in weathers]),
            np.array([weather.variance_N2m2 for weather in weathers]),
            np.array([weather.quantisation for weather in weathers]),
            _initial_variance(blocks.transition.shape[1]),
            *signal,
        )
        return values

    def followed(self, weather: Weather) -> list[Course]:
        """Courses as this model's filter follows them, every step measured."""
        courses = []
        for linear in self.linears:
            course = linear.course
            predicted, filtered = course.predicted.copy(), course.filtered.copy()
            steps = linear.steps
            torque_input = steps.Gamma @ steps.by_torque
            for window, rows in zip(linear.windows, course.windows, strict=True):
                before, after = _kalman.track(
                    steps.Phi[window],
                    np.ascontiguousarray(torque_input[window])[None],
                    steps.C[window],
                    np.ascontiguousarray(linear.variance_rad2[window] * weather.quantisation),
                    weather.memory(course.step_s),
                    weather.variance_N2m2,
                    _initial_variance(linear.states),
                    steps.drive[window],
                    steps.angle_error_rad[window],
                )
                predicted[rows] = course.predicted[rows] + before[:, :6]
                filtered[rows] = course.predicted[rows] + after[:, :6]
            courses.append(course.followed(predicted, filtered))
        return courses


def _initial_variance(states: int) -> Floats:
    initial = np.array([_ANGLE_STD_rad] * 3 + [_RATE_STD_rad_s] * 3 + [_OWN_STD] * (states - 6))
    return initial**2
