"""Noise of the residuals: variance, autocorrelation, outlying windows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from heli_host.arrays import Floats

from heli_lab.estimation.long_run_variance import autocovariance, newey_west_variance
from heli_lab.identify.thresholds import GROSS, LONGEST_LAG_S, MIN_SHARE, OUTLIER

_QUANTISATION_ONLY: Final = 2.0
"""Mean square of the residuals, in variances of the quantisation, up to which nothing counts as model error.
It is 1 for a true model; a count that stays for several samples gives more."""


def long_run_variance(residual: Floats, windows: Sequence[slice], step_s: float) -> Floats:
    """Long-run (HAC) variance: that of a sum over many neighbouring residuals, for each residual in it; a
    factor of at least 1 on the variance, shape (3,).

    Parameters of the rig move the prediction slowly. Their standard errors therefore depend not on the
    residuals' variance but on their spectral density at low frequencies (Newey and West, with Bartlett's
    weights). It is larger if a count stays for several samples, and much larger if the model is wrong.

    Parameters
    ----------
    residual : ndarray (m, 3)
        Residuals in standard deviations of the quantisation.
    windows : sequence of slice
        Rows of each window.
    step_s : float
        Time from one row to the next.
    """
    lags = max(1, round(LONGEST_LAG_S / step_s))
    covariance = autocovariance(residual, windows, lags)
    return np.asarray(np.maximum(1.0, np.maximum(covariance[0], newey_west_variance(covariance))))


def floor_axes(variance: Floats, mean_square: Floats, sigma_rad: Floats) -> Floats:
    """Bound the axes' variances, shape (..., 3), from below, so that a wrong model is not fitted to one axis
    alone; unchanged where only quantisation is left.

    If a model is wrong, dividing each axis by its own error favours the axis in which free initial states can
    hide the error (travel). It neglects the axis that shows the error (pitch): on measured flights the error
    of pitch doubled. Therefore the variance of each axis, in rad^2, is at least half of the largest variance
    that quantisation does not explain.

    Parameters
    ----------
    variance : ndarray (..., 3)
        As `long_run_variance` returns it.
    mean_square : ndarray (..., 3)
        Mean square of the residuals, in variances of the quantisation.
    sigma_rad : ndarray (3,)
        Standard deviation of the quantisation of each axis [rad].
    """
    # Share of an axis' variance that counts as model error: none up to twice the quantisation.
    model_error_share = np.maximum(0.0, 1.0 - _QUANTISATION_ONLY / np.maximum(mean_square, 1e-12))
    model_error_rad2 = variance * model_error_share * sigma_rad**2
    min_variance_rad2 = MIN_SHARE * np.max(model_error_rad2, axis=-1, keepdims=True)
    return np.asarray(np.maximum(variance, min_variance_rad2 / sigma_rad**2))


def window_weights(residual: Floats, windows: Sequence[slice], variance: Floats) -> Floats:
    """Robust weights, shape (w,), which keep a few disturbed windows from deciding the fit.

    The weight is 1 for a window like the others. It is less for a window whose rms is over `OUTLIER` times
    the median, so that the window counts as one at that limit. Far beyond `GROSS` times the median it is
    nearly 0.

    Parameters
    ----------
    residual : ndarray (m, 3)
        Residuals.
    windows : sequence of slice
        Rows of each window.
    variance : ndarray (3,)
        Variance of each axis by which the fit divides its squared residuals.
    """
    rms = np.sqrt([np.mean(residual[window] ** 2 / variance) for window in windows])
    times = np.maximum(rms, 1e-12) / max(float(np.median(rms)), 1e-12)
    return np.asarray(np.minimum(1.0, OUTLIER / times) ** 2 * np.minimum(1.0, GROSS / times) ** 2)


def normalised(residual: Floats) -> float:
    """Root mean square of `residual`, in standard deviations of the quantisation: 1 when only that
    is left.
    """
    return float(np.sqrt(np.mean(residual**2)))


def correlation_at(residual: Floats, windows: Sequence[slice], lag: int) -> tuple[Floats, float]:
    """Autocorrelation at one lag, and its bound for white residuals.

    Parameters
    ----------
    residual : ndarray (m, 3)
        Residuals.
    windows : sequence of slice
        Rows of each window.
    lag : int
        Lag in rows.

    Returns
    -------
    correlation : ndarray (3,)
        Autocorrelation of each axis.
    bound : float
        Three standard deviations of it for white residuals taken every `lag` rows.
    """
    covariance = autocovariance(residual, windows, lag)
    pairs = sum(max(0, window.stop - window.start - lag) for window in windows) / lag
    result: Floats = covariance[lag] / np.maximum(covariance[0], 1e-30)
    return result, 3.0 / float(np.sqrt(max(pairs, 1.0)))
