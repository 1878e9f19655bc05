"""Innovations of flights: a model linearised along them and filtered (Harvey, chapter 3)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Final

import numpy as np
from heli_host.arrays import Floats, Integers

from heli_lab.estimation import _kalman
from heli_lab.estimation.disturbances import DisturbanceModel
from heli_lab.estimation.innovations import Innovations
from heli_lab.estimation.linearised_flight import Blocks, LinearisedFlight
from heli_lab.threads import parallel_map

_BATCH: Final = 4
"""Disturbance models whose log-likelihoods cost as much as that of one."""


class InnovationsModel:
    """Innovations form of a model in several flights at some parameters, with any disturbances.

    Parameters
    ----------
    linearised_flights : sequence of LinearisedFlight
        The model along each flight; one at least.
    columns : sequence of ndarray
        For each flight, indices of the free parameters that it depends on.
    size : int
        Number of free parameters.
    """

    def __init__(
        self, linearised_flights: Sequence[LinearisedFlight], columns: Sequence[Integers], size: int
    ) -> None:
        self.linearised_flights, self.columns, self.size = tuple(linearised_flights), tuple(columns), size
        self.model = linearised_flights[0].model
        self._outputs = len(self.model.outputs)

    def innovations(self, disturbances: DisturbanceModel) -> Innovations:
        """Filter the errors of all flights, and their derivatives by the parameters, under `disturbances`."""
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
            for blocks in linearised.blocks:
                value, log_variances = next(parts)
                values.append(value)
                total += log_variances - 2.0 * _repeated_nats(linearised, blocks)
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
            Change of the rates, (n, states, s), and of the outputs, (n, m, s), for each flight. An iterator
            needs the memory of one flight only.
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

    def perturbed_residual(self, move: Floats | None = None) -> list[list[tuple[Floats, Floats]]]:
        """Errors of states and outputs in each window of each flight, to first order, after a `move` of the
        parameters, shape (f,); without it, of the model as it is.
        """
        move = np.zeros(self.size) if move is None else move
        return [
            [
                ((blocks.drive @ weight)[:, :, None], (blocks.measured @ weight)[:, :, None])
                for blocks in linearised.blocks
            ]
            for linearised, columns in zip(self.linearised_flights, self.columns, strict=True)
            for weight in [np.concatenate(([1.0], -move[columns]))]
        ]

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
        for (linearised, blocks, _, some), values in zip(every, parts, strict=True):
            total[some] += values + _repeated_nats(linearised, blocks)
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


def _repeated_nats(linearised: LinearisedFlight, blocks: Blocks) -> Floats:
    """Log-density of repeated measurements that the filter's lacks, nats, for each output of a window.

    The N measurements while an axis crosses its play have the same error, of variance v. For the filter they
    are N measurements with independent errors of variance N v, which add the same information. But together
    they have one normal density, not N: the other N - 1 have the density of a sensor without play.
    """
    factor = blocks.variance / linearised.variance[blocks.rows]
    nats: Floats = 0.5 * (np.log(factor) * (1.0 - 1.0 / linearised.repeats[blocks.rows])).sum(axis=0)
    return nats
