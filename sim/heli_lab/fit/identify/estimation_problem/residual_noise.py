"""Measure the noise of a fit's residuals: its variance and autocorrelation, and outlying windows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats

from heli_lab.fit.estimation.long_run_variance import autocovariance, newey_west_variance
from heli_lab.fit.identify.thresholds import GROSS, LONGEST_LAG_S, MIN_SHARE, OUTLIER

_QUANTISATION_ONLY: Final = 2.0
"""Mean square of the residuals, in variances of the quantisation, up to which nothing counts as model error.
It is 1 for a true model; a count that stays for several samples gives more."""


def long_run_variance(residual: Floats, windows: Sequence[slice], step_s: float) -> Floats:
    """Estimate the long-run (HAC) variance of the residuals: the variance of a sum of many successive
    residuals, divided by their number. Shapes: `residual` (m, 3); returns (3,).

    Parameters of the rig change the prediction slowly. Their standard errors therefore depend not on the
    residuals' variance but on their spectral density at low frequencies (Newey and West, with Bartlett's
    weights). This density is larger if a count stays for several samples, and much larger if the model is
    wrong.
    """
    lags = max(1, round(LONGEST_LAG_S / step_s))
    covariance = autocovariance(residual, windows, lags)
    return np.asarray(np.maximum(1.0, np.maximum(covariance[0], newey_west_variance(covariance))))


def floor_axes(variance: Floats, mean_square: Floats, sigma_rad: Floats) -> Floats:
    """Raise small variances, so that a wrong model is not fitted to one axis alone. Shapes: `variance` (...,
    3), `mean_square` (..., 3), `sigma_rad` (3,); returns (..., 3).

    The fit divides the squared residuals of each axis by their variance. If the model is wrong, this favours
    travel, in which free initial states can hide the error, and neglects pitch, which shows it. On measured
    flights, the error of pitch doubled. Therefore the variance of each axis, in
    rad^2, is at least `MIN_SHARE` of the largest variance that quantisation does not explain.
    """
    # Share of an axis' variance that counts as model error: none up to twice the quantisation.
    model_error_share = np.maximum(0.0, 1.0 - _QUANTISATION_ONLY / np.maximum(mean_square, 1e-12))
    model_error_rad2 = variance * model_error_share * sigma_rad**2
    min_variance_rad2 = MIN_SHARE * np.max(model_error_rad2, axis=-1, keepdims=True)
    return np.asarray(np.maximum(variance, min_variance_rad2 / sigma_rad**2))


def window_weights(residual: Floats, windows: Sequence[slice], variance: Floats) -> Floats:
    """Compute robust weights of the windows, shape (w,), so that a few disturbed windows do not decide a
    fit. Shapes: `residual` (m, 3), `variance` (3,).

    The weight is 1 for a window with a usual error. If the rms error exceeds `OUTLIER` times the median, the
    weight reduces it to that limit. Beyond `GROSS` times the median, the weight falls to 0.
    """
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
    """Compute the autocorrelation of the residuals at one lag, and its bound for white residuals. Shapes:
    `residual` (m, 3); returns `correlation` (3,).
    """
    covariance = autocovariance(residual, windows, lag)
    pairs = sum(max(0, window.stop - window.start - lag) for window in windows) / lag
    result: Floats = covariance[lag] / np.maximum(covariance[0], 1e-30)
    return result, 3.0 / float(np.sqrt(max(pairs, 1.0)))
