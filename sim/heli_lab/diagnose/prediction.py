"""Free runs of a model over the flights, and their errors: what people understand of a model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from heli_host.arrays import Floats

from heli_lab.diagnose.candidate import Candidate
from heli_lab.estimation import Estimate
from heli_lab.estimation.long_run_variance import autocovariance, newey_west_variance
from heli_lab.identify import Fit, Problem, Record, solve
from heli_lab.identify.residual_noise import floored_mean_square
from heli_lab.identify.thresholds import LEAST_VARIANCE

_LONGEST_LAG_s: Final = 0.5
"""Lags of the autocovariance in the long-run variance: a quarter of a window. Longer ones are too noisy."""
_STEP_s: Final = 0.004
"""Step of the fits. With 10 ms, fits of effects that change within milliseconds, such as dry friction,
fail."""
_WINDOW_s: Final = 2.0
"""Length of the free runs."""


@dataclass(frozen=True)
class Errors:
    """Errors of a model on some flights, window by window; rows are means over 10 ms.

    Parameters
    ----------
    squares : ndarray (w, 3)
        Sum of squared errors of each window, in units of the quantisation's variance.
    rows : ndarray (w,)
        Rows of each window.
    effective_fraction : ndarray (3,)
        Effective over actual number of rows: variance over long-run variance of the errors, 0 to 1.
    prior_penalty : float
        -log prior of the rig's parameters: half the sum of squares of their distances from the prior means,
        in standard deviations of the priors.
    normalised : float
        Root mean square of every sample's error, in standard deviations of the quantisation.
    axis_normalised : ndarray (3,)
        The same of each axis.
    sigma_rad : ndarray (3,)
        Standard deviation of the quantisation of each axis.
    """

    squares: Floats
    rows: Floats
    effective_fraction: Floats
    prior_penalty: float
    normalised: float
    axis_normalised: Floats
    sigma_rad: Floats

    def neg2_log_likelihood_rows(self, squares: Floats, rows: Floats) -> Floats:
        """-2 log likelihood, up to a constant, shape (..., 3), for each of the `rows`, shape (...), of an
        axis with sums of squared errors `squares`, shape (..., 3): the logarithm of the variance, plus the
        mean square over it.

        Variances are those of `residual_noise.floored_mean_square`: where a model is wrong, its error in
        radians counts, and not the resolution of the axis' encoder.
        """
        mean = np.maximum(squares / rows[..., None], LEAST_VARIANCE)
        scale = floored_mean_square(mean, self.sigma_rad)
        result: Floats = np.log(scale) + mean / scale
        return result

    @property
    def neg2_log_likelihood(self) -> Floats:
        """The same of all windows together, shape (3,)."""
        return self.neg2_log_likelihood_rows(self.squares.sum(axis=0), self.rows.sum())

    @property
    def variance(self) -> Floats:
        """Mean square of each axis, shape (3,)."""
        result: Floats = np.maximum(self.squares.sum(axis=0) / self.rows.sum(), LEAST_VARIANCE)
        return result


@dataclass(frozen=True, eq=False)
class Prediction:
    """Free runs of a model whose parameters are known, and their errors.

    Parameters
    ----------
    candidates : tuple of Candidate
        Its effects, in the order in which they were found.
    fit : Fit
        Estimates with their covariance, and the windows of the flights fitted.
    held_out_fit : Fit or None
        The same model on the validation flights, only what differs from flight to flight estimated.
    train, held_out : Errors
        Errors on the flights fitted and on those held out; without the latter both are the same.
    """

    candidates: tuple[Candidate, ...]
    fit: Fit
    held_out_fit: Fit | None
    train: Errors
    held_out: Errors

    @property
    def ids(self) -> tuple[str, ...]:
        """Ids of its effects."""
        return tuple(candidate.id for candidate in self.candidates)


def predict(
    candidates: Sequence[Candidate],
    estimate: Estimate,
    train: Sequence[Record],
    held_out: Sequence[Record],
) -> Prediction:
    """Predict flights by free runs with the parameters of an estimate in innovations form.

    What differs from flight to flight, encoder zeros and a constant torque about each axis, is ruled by the
    free run itself: filtered innovations tell little of such constants.
    """
    fit = _free_run(estimate, train, own_calibration=True)
    held_out_fit = _free_run(estimate, held_out, own_calibration=False) if held_out else None
    errors_train = errors(fit)
    return Prediction(
        tuple(candidates),
        fit,
        held_out_fit,
        errors_train,
        errors(held_out_fit) if held_out_fit else errors_train,
    )


def _free_run(estimate: Estimate, records: Sequence[Record], own_calibration: bool) -> Fit:
    """Fit zeros, constant torques and initial states of `records`, everything else as estimated. With
    `own_calibration` these are the records of the estimate, and the result has its parameters and covariance.
    """
    parameter_vector = estimate.parameter_vector
    local = {
        parameter.quantity: parameter.prior
        for parameter in parameter_vector.free
        if parameter.record is not None
    }
    shared = {
        parameter.quantity: float(value)
        for parameter, value in zip(parameter_vector.free, estimate.theta, strict=True)
        if parameter.record is None
    }
    problem = Problem(
        parameter_vector.model,
        parameter_vector.rig,
        records,
        free=tuple(local),
        per_flight=tuple(local),
        window_s=_WINDOW_s,
        step_s=_STEP_s,
        priors=local,
        values=shared,
    )
    fit = solve(problem, robust=False, scatter=False, warm_start=True)
    if not own_calibration:
        return fit
    values = {
        (parameter.quantity, parameter.record): float(v)
        for parameter, v in zip(problem.free, fit.theta, strict=True)
    }
    theta = np.array(
        [
            v if parameter.record is None else values[parameter.quantity, parameter.record]
            for parameter, v in zip(parameter_vector.free, estimate.theta, strict=True)
        ]
    )
    low, high = parameter_vector.bounds
    at_bound = tuple(
        name
        for name, v, a, b in zip(parameter_vector.names, estimate.theta, low, high, strict=True)
        if v <= a or v >= b
    )
    return replace(
        fit,
        problem=problem.with_free(parameter_vector.free),
        theta=theta,
        covariance=estimate.covariance,
        information=np.asarray(
            np.linalg.inv(estimate.covariance) - np.diag(parameter_vector.std**-2.0), float
        ),
        at_bound=at_bound,
    )


def errors(fit: Fit) -> Errors:
    """Measure the errors of a fit on its flights, window by window."""
    problem = fit.problem
    squares, rows, means, slices, every = [], [], [], [], []
    place = 0
    for index, states in enumerate(fit.states):
        evaluation = problem.evaluation(index, fit.theta, states, fine=True, derivatives=False)
        grid = problem.block_grid(index, fit.theta)
        mean = evaluation.residual.reshape(grid.inputs.rows, grid.every, 3).mean(axis=1)
        every.append(evaluation.residual)
        means.append(mean)
        for window in grid.slices:
            squares.append((mean[window] ** 2).sum(axis=0))
            rows.append(window.stop - window.start)
            slices.append(slice(place + window.start, place + window.stop))
        place += len(mean)
        step_s = grid.inputs.step_s
    together = np.concatenate(means)
    covariance = autocovariance(together, slices, max(1, round(_LONGEST_LAG_s / step_s)))
    long_run = newey_west_variance(covariance)
    effective_fraction = np.clip(covariance[0] / np.maximum(long_run, 1e-12), 0.0, 1.0)
    samples = np.concatenate(every)
    return Errors(
        np.array(squares),
        np.array(rows, float),
        np.where(long_run > 0.0, effective_fraction, 1.0),
        _prior_penalty(fit),
        float(np.sqrt(np.mean(samples**2))),
        np.sqrt(np.mean(samples**2, axis=0)),
        problem.records[0].sigma_rad,
    )


def _prior_penalty(fit: Fit) -> float:
    problem = fit.problem
    effect_names = {name for effect in problem.model.effects for name in effect.priors}
    rig = np.array([parameter.quantity not in effect_names for parameter in problem.free], bool)
    off = ((fit.theta - problem.parameter_vector.mean) / problem.parameter_vector.std)[rig]
    return float(0.5 * (off @ off))
