"""Innovations of flights: a model linearised along them and filtered (Harvey, chapter 3)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from heli_host.arrays import Floats, Integers

from heli_lab.estimation import _kalman
from heli_lab.estimation.arrowhead import per_flight_columns
from heli_lab.estimation.disturbances import DisturbanceModel
from heli_lab.estimation.linearised_flight import Blocks, LinearisedFlight
from heli_lab.estimation.reference_trajectory import ReferenceTrajectory
from heli_lab.threads import parallel_map

_BATCH: Final = 4
"""Disturbance models whose log-likelihoods cost as much as that of one."""


@dataclass(frozen=True)
class Innovations:
    """Innovations of several flights.

    Parameters
    ----------
    flights : tuple of ndarray (b, 1 + k)
        One array per flight, in standard deviations. Column 0 holds the innovations. Each further column
        holds by how much a unit of one parameter of the flight reduces them. The m outputs of a block are in
        m consecutive rows.
    columns : tuple of ndarray (k,)
        For each flight, the indices of the k parameters that it depends on.
    size : int
        Number of parameters.
    log_variances : ndarray (m,)
        Sum of the logarithms of the variances of each output.
    """

    flights: tuple[Floats, ...]
    columns: tuple[Integers, ...]
    size: int
    log_variances: Floats

    @property
    def per_flight(self) -> Integers:
        """Parameters of one flight alone, shape (flights, k)."""
        return per_flight_columns(self.columns, self.size)

    def information(self) -> Floats:
        """Fisher information of the parameters, shape (f, f)."""
        information = np.zeros((self.size, self.size))
        for flight, columns in zip(self.flights, self.columns, strict=True):
            information[np.ix_(columns, columns)] += flight[:, 1:].T @ flight[:, 1:]
        return information

    def score(self) -> Floats:
        """Score: derivatives of the log-likelihood by the parameters, shape (f,)."""
        score = np.zeros(self.size)
        for flight, columns in zip(self.flights, self.columns, strict=True):
            score[columns] += flight[:, 1:].T @ flight[:, 0]
        return score

    @cached_property
    def log_likelihoods(self) -> Floats:
        """Log-likelihood of each output's innovations of the error, nats, without its constant, shape (m,):
        the prediction error decomposition (Harvey, section 3.4).
        """
        m = len(self.log_variances)
        squares = sum(
            (np.square(flight[:, 0]).reshape(-1, m).sum(axis=0) for flight in self.flights), start=np.zeros(m)
        )
        values: Floats = -0.5 * (squares + self.log_variances)
        return values

    def after(self, move: Floats) -> list[Floats]:
        """Innovations of the error of each flight, shape (b,), when the parameters have moved by `move`,
        shape (f,), to first order.
        """
        return [
            flight[:, 0] - flight[:, 1:] @ move[columns]
            for flight, columns in zip(self.flights, self.columns, strict=True)
        ]


class InnovationsModel:
    """Innovations form of a model in several flights at some parameters, with any disturbances.

    Parameters
    ----------
    linearised_flights : sequence of LinearisedFlight
        The model along each flight; one at least.
    columns : sequence of ndarray
        For each flight, which free parameters its derivatives are of.
    size : int
        Number of free parameters.
    """

    def __init__(
        self, linearised_flights: Sequence[LinearisedFlight], columns: Sequence[Integers], size: int
    ) -> None:
        self.linearised_flights, self.columns, self.size = tuple(linearised_flights), tuple(columns), size
        self.model = linearised_flights[0].model
        self._outputs = len(self.model.outputs)

    def innovations(self, disturbances: DisturbanceModel) -> tuple[Floats, Floats]:
        """Filter the errors of all flights, and their derivatives by all parameters.

        Parameters
        ----------
        disturbances : DisturbanceModel
            Disturbances and quantisation.

        Returns
        -------
        innovations : ndarray (b, 1 + f)
            As of `Innovations.flights`, one flight after the other.
        log_variances : ndarray (m,)
            Sum of the logarithms of the variances of each output.
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
                lambda part: self._filter(*part, disturbances, part[1].drive, part[1].measured), every
            )
        )
        flights, total = [], np.zeros(self._outputs)
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
        """Reduction of the innovations by a unit of further signals, shape (b, s) for each flight in turn.

        Parameters
        ----------
        disturbances : DisturbanceModel
            Disturbances and quantisation.
        signals : iterable of (ndarray, ndarray or None)
            For each flight changes of the rates, (n, states, s), and of the outputs, (n, m, s). An iterator
            needs the memory of one flight.
        """
        for linearised, (rates, outputs) in zip(self.linearised_flights, signals, strict=True):
            parts = []
            for blocks, drive in zip(linearised.blocks, linearised.over_blocks(rates), strict=True):
                measured = (
                    np.zeros((len(drive), self._outputs, drive.shape[2]))
                    if outputs is None
                    else outputs[blocks.rows]
                )
                parts.append(self._filter(linearised, blocks, disturbances, -drive, measured)[0])
            yield np.concatenate(parts)

    def disturbance_regressors(
        self, disturbances: DisturbanceModel, output: int, values: Sequence[Floats]
    ) -> Iterator[Floats]:
        """Reduction of the innovations by additions to the disturbance of one output, shape (b, s) for each
        flight in turn: as `regressors`, at a quarter of the cost.

        Parameters
        ----------
        disturbances : DisturbanceModel
            Disturbances and quantisation.
        output : int
            Number of the output.
        values : sequence of ndarray (n, s)
            For each flight the additions in each step, in the unit of the disturbed parameter.
        """
        for linearised, added in zip(self.linearised_flights, values, strict=True):
            parts = []
            for blocks in linearised.blocks:
                drive = np.zeros((len(blocks.rows), blocks.transition.shape[1], added.shape[1]))
                for part, at_end in enumerate(blocks.part_input):
                    drive -= at_end[:, :, output, None] * added[blocks.rows + part][:, None, :]
                measured = np.zeros((len(drive), self._outputs, added.shape[1]))
                parts.append(self._filter(linearised, blocks, disturbances, drive, measured)[0])
            yield np.concatenate(parts)

    def _filter(
        self,
        linearised: LinearisedFlight,
        blocks: Blocks,
        disturbances: DisturbanceModel,
        drive: Floats,
        measured: Floats,
    ) -> tuple[Floats, Floats]:
        value, log_variances = _kalman.filter(*self.system(linearised, blocks, disturbances), drive, measured)
        return value.reshape(-1, drive.shape[2]), np.array(log_variances)

    def perturbed_residual(self, move: Floats) -> list[list[tuple[Floats, Floats]]]:
        """Errors of states and outputs in each window of each flight, to first order, after a `move` of the
        parameters, shape (f,).
        """
        return [
            [
                ((blocks.drive @ weight)[:, :, None], (blocks.measured @ weight)[:, :, None])
                for blocks in linearised.blocks
            ]
            for linearised, columns in zip(self.linearised_flights, self.columns, strict=True)
            for weight in [np.concatenate(([1.0], -move[columns]))]
        ]

    def smoothed_disturbances(
        self, disturbances: DisturbanceModel, move: Floats
    ) -> list[tuple[Floats, Floats, Floats]]:
        """Disturbances given each whole flight, by the fixed-interval smoother (Harvey, section 3.6).

        Parameters
        ----------
        disturbances : DisturbanceModel
            Disturbances and quantisation.
        move : ndarray (f,)
            Move of the parameters beforehand.

        Returns
        -------
        list of (ndarray (k,), ndarray (k, m), ndarray (k, m))
            For each flight times since its first sample (s), the sum of the fast and the slow disturbance of
            each output in the unit of the disturbed parameter, and its standard error.
        """
        result = []
        m = self._outputs
        for number, signals in enumerate(self.perturbed_residual(move)):
            times, values, errors = [], [], []
            linearised = self.linearised_flights[number]
            for blocks, (drive, measured) in zip(linearised.blocks, signals, strict=True):
                nx = blocks.transition.shape[1]
                mean, variance = _kalman.smooth(
                    *self.system(linearised, blocks, disturbances), drive, measured
                )
                times.append(linearised.nodes.t_s[blocks.rows])
                values.append(mean[:, nx : nx + m] + mean[:, nx + m :])
                errors.append(np.sqrt(variance[:, nx : nx + m] + variance[:, nx + m :]))
            result.append((np.concatenate(times), np.concatenate(values), np.concatenate(errors)))
        return result

    def system(
        self, linearised: LinearisedFlight, blocks: Blocks, disturbances: DisturbanceModel
    ) -> tuple[Floats, ...]:
        """Arguments of the functions of `_kalman` that come before the signals, for a window of a flight."""
        return (
            blocks.transition,
            blocks.part_input,
            blocks.measurement,
            np.ascontiguousarray(blocks.variance * disturbances.quantisation),
            disturbances.memory(linearised.reference.step_s),
            disturbances.variance,
            self.model.initial_std**2,
        )

    def log_likelihoods(
        self, disturbance_models: Sequence[DisturbanceModel], error: Sequence[Sequence[tuple[Floats, Floats]]]
    ) -> Floats:
        """Log-likelihood of each output's innovations of an `error` (`perturbed_residual`) under each of some
        `disturbance_models`, nats, without its constant; shape (w, m).
        """
        every = [
            (linearised, blocks, signal, slice(low, low + _BATCH))
            for linearised, signals in zip(self.linearised_flights, error, strict=True)
            for blocks, signal in zip(linearised.blocks, signals, strict=True)
            for low in range(0, len(disturbance_models), _BATCH)
        ]
        total = np.zeros((len(disturbance_models), self._outputs))
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
            blocks.variance,
            np.array(
                [disturbances.memory(linearised.reference.step_s) for disturbances in disturbance_models]
            ),
            np.array([disturbances.variance for disturbances in disturbance_models]),
            np.array([disturbances.quantisation for disturbances in disturbance_models]),
            self.model.initial_std**2,
            *signal,
        )
        return values

    def refiltered(self, disturbances: DisturbanceModel) -> list[ReferenceTrajectory]:
        """Reference trajectories by this model's filter, with a measurement in every step."""
        references = []
        for linearised in self.linearised_flights:
            reference = linearised.reference
            predicted, filtered = reference.predicted.copy(), reference.filtered.copy()
            steps, followed = linearised.steps, self.model.followed
            disturbance_input = steps.Gamma @ steps.by_disturbance
            for window, rows in zip(linearised.windows, reference.windows, strict=True):
                before, after = _kalman.track(
                    steps.Phi[window],
                    np.ascontiguousarray(disturbance_input[window])[None],
                    steps.C[window],
                    np.ascontiguousarray(linearised.variance[window] * disturbances.quantisation),
                    disturbances.memory(reference.step_s),
                    disturbances.variance,
                    self.model.initial_std**2,
                    steps.drive[window],
                    steps.output_error[window],
                )
                predicted[rows] = reference.predicted[rows] + before[:, :followed]
                filtered[rows] = reference.predicted[rows] + after[:, :followed]
            references.append(reference.refiltered(predicted, filtered))
        return references
