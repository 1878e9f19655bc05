"""Innovations of flights: a Kalman filter of a model that is linearised along them.

The innovations and their derivatives give likelihood, score and Fisher information. The same filter gives
the smoothed disturbances (Harvey, section 3.6) and new reference trajectories.

Auxiliary residuals are score tests of a shock at every instant, by one backward pass of the smoother. For
each output, two shocks of its disturbance are tested in every measurement interval: a level shift, which
begins there and stays, and an impulse of one step (Harvey and Koopman, J. Bus. Econ. Stat. 10 (1992) 377; de
Jong and Penzer, J. Am. Stat. Assoc. 93 (1998) 796). Each shock is an additional state of the model without
variance. The smoother's adjoint of that state is the score of a shock at every instant, and the diagonal of
the adjoint's matrix is its information.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from heli_host.data.arrays import Floats, Integers

from heli_lab.fit import _kalman
from heli_lab.fit.grey_box import DisturbanceModel
from heli_lab.fit.linearised_flight import Blocks, LinearisedFlight
from heli_lab.fit.normal_equations import per_flight_columns
from heli_lab.fit.reference_trajectory import ReferenceTrajectory
from heli_lab.threads import parallel_map


@dataclass(frozen=True)
class Innovations:
    """Innovations of several flights: measured outputs minus the predictions of the Kalman filter.

    Parameters
    ----------
    flights : tuple of ndarray (b, 1 + k)
        One array per flight, in standard deviations. Column 0 holds the innovations. Each further column
        holds the reduction of the innovations per unit of one parameter. The m outputs of a block are in m
        consecutive rows.
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
        """Compute the Fisher information of the parameters, shape (f, f)."""
        information = np.zeros((self.size, self.size))
        for flight, columns in zip(self.flights, self.columns, strict=True):
            _, sensitivity = _innovations_and_reductions(flight)
            information[np.ix_(columns, columns)] += sensitivity.T @ sensitivity
        return information

    def score(self) -> Floats:
        """Compute the score, the derivatives of the log-likelihood by the parameters, shape (f,)."""
        score = np.zeros(self.size)
        for flight, columns in zip(self.flights, self.columns, strict=True):
            innovations, sensitivity = _innovations_and_reductions(flight)
            score[columns] += sensitivity.T @ innovations
        return score

    @cached_property
    def log_likelihoods(self) -> Floats:
        """Log-likelihood of each output's innovations [nats], without its constant, shape (m,)."""
        # This is the prediction error decomposition (Harvey, section 3.4).
        outputs = len(self.log_variances)
        squares = np.zeros(outputs)
        for flight in self.flights:
            innovations, _ = _innovations_and_reductions(flight)
            # One row per block, so that the sum is that of each output.
            squares = squares + np.square(innovations.reshape(-1, outputs)).sum(axis=0)
        return -0.5 * (squares + self.log_variances)

    def after(self, move: Floats) -> list[Floats]:
        """Predict, to first order, the innovations of each flight, shape (b,), after the parameters change by
        `move`, shape (f,).
        """
        moved = []
        for flight, columns in zip(self.flights, self.columns, strict=True):
            innovations, sensitivity = _innovations_and_reductions(flight)
            moved.append(innovations - sensitivity @ move[columns])
        return moved


def _innovations_and_reductions(flight: Floats) -> tuple[Floats, Floats]:
    """Return the innovations of a flight, shape (b,), and their reduction per unit of each parameter, shape
    (b, k).
    """
    return flight[:, 0], flight[:, 1:]


_BATCH: Final = 4
"""Number of disturbance models whose log-likelihoods are computed together, at the cost of one."""


class ModelErrors(NamedTuple):
    """Errors of a linearised model in one window of b blocks; s such signals are filtered together."""

    drive: Floats
    """(b, states, s): Change of the state's deviation over each block because of the error of the rates."""
    measured: Floats  # (b, m, s): Errors of the measured outputs


FlightErrors = Sequence[Sequence[ModelErrors]]
"""`ModelErrors` of each window of each flight."""


class FilterSystem(NamedTuple):
    """Linear system of the Kalman filter in one window of b blocks."""

    # Its fields are the leading arguments of the functions of `_kalman`; the signals follow. There are m + g
    # inputs, the disturbed parameters. Each has a fast and a slow Gauss-Markov state: first come all fast
    # ones, then all slow ones.

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
            """Filter one window; return its innovations, and its part of the outputs' log-variances, (m,)."""
            linearised, blocks = window
            innovations, log_variances = self._filter_signals(
                linearised, blocks, disturbances, blocks.drive, blocks.measured
            )
            (correction_nats,) = _repetition_correction_nats(linearised, blocks, [disturbances])
            # A log-likelihood has minus half the log-variances.
            return innovations, log_variances - 2.0 * correction_nats

        filtered = iter(parallel_map(filter_window, windows))
        flights, log_variances = [], np.zeros(self._outputs)
        for linearised in self.linearised_flights:
            # The results come in the order of the windows: the next ones are those of this flight.
            of_flight = [next(filtered) for _ in linearised.blocks]
            flights.append(np.concatenate([innovations for innovations, _ in of_flight]))
            for _, window_log_variances in of_flight:
                log_variances += window_log_variances
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
        # The filter returns outputs minus their prediction. With the negative drive, this is what the signal
        # takes off the innovations.
        for linearised, (rates, outputs) in zip(self.linearised_flights, signals, strict=True):
            windows = []
            for blocks, drive in zip(linearised.blocks, linearised.over_blocks(rates), strict=True):
                measured = None if outputs is None else outputs[blocks.rows]
                reductions, _ = self._filter_signals(linearised, blocks, disturbances, -drive, measured)
                windows.append(reductions)
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
        # `part_input` is the response at a block's end to 1 in each of its steps; its first inputs are the
        # disturbances of the outputs. A regressor is a reduction of the innovation, hence the minus. Nothing
        # is propagated over the steps, hence the cost.
        for linearised, added in zip(self.linearised_flights, values, strict=True):
            windows = []
            for blocks in linearised.blocks:
                # Shape (blocks, states, s): `response` has (blocks, states, inputs), `added` (steps, s).
                drive = np.zeros((len(blocks.rows), blocks.transition.shape[1], added.shape[1]))
                for step, response in enumerate(blocks.part_input):
                    drive -= response[:, :, output, None] * added[blocks.rows + step, None]
                reductions, _ = self._filter_signals(linearised, blocks, disturbances, drive)
                windows.append(reductions)
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
                ModelErrors((blocks.drive @ weights)[:, :, None], (blocks.measured @ weights)[:, :, None])
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
                blocks.transition,
                blocks.part_input,
                blocks.measurement,
                blocks.variance,
                np.array([model.autocorrelation(step_s) for model in models]),
                np.array([model.variance for model in models]),
                np.array([model.quantisation for model in models]),
                self.model.initial_std**2,
                *window_errors,
            )
            return nats + _repetition_correction_nats(linearised, blocks, models)

        total = np.zeros((len(disturbance_models), self._outputs))
        for (*_, batch), nats in zip(jobs, parallel_map(window_nats, jobs), strict=True):
            total[batch] += nats
        return total


def _repetition_correction_nats(
    linearised: LinearisedFlight, blocks: Blocks, models: Sequence[DisturbanceModel]
) -> Floats:
    """Correct a window's log-likelihood for measurements that repeat one error. Returns shape (models, m)."""
    # While an axis crosses its play, or is at rest, N measurements have the same error, of variance v. The
    # filter treats them as N measurements with independent errors of variance N v, which give the same
    # information. But their density must be that of one measurement: the other N - 1 get the density of
    # independent, uniform rounding errors. Otherwise, a smaller variance would become more likely the longer
    # a count stays the same, whatever the measurements are.
    at_rest = linearised.at_rest[blocks.rows]
    if not (linearised.model.known_directions or at_rest.any()):
        # Without play and rest the variance is that of rounding, and each logarithm below is 0.
        return np.zeros((len(models), blocks.variance.shape[1]))
    rounding, repeats = linearised.variance[blocks.rows], linearised.repeats[blocks.rows]
    # Variance by the play, in variances of the rounding; and (N - 1) / N of a measurement, which is the share
    # that gets the density of rounding errors.
    excess, dependent_share = blocks.variance / rounding - 1.0, 1.0 - 1.0 / repeats

    def nats(quantisation: Floats) -> Floats:
        """Correction under an estimated factor of the rounding variance; both of shape (m,)."""
        at_rest_factor = quantisation * blocks.variance / rounding
        factor = np.where(at_rest, at_rest_factor, 1.0 + quantisation * excess)
        return np.asarray(0.5 * (np.log(factor) * dependent_share).sum(axis=0))

    return np.stack([nats(model.quantisation) for model in models])


class SmoothedDisturbances(NamedTuple):
    """Disturbances of one flight, given all of its measurements.

    Parameters
    ----------
    t_s : ndarray (k,)
        Times since the first sample of the flight [s].
    values : ndarray (k, m)
        Sum of the fast and the slow disturbance of each output, in the unit of the disturbed parameter:
        torques in N m, if these are disturbed.
    std : ndarray (k, m)
        Standard error of each sum.
    """

    t_s: Floats
    values: Floats
    std: Floats


def smoothed_disturbances(
    filtered: InnovationsModel, disturbances: DisturbanceModel, *, block_means: bool = False
) -> list[SmoothedDisturbances]:
    """Estimate the disturbances given each whole flight, by the fixed-interval smoother.

    Parameters
    ----------
    filtered : InnovationsModel
        The model along the flights.
    disturbances : DisturbanceModel
        Disturbances and quantisation.
    block_means : bool
        Whether to return the mean over each block of steps. Otherwise, the values are those at the first step
        of each block, from which a fast disturbance decays within the block.

    Returns
    -------
    list of SmoothedDisturbances
        Those of each flight.
    """
    result = []
    outputs = len(filtered.model.outputs)
    for linearised, signals in zip(filtered.linearised_flights, filtered.perturbed_residual(), strict=True):
        times, values, errors = [], [], []
        for blocks, (drive, measured) in zip(linearised.blocks, signals, strict=True):
            system = filtered.system(linearised, blocks, disturbances)
            mean, variance = _kalman.smooth(*system, drive, measured)
            # Columns: states of the model, then the fast disturbances of all inputs, then the slow ones. The
            # outputs' disturbances are the first inputs.
            states, inputs = blocks.transition.shape[1], blocks.part_input.shape[3]
            fast, slow = (slice(first, first + outputs) for first in (states, states + inputs))
            times.append(linearised.nodes.t_s[blocks.rows])
            # Share of a disturbance at the first step of a block that is the mean over the steps.
            steps = np.arange(len(blocks.part_input) if block_means else 1)
            shares = (system.autocorrelation[:, None] ** steps).mean(axis=1)
            fast_share, slow_share = shares[:outputs], shares[inputs : inputs + outputs]
            values.append(fast_share * mean[:, fast] + slow_share * mean[:, slow])
            errors.append(np.sqrt(fast_share**2 * variance[:, fast] + slow_share**2 * variance[:, slow]))
        result.append(
            SmoothedDisturbances(np.concatenate(times), np.concatenate(values), np.concatenate(errors))
        )
    return result


def refiltered(filtered: InnovationsModel, disturbances: DisturbanceModel) -> list[ReferenceTrajectory]:
    """Estimate the reference trajectories again, now with the model's equations and its disturbances.

    Unlike the filter of the likelihood, this filter takes a measurement in every step.

    Parameters
    ----------
    filtered : InnovationsModel
        The model along the present references.
    disturbances : DisturbanceModel
        Disturbances and quantisation.

    Returns
    -------
    list of ReferenceTrajectory
        New reference of each flight.
    """
    references = []
    for linearised in filtered.linearised_flights:
        reference = linearised.reference
        predicted, corrected = reference.predicted.copy(), reference.filtered.copy()
        steps, followed = linearised.steps, filtered.model.followed
        disturbance_input = steps.Gamma @ steps.by_disturbance
        for window, rows in zip(linearised.windows, reference.windows, strict=True):
            before, after = _kalman.track(
                steps.Phi[window],
                # A block of one part, the step itself.
                np.ascontiguousarray(disturbance_input[window])[None],
                steps.C[window],
                np.ascontiguousarray(linearised.variance[window] * disturbances.quantisation),
                disturbances.autocorrelation(reference.step_s),
                disturbances.variance,
                filtered.model.initial_std**2,
                steps.drive[window],
                steps.output_error[window],
            )
            # The filter's state is the deviation from the reference; effects' states are not kept.
            predicted[rows] = reference.predicted[rows] + before[:, :followed]
            corrected[rows] = reference.predicted[rows] + after[:, :followed]
        references.append(reference.refiltered(predicted, corrected))
    return references


_LEVEL, _IMPULSE = 1.0, 0.0
"""Autocorrelation of the two shocks over a step: a level stays, an impulse vanishes."""


@dataclass(frozen=True)
class ShockScores:
    """Score tests of one kind of shock in one flight, with all parameters and disturbances fixed.

    Parameters
    ----------
    score : ndarray (k, m)
        Derivative of the log-likelihood to a shock of each output's disturbance at each instant.
    information : ndarray (k, m)
        Fisher information of that shock; 0 if nothing is measured afterwards.
    """

    score: Floats
    information: Floats

    @property
    def t_statistic(self) -> Floats:
        """Statistic of a t test of the shock, shape (k, m): standard normal if there is none."""
        return self._score_over(np.sqrt(np.maximum(self.information, 0.0)))

    @property
    def size(self) -> Floats:
        """Most likely size of the shock, in the unit of the disturbed parameter, shape (k, m)."""
        return self._score_over(self.information)

    def _score_over(self, divisor: Floats) -> Floats:
        """Divide the score by a `divisor`, shape (k, m); the result is 0 if the divisor is 0."""
        return np.divide(self.score, divisor, out=np.zeros_like(self.score), where=divisor > 0.0)


@dataclass(frozen=True)
class AuxiliaryResiduals:
    """Score tests of shocks at every instant of one flight.

    Parameters
    ----------
    t_s : ndarray (k,)
        Instants since the flight's first sample: the beginnings of the measurement intervals.
    level, impulse : ShockScores
        A torque that begins at an instant and stays, and one during the step that begins there.
    """

    t_s: Floats
    level: ShockScores
    impulse: ShockScores

    def largest_level(self) -> tuple[float, float]:
        """Find the most significant level shift of any output.

        Returns
        -------
        t_s : float
            Instant of the shift [s].
        t_statistic : float
            Absolute t statistic of the shift.
        """
        statistic = np.abs(self.level.t_statistic).max(axis=1)
        largest = int(statistic.argmax())
        return float(self.t_s[largest]), float(statistic[largest])


def auxiliary_residuals(
    filtered: InnovationsModel, disturbances: DisturbanceModel, errors: FlightErrors | None = None
) -> list[AuxiliaryResiduals]:
    """Test a shock of each output's disturbance at every instant of each flight.

    Parameters
    ----------
    filtered : InnovationsModel
        The model along the flights.
    disturbances : DisturbanceModel
        Disturbances and quantisation.
    errors : sequence of sequence of ModelErrors, optional
        Errors of the model from `InnovationsModel.perturbed_residual`; by default those at its parameters.

    Returns
    -------
    list of AuxiliaryResiduals
        One per flight.
    """
    if errors is None:
        errors = filtered.perturbed_residual()
    outputs, inputs = len(filtered.model.outputs), len(filtered.model.disturbed)
    # Columns of the shock states: a level of each input, then an impulse of each. The outputs' disturbances
    # are the first inputs; gains follow.
    level, impulse = slice(0, outputs), slice(inputs, inputs + outputs)
    results = []
    for linearised, windows in zip(filtered.linearised_flights, errors, strict=True):
        times, scores, information = [], [], []
        for blocks, (drive, measured) in zip(linearised.blocks, windows, strict=True):
            system = _with_shock_states(filtered.system(linearised, blocks, disturbances), inputs)
            state_scores, state_information = _kalman.shock_scores(*system, drive, measured)
            times.append(linearised.nodes.t_s[blocks.rows])
            # The shock states are the last ones.
            scores.append(state_scores[:, -2 * inputs :])
            information.append(state_information[:, -2 * inputs :])
        all_scores, all_information = np.concatenate(scores), np.concatenate(information)
        results.append(
            AuxiliaryResiduals(
                t_s=np.concatenate(times),
                level=ShockScores(all_scores[:, level], all_information[:, level]),
                impulse=ShockScores(all_scores[:, impulse], all_information[:, impulse]),
            )
        )
    return results


def _with_shock_states(system: FilterSystem, inputs: int) -> FilterSystem:
    """Append a level and an impulse of each input to a filter's states, both without variance."""
    return system._replace(
        autocorrelation=np.append(system.autocorrelation, np.repeat((_LEVEL, _IMPULSE), inputs)),
        disturbance_variance=np.append(system.disturbance_variance, np.zeros(2 * inputs)),
    )
