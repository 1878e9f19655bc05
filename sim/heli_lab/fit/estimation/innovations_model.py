"""Compute the innovations of flights: a Kalman filter of a model that is linearised along them.

The filter is that of Harvey, chapter 3.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np
from heli_host.data.arrays import Floats, Integers

from heli_lab.fit.estimation import _kalman
from heli_lab.fit.estimation.disturbances import DisturbanceModel
from heli_lab.fit.estimation.innovations import Innovations
from heli_lab.fit.estimation.linearised_flight import Blocks, LinearisedFlight
from heli_lab.threads import parallel_map

_BATCH: Final = 4
"""Number of disturbance models whose log-likelihoods are computed together, at the cost of one."""


ModelErrors = tuple[Floats, Floats]
"""Errors of a linearised model in one window of b blocks; s such signals are filtered together.

The first array, (b, states, s), is the change of the state's deviation over each block because of the
error of the rates. The second one, (b, m, s), holds the errors of the measured outputs."""

FlightErrors = Sequence[Sequence[ModelErrors]]
"""`ModelErrors` of each window of each flight."""


class FilterSystem(NamedTuple):
    """Linear system of the Kalman filter in one window of b blocks.

    Its fields are the leading arguments of the functions of `_kalman`; the signals follow. There are m + g
    inputs, the disturbed parameters. Each has a fast and a slow Gauss-Markov state: first come all fast ones,
    then all slow ones.
    """

    transition: Floats  # transition, part_input, measurement: As in `Blocks`
    part_input: Floats
    measurement: Floats
    measurement_variance: Floats  # (b, m): Variance of each measurement
    autocorrelation: Floats
    """autocorrelation, disturbance_variance: (m + g): Autocorrelation over a step and stationary variance of
    each disturbance."""
    disturbance_variance: Floats
    initial_variance: Floats  # (states,): Variance of each state at the beginning of the window


class InnovationsModel:
    """Innovations form of a model in several flights: it is linearised once, and filtered for any
    disturbances.

    Parameters
    ----------
    linearised_flights : sequence of LinearisedFlight
        The model along each flight; at least one.
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
        windows = [
            (linearised, blocks) for linearised in self.linearised_flights for blocks in linearised.blocks
        ]

        def filter_window(window: tuple[LinearisedFlight, Blocks]) -> tuple[Floats, Floats]:
            """Filter one window, and return what `_filter_signals` returns."""
            linearised, blocks = window
            return self._filter_signals(linearised, blocks, disturbances, blocks.drive, blocks.measured)

        # Consumed below in the order of `windows`.
        filtered = iter(parallel_map(filter_window, windows))
        flights, log_variances = [], np.zeros(self._outputs)
        for linearised in self.linearised_flights:
            window_innovations = []
            for blocks in linearised.blocks:
                innovations, window_log_variances = next(filtered)
                window_innovations.append(innovations)
                log_variances += (
                    window_log_variances
                    - 2.0 * _repetition_correction_nats(linearised, blocks, [disturbances])[0]
                )
            flights.append(np.concatenate(window_innovations))
        return Innovations(tuple(flights), self.columns, self.size, log_variances)

    def regressors(
        self, disturbances: DisturbanceModel, signals: Iterable[tuple[Floats, Floats | None]]
    ) -> Iterator[Floats]:
        """Compute regressors: the reduction of the innovations per unit of each additional signal.

        Parameters
        ----------
        disturbances : DisturbanceModel
            Disturbances and quantisation.
        signals : iterable of (ndarray, ndarray or None)
            For each flight, changes of the rates, (n, states, s), and of the outputs, (n, m, s), by the
            signals. An iterator needs the memory of one flight only.

        Yields
        ------
        ndarray (m b, s)
            For each flight, one row per output and block, one column per signal.
        """
        for linearised, (rates, outputs) in zip(self.linearised_flights, signals, strict=True):
            windows = []
            for blocks, drive in zip(linearised.blocks, linearised.over_blocks(rates), strict=True):
                measured = None if outputs is None else outputs[blocks.rows]
                windows.append(self._filter_signals(linearised, blocks, disturbances, -drive, measured)[0])
            yield np.concatenate(windows)

    def disturbance_regressors(
        self, disturbances: DisturbanceModel, output: int, values: Sequence[Floats]
    ) -> Iterator[Floats]:
        """Compute regressors of additions to one output's disturbance, at a quarter of the cost of
        `regressors`.

        Parameters
        ----------
        disturbances : DisturbanceModel
            Disturbances and quantisation.
        output : int
            Number of the output.
        values : sequence of ndarray (n, s)
            For each flight the additions in each step, in the unit of the disturbed parameter.

        Yields
        ------
        ndarray (m b, s)
            For each flight, one row per output and block, one column per addition.
        """
        for linearised, added in zip(self.linearised_flights, values, strict=True):
            windows = []
            for blocks in linearised.blocks:
                drive = np.zeros((len(blocks.rows), blocks.transition.shape[1], added.shape[1]))
                for step, response in enumerate(blocks.part_input):
                    drive -= response[:, :, output, None] * added[blocks.rows + step][:, None, :]
                windows.append(self._filter_signals(linearised, blocks, disturbances, drive)[0])
            yield np.concatenate(windows)

    def _filter_signals(
        self,
        linearised: LinearisedFlight,
        blocks: Blocks,
        disturbances: DisturbanceModel,
        drive: Floats,
        measured: Floats | None = None,
    ) -> tuple[Floats, Floats]:
        """Filter s signals in one window of a flight. Shapes: `drive` (b, states, s), `measured` (b, m, s);
        returns `innovations` (m b, s), `log_variances` (m,).
        """
        if measured is None:
            measured = np.zeros((len(drive), self._outputs, drive.shape[2]))
        system = self.system(linearised, blocks, disturbances)
        innovations, log_variances = _kalman.filter(*system, drive, measured)
        return innovations.reshape(-1, drive.shape[2]), np.array(log_variances)

    def perturbed_residual(self, move: Floats | None = None) -> list[list[ModelErrors]]:
        """Predict, to first order, the errors of the model after a change of its parameters.

        Parameters
        ----------
        move : ndarray (f,), optional
            Change of the parameters; by default 0.

        Returns
        -------
        list of list of ModelErrors
            Errors in each window of each flight.
        """
        move = np.zeros(self.size) if move is None else move
        # Column 0 of a block holds the errors, the others their reduction per unit of each parameter.
        weights_of_columns = [np.concatenate(([1.0], -move[columns])) for columns in self.columns]
        return [
            [
                ((blocks.drive @ weights)[:, :, None], (blocks.measured @ weights)[:, :, None])
                for blocks in linearised.blocks
            ]
            for linearised, weights in zip(self.linearised_flights, weights_of_columns, strict=True)
        ]

    def system(
        self, linearised: LinearisedFlight, blocks: Blocks, disturbances: DisturbanceModel
    ) -> FilterSystem:
        """Assemble the linear system of the filter in one window of a flight."""
        return FilterSystem(
            blocks.transition,
            blocks.part_input,
            blocks.measurement,
            np.ascontiguousarray(blocks.variance * disturbances.quantisation),
            disturbances.autocorrelation(linearised.reference.step_s),
            disturbances.variance,
            self.model.initial_std**2,
        )

    def log_likelihoods(self, disturbance_models: Sequence[DisturbanceModel], errors: FlightErrors) -> Floats:
        """Compute the log-likelihood of each output's innovations under several disturbance models.

        Parameters
        ----------
        disturbance_models : sequence of DisturbanceModel
            The w disturbance models.
        errors : sequence of sequence of ModelErrors
            Errors of the model, from `perturbed_residual`.

        Returns
        -------
        ndarray (w, m)
            Log-likelihoods without their constant [nats].
        """
        jobs = [
            (linearised, blocks, window_errors, slice(low, low + _BATCH))
            for linearised, windows in zip(self.linearised_flights, errors, strict=True)
            for blocks, window_errors in zip(linearised.blocks, windows, strict=True)
            for low in range(0, len(disturbance_models), _BATCH)
        ]

        def window_nats(job: tuple[LinearisedFlight, Blocks, ModelErrors, slice]) -> Floats:
            """Log-likelihoods in one window under a batch of models, shape (batch, m)."""
            linearised, blocks, window_errors, batch = job
            models, step_s = disturbance_models[batch], linearised.reference.step_s
            nats = _kalman.log_likelihoods(
                *(blocks.transition, blocks.part_input, blocks.measurement, blocks.variance),
                np.array([model.autocorrelation(step_s) for model in models]),
                np.array([model.variance for model in models]),
                np.array([model.quantisation for model in models]),
                self.model.initial_std**2,
                *window_errors,
            )
            return nats + _repetition_correction_nats(linearised, blocks, models)

        total = np.zeros((len(disturbance_models), self._outputs))
        for job, nats in zip(jobs, parallel_map(window_nats, jobs), strict=True):
            total[job[3]] += nats
        return total


def _repetition_correction_nats(
    linearised: LinearisedFlight, blocks: Blocks, models: Sequence[DisturbanceModel]
) -> Floats:
    """Correct a window's log-likelihood for measurements that repeat one error. Returns shape (models, m).

    While an axis crosses its play, or is at rest, N measurements have the same error, of variance v. The
    filter treats them as N measurements with independent errors of variance N v, which give the same
    information. But their density must be that of one measurement: the other N - 1 get the density of
    independent, uniform rounding errors. Otherwise, a smaller variance would become more likely the longer a
    count stays the same, whatever the measurements are.
    """
    at_rest = linearised.at_rest[blocks.rows]
    if not (linearised.model.known_directions or at_rest.any()):
        # Without play and rest the variance is that of rounding, and each logarithm below is 0.
        return np.zeros((len(models), blocks.variance.shape[1]))
    rounding, repeats = linearised.variance[blocks.rows], linearised.repeats[blocks.rows]
    excess, dependent_share = blocks.variance / rounding - 1.0, 1.0 - 1.0 / repeats

    def nats(quantisation: Floats) -> Floats:
        """Correction under an estimated factor of the rounding variance; both of shape (m,)."""
        at_rest_factor = quantisation * blocks.variance / rounding
        factor = np.where(at_rest, at_rest_factor, 1.0 + quantisation * excess)
        return np.asarray(0.5 * (np.log(factor) * dependent_share).sum(axis=0))

    return np.stack([nats(model.quantisation) for model in models])
