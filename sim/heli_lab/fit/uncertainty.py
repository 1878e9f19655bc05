"""Noise of a fit's residuals, the standard errors that follow, and parameters that flights do not inform."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats

from heli_lab.fit.problem import Problem
from heli_lab.fit.thresholds import (
    COMBINATION_WEIGHT,
    DITHER_PHASES,
    GROSS,
    LONGEST_LAG_S,
    MIN_SHARE,
    OUTLIER,
    UNINFORMED,
)


def autocovariance(residual: Floats, windows: Sequence[slice], lags: int) -> Floats:
    """Estimate the autocovariance of residuals about zero, from pairs of rows in the same window. Shapes:
    `residual` (m, a); returns (lags + 1, a).
    """
    # At each lag, the sum of products is divided by the number of all rows, not of all pairs. This keeps the
    # spectrum positive.
    sums = np.zeros((lags + 1, residual.shape[1]))
    for window in windows:
        rows = residual[window]
        # The inverse transform of the power spectrum is the sum of products at each lag. Zeros are appended
        # so that the end of the window is not paired with its beginning.
        fft_rows = 1 << int(2 * len(rows) - 1).bit_length()
        power = np.abs(np.fft.rfft(rows, fft_rows, axis=0)) ** 2
        products = np.fft.irfft(power, fft_rows, axis=0)
        lag_count = min(lags + 1, len(rows))
        sums[:lag_count] += products[:lag_count]
    return np.asarray(sums / max(1, sum(window.stop - window.start for window in windows)))


def newey_west_variance(covariance: Floats) -> Floats:
    """Estimate the long-run variance of a series with Bartlett's weights (Newey and West, Econometrica 55,
    1987, eq. 5). Shapes: `covariance` (lags + 1, a); returns (a,).
    """
    taper = 1.0 - np.arange(len(covariance)) / len(covariance)
    return np.asarray(2.0 * (taper[:, None] * covariance).sum(axis=0) - covariance[0])


def quantisation_scatter(
    problem: Problem,
    theta: Floats,
    states: Sequence[Floats],
    variance: Sequence[Floats],
    weights: Sequence[Floats],
    covariance: Floats,
) -> Floats:
    """Simulate how quantisation scatters the estimates, by dither; return standard deviations, shape (f,).
    Shapes: `theta` (f,), `states` (w, states), `covariance` (f, f).
    """
    # Quantisation errors are not white noise: while an axis hovers, the same count stays for seconds, and its
    # error is the same in every window. Therefore the predicted angles are quantised again, many times, with
    # the counts shifted by random phases. The scatter of the estimates under these errors is computed to
    # first order, and that of the priors is added.
    random = np.random.default_rng(0)
    scores = np.zeros((DITHER_PHASES, len(theta)))
    state_count = problem.state_count
    for index, record in enumerate(problem.records):
        grid = problem.grid(index, fine=True, theta=theta)
        parameters = problem.parameters(theta, index)
        angles_rad, jacobian = problem.kernel.jacobian(grid.inputs, states[index], parameters)
        counts = angles_rad / record.count_rad
        phases = random.uniform(0.0, 1.0, (DITHER_PHASES, 1, 3))
        for window, steps in enumerate(grid.slices):
            # Quantisation errors in their standard deviations, 1 / sqrt(12) of a count; shape (phases, steps,
            # 3).
            shifted = counts[None, steps] + phases
            errors = (np.round(shifted) - shifted) * math.sqrt(12.0)
            scale = np.sqrt(weights[index][window] / variance[index])[:, None]
            weighted_jacobian = jacobian[steps] / record.sigma_rad[:, None] * scale
            # Indices: phase p, step t, axis a, columns i and j of the Jacobian. A product of matrices would
            # start threads of the linear algebra, which cost more here than they save.
            normal = np.einsum("tai,taj->ij", weighted_jacobian[:, :, :state_count], weighted_jacobian)
            gradient = np.einsum("pta,tai->pi", errors * scale[:, 0], weighted_jacobian)
            # Eliminate the initial state of the window (Schur complement); the parameters' score remains.
            response = np.linalg.pinv(normal[:, :state_count], hermitian=True) @ normal[:, state_count:]
            score = gradient[:, state_count:] - gradient[:, :state_count] @ response
            scores[:, problem.columns[index]] += score
    prior_information = np.diag(1.0 / problem.parameter_vector.std**2)
    # A Gauss-Newton step is covariance @ score, so that this is the covariance of the steps.
    scatter = covariance @ (scores.T @ scores / DITHER_PHASES + prior_information) @ covariance
    return np.sqrt(np.diag(scatter))


def timing_variance(problem: Problem) -> Floats:
    """Return the variance to add to each estimated time, such as a lag, because of the log's sample time.
    Returns shape (f,).
    """
    # A row of a log holds the voltage of its tick, but not the moment within the tick at which the motors got
    # it. Simulators differ in this moment by half a tick, while a fit finds the time to a fiftieth of a tick:
    # its standard error alone would be too small.
    effect_names = {name for effect in problem.model.effects for name in effect.priors}
    tick_s = max(record.step_s for record in problem.records)
    is_time = [parameter.unit == "s" and parameter.quantity in effect_names for parameter in problem.free]
    return np.where(is_time, tick_s**2 / 12.0, 0.0)


@dataclass(frozen=True)
class Combination:
    """A direction in parameter space that the flights hardly identify.

    Parameters
    ----------
    change : dict of float
        By parameter: its change if the combination changes by one posterior standard deviation, in the
        parameter's unit. The parameter with the largest change comes first; those that hardly change are
        left out.
    std_over_prior : float
        Posterior standard deviation of the combination over its prior one; 1 without any information.
    """

    change: dict[str, float]
    std_over_prior: float


def combinations(names: Sequence[str], information: Floats, prior_std: Floats) -> list[Combination]:
    """Find the combinations of parameters that the flights determine worse than the priors, worst first.
    Directions along a single parameter are among them.

    Parameters
    ----------
    names : sequence of str
        Names of the free parameters.
    information : ndarray (f, f)
        Fisher information of the flights alone.
    prior_std : ndarray (f,)
        Standard deviations of the priors.
    """
    # In units of the priors' standard deviations, a prior has the information 1 in every direction.
    whitened = information * np.outer(prior_std, prior_std)
    informations, directions = np.linalg.eigh(0.5 * (whitened + whitened.T))
    result = []
    for flight_information, direction in zip(np.maximum(informations, 0.0), directions.T, strict=True):
        if flight_information >= 1.0:
            break  # eigenvalues ascend: the flights determine this and all further directions better
        std_over_prior = 1.0 / math.sqrt(1.0 + flight_information)
        size = np.abs(direction)
        order = [i for i in np.argsort(-size) if size[i] >= COMBINATION_WEIGHT * size.max()]
        # The first parameter increases; an eigenvector has either sign.
        sign = math.copysign(1.0, direction[order[0]])
        change = {names[i]: float(sign * direction[i] * prior_std[i] * std_over_prior) for i in order}
        result.append(Combination(change, std_over_prior))
    return result


def uninformed_parameters(names: Sequence[str], covariance: Floats, prior_std: Floats) -> list[str]:
    """Names of the parameters that the flights do not inform: the standard error is over 90 % of the prior's
    standard deviation.

    Parameters
    ----------
    names : sequence of str
        Names of the free parameters.
    covariance : ndarray (f, f)
        Covariance of the estimates.
    prior_std : ndarray (f,)
        Standard deviations of the priors.
    """
    shares = np.sqrt(np.diag(covariance)) / prior_std
    return [name for name, share in zip(names, shares, strict=True) if share > UNINFORMED]


_QUANTISATION_ONLY: Final = 2.0
"""Mean square of the residuals, in variances of the quantisation, up to which nothing counts as model error.
It is 1 for a true model; a count that stays for several samples gives more."""


def long_run_variance(residual: Floats, windows: Sequence[slice], step_s: float) -> Floats:
    """Estimate the long-run (HAC) variance of the residuals: the variance of a sum of many successive
    residuals, divided by their number. Shapes: `residual` (m, 3); returns (3,).
    """
    # Parameters of the rig change the prediction slowly. Their standard errors therefore depend not on the
    # residuals' variance but on their spectral density at low frequencies (Newey and West, with Bartlett's
    # weights). This density is larger if a count stays for several samples, and much larger if the model is
    # wrong.
    lags = max(1, round(LONGEST_LAG_S / step_s))
    covariance = autocovariance(residual, windows, lags)
    return np.asarray(np.maximum(1.0, np.maximum(covariance[0], newey_west_variance(covariance))))


def floor_axes(variance: Floats, mean_square: Floats, sigma_rad: Floats) -> Floats:
    """Raise small variances, so that a wrong model is not fitted to one axis alone. Shapes: `variance` (...,
    3), `mean_square` (..., 3), `sigma_rad` (3,); returns (..., 3).
    """
    # The fit divides the squared residuals of each axis by their variance. If the model is wrong, this
    # favours travel, in which free initial states can hide the error, and neglects pitch, which shows it. On
    # measured flights, the error of pitch doubled. Therefore the variance of each axis, in rad^2, is at least
    # `MIN_SHARE` of the largest variance that quantisation does not explain.
    # Share of an axis' variance that counts as model error: none up to twice the quantisation.
    model_error_share = np.maximum(0.0, 1.0 - _QUANTISATION_ONLY / np.maximum(mean_square, 1e-12))
    model_error_rad2 = variance * model_error_share * sigma_rad**2
    min_variance_rad2 = MIN_SHARE * np.max(model_error_rad2, axis=-1, keepdims=True)
    return np.asarray(np.maximum(variance, min_variance_rad2 / sigma_rad**2))


def window_weights(residual: Floats, windows: Sequence[slice], variance: Floats) -> Floats:
    """Compute robust weights of the windows, shape (w,), so that a few disturbed windows do not decide a fit.
    Shapes: `residual` (m, 3), `variance` (3,).
    """
    # The weight is 1 for a window with a usual error. If the rms error exceeds `OUTLIER` times the median,
    # the weight reduces it to that limit. Beyond `GROSS` times the median, the weight falls to 0.
    rms = np.sqrt([np.mean(residual[window] ** 2 / variance) for window in windows])
    relative_rms = np.maximum(rms, 1e-12) / max(float(np.median(rms)), 1e-12)
    outlier_factor = np.minimum(1.0, OUTLIER / relative_rms) ** 2
    return np.asarray(outlier_factor * np.minimum(1.0, GROSS / relative_rms) ** 2)


def normalised(residual: Floats) -> float:
    """Root mean square of a `residual`, in standard deviations of the quantisation: 1 if it is quantisation
    alone.
    """
    return float(np.sqrt(np.mean(residual**2)))


def correlation_at(residual: Floats, windows: Sequence[slice], lag: int) -> tuple[Floats, float]:
    """Compute the autocorrelation of the residuals at one lag, shape (3,), and its bound for white residuals,
    three standard errors. Shapes: `residual` (m, 3).
    """
    covariance = autocovariance(residual, windows, lag)
    # Pairs of residuals that do not overlap: only these are independent.
    pairs = sum(max(0, window.stop - window.start - lag) for window in windows) / lag
    correlation: Floats = covariance[lag] / np.maximum(covariance[0], 1e-30)
    return correlation, 3.0 / float(np.sqrt(max(pairs, 1.0)))
