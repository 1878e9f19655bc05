"""Innovations of flights: the model along their courses, filtered under any weather."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from heli_host.arrays import Floats, Integers

from heli_lab.estimation.arrowhead import per_flight_columns
from heli_lab.innovations import _kalman
from heli_lab.innovations.disturbances import DisturbanceModel
from heli_lab.innovations.linearised_flight import Blocks, LinearisedFlight
from heli_lab.innovations.reference_trajectory import ReferenceTrajectory
from heli_lab.threads import parallel_map

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
        return per_flight_columns(self.columns, self.size)

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


class InnovationsModel:
    """Innovations of several flights of one model at some parameters, under any weather.

    Parameters
    ----------
    linearised_flights : sequence of LinearisedFlight
        The model along the course of each flight.
    columns : sequence of ndarray
        For each flight, which free parameters its derivatives are of.
    size : int
        Number of free parameters.
    """

    def __init__(
        self, linearised_flights: Sequence[LinearisedFlight], columns: Sequence[Integers], size: int
    ) -> None:
        self.linearised_flights, self.columns, self.size = tuple(linearised_flights), tuple(columns), size

    def innovations(self, disturbances: DisturbanceModel) -> tuple[Floats, Floats]:
        """Filter: the error's innovations first, then what one unit of each parameter takes off them.

        Parameters
        ----------
        disturbances : DisturbanceModel
            Torques by chance and quantisation.

        Returns
        -------
        innovations : ndarray (m, 1 + f)
            In their standard deviations; the three axes of a step one after the other, all flights.
        log_variances : ndarray (3,)
            Sum of the logarithms of the variances of each axis.
        """
        by_flight = self.innovations_by_flight(disturbances)
        every = np.zeros((sum(len(flight) for flight in by_flight.flights), 1 + self.size))
        low = 0
        for flight, columns in zip(by_flight.flights, self.columns, strict=True):
            every[low : low + len(flight), np.concatenate(([0], 1 + columns))] = flight
            low += len(flight)
        return every, by_flight.log_variances

    def innovations_by_flight(self, disturbances: DisturbanceModel) -> Innovations:
        """Filter: the same, of each flight by the parameters alone that it depends on."""
        every = [
            (linearised, blocks) for linearised in self.linearised_flights for blocks in linearised.blocks
        ]
        parts = iter(
            parallel_map(
                lambda part: self._filter(*part, disturbances, part[1].drive, part[1].measured_rad), every
            )
        )
        flights, total = [], np.zeros(3)
        for linearised in self.linearised_flights:
            values = []
            for _ in linearised.blocks:
                value, log_variances = next(parts)
                values.append(value)
                total += log_variances
            flights.append(np.concatenate(values))
        return Innovations(tuple(flights), self.columns, self.size, total)

    def regressors(
        self, disturbances: DisturbanceModel, signals: Iterable[tuple[Floats, Floats | None]]
    ) -> Iterator[Floats]:
        """What one unit of further signals takes off the innovations, shape (m, s) for each flight in turn.

        Parameters
        ----------
        disturbances : DisturbanceModel
            Torques by chance and quantisation.
        signals : iterable of (ndarray, ndarray or None)
            For each flight changes of the rates, (n, states, s), and of the measured angles, (n, 3, s). Made
            one by one, they need the memory of one.
        """
        for linearised, (rates, angles) in zip(self.linearised_flights, signals, strict=True):
            parts = []
            for blocks, moved in zip(linearised.blocks, linearised.over_blocks(rates), strict=True):
                seen = np.zeros((len(moved), 3, moved.shape[2])) if angles is None else angles[blocks.rows]
                parts.append(self._filter(linearised, blocks, disturbances, -moved, seen)[0])
            yield np.concatenate(parts)

    def torque_regressors(
        self, disturbances: DisturbanceModel, axis: int, torques_Nm: Sequence[Floats]
    ) -> Iterator[Floats]:
        """What torques about one axis take off the innovations, shape (m, s) for each flight in turn: as
        `regressors`, at a fourth of the cost.

        Parameters
        ----------
        disturbances : DisturbanceModel
            Torques by chance and quantisation.
        axis : int
            Number of the axis.
        torques_Nm : sequence of ndarray (n, s)
            For each flight each torque in the steps.
        """
        for linearised, values in zip(self.linearised_flights, torques_Nm, strict=True):
            parts = []
            for blocks in linearised.blocks:
                moved = np.zeros((len(blocks.rows), blocks.transition.shape[1], values.shape[1]))
                for part, at_end in enumerate(blocks.part_input):
                    moved -= at_end[:, :, axis, None] * values[blocks.rows + part][:, None, :]
                seen = np.zeros((len(moved), 3, values.shape[1]))
                parts.append(self._filter(linearised, blocks, disturbances, moved, seen)[0])
            yield np.concatenate(parts)

    def _filter(
        self,
        linearised: LinearisedFlight,
        blocks: Blocks,
        disturbances: DisturbanceModel,
        drive: Floats,
        measured: Floats,
    ) -> tuple[Floats, Floats]:
        value, log_variances = _kalman.filter(
            *self._system(linearised, blocks, disturbances), drive, measured
        )
        return value.reshape(-1, drive.shape[2]), np.array(log_variances)

    def perturbed_residual(self, move: Floats) -> list[list[tuple[Floats, Floats]]]:
        """Errors of each flight when the parameters have moved by `move`, shape (f,), to first order."""
        return [
            [
                ((blocks.drive @ weight)[:, :, None], (blocks.measured_rad @ weight)[:, :, None])
                for blocks in linearised.blocks
            ]
            for linearised, columns in zip(self.linearised_flights, self.columns, strict=True)
            for weight in [np.concatenate(([1.0], -move[columns]))]
        ]

    def smoothed_torques(
        self, disturbances: DisturbanceModel, move: Floats
    ) -> list[tuple[Floats, Floats, Floats]]:
        """Torques by chance given each whole flight.

        Parameters
        ----------
        disturbances : DisturbanceModel
            Torques by chance and quantisation.
        move : ndarray (f,)
            Move of the parameters beforehand.

        Returns
        -------
        list of (ndarray (k,), ndarray (k, 3), ndarray (k, 3))
            For each flight times since its first sample, gusts and drift together, and their standard error.
        """
        result = []
        for number, signals in enumerate(self.perturbed_residual(move)):
            times, values, errors = [], [], []
            linearised = self.linearised_flights[number]
            for blocks, (drive, measured) in zip(linearised.blocks, signals, strict=True):
                nx = blocks.transition.shape[1]
                mean, variance = _kalman.smooth(
                    *self._system(linearised, blocks, disturbances), drive, measured
                )
                times.append(linearised.nodes.t_s[blocks.rows])
                values.append(mean[:, nx : nx + 3] + mean[:, nx + 3 :])
                errors.append(np.sqrt(variance[:, nx : nx + 3] + variance[:, nx + 3 :]))
            result.append((np.concatenate(times), np.concatenate(values), np.concatenate(errors)))
        return result

    def _system(
        self, linearised: LinearisedFlight, blocks: Blocks, disturbances: DisturbanceModel
    ) -> tuple[Floats, ...]:
        return (
            blocks.transition,
            blocks.part_input,
            blocks.measurement,
            np.ascontiguousarray(blocks.variance_rad2 * disturbances.quantisation),
            disturbances.memory(linearised.reference.step_s),
            disturbances.variance_N2m2,
            _initial_variance(blocks.transition.shape[1]),
        )

    def log_likelihoods(
        self, disturbance_models: Sequence[DisturbanceModel], error: Sequence[Sequence[tuple[Floats, Floats]]]
    ) -> Floats:
        """Log-likelihood of each axis' innovations of an `error` (`perturbed_residual`) under each of several
        weathers, nats, without its constant; shape (w, 3).
        """
        every = [
            (linearised, blocks, signal, slice(low, low + _FOUR))
            for linearised, signals in zip(self.linearised_flights, error, strict=True)
            for blocks, signal in zip(linearised.blocks, signals, strict=True)
            for low in range(0, len(disturbance_models), _FOUR)
        ]
        total = np.zeros((len(disturbance_models), 3))
        parts = parallel_map(
            lambda part: self._log_likelihoods(*part[:3], disturbance_models[part[3]]), every
        )
        for (*_, some), values in zip(every, parts, strict=True):
            total[some] += values
        return total

    def _log_likelihoods(
        self,
        linearised: LinearisedFlight,
        blocks: Blocks,
        signal: tuple[Floats, Floats],
        disturbance_models: Sequence[DisturbanceModel],
    ) -> Floats:
        values: Floats = _kalman.log_likelihoods(
            blocks.transition,
            blocks.part_input,
            blocks.measurement,
            blocks.variance_rad2,
            np.array(
                [disturbances.memory(linearised.reference.step_s) for disturbances in disturbance_models]
            ),
            np.array([disturbances.variance_N2m2 for disturbances in disturbance_models]),
            np.array([disturbances.quantisation for disturbances in disturbance_models]),
            _initial_variance(blocks.transition.shape[1]),
            *signal,
        )
        return values

    def refiltered(self, disturbances: DisturbanceModel) -> list[ReferenceTrajectory]:
        """Courses as this model's filter follows them, every step measured."""
        references = []
        for linearised in self.linearised_flights:
            reference = linearised.reference
            predicted, filtered = reference.predicted.copy(), reference.filtered.copy()
            steps = linearised.steps
            torque_input = steps.Gamma @ steps.by_torque
            for window, rows in zip(linearised.windows, reference.windows, strict=True):
                before, after = _kalman.track(
                    steps.Phi[window],
                    np.ascontiguousarray(torque_input[window])[None],
                    steps.C[window],
                    np.ascontiguousarray(linearised.variance_rad2[window] * disturbances.quantisation),
                    disturbances.memory(reference.step_s),
                    disturbances.variance_N2m2,
                    _initial_variance(linearised.states),
                    steps.drive[window],
                    steps.angle_error_rad[window],
                )
                predicted[rows] = reference.predicted[rows] + before[:, :6]
                filtered[rows] = reference.predicted[rows] + after[:, :6]
            references.append(reference.refiltered(predicted, filtered))
        return references


def _initial_variance(states: int) -> Floats:
    initial = np.array([_ANGLE_STD_rad] * 3 + [_RATE_STD_rad_s] * 3 + [_OWN_STD] * (states - 6))
    return initial**2
