"""Estimate the long-run (HAC) variance of an autocorrelated series: that of a sum, divided by its length."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from heli_host.data.arrays import Floats


def autocovariance(residual: Floats, windows: Sequence[slice], lags: int) -> Floats:
    """Estimate the autocovariance of residuals about zero, from pairs of rows in the same window. Shapes:
    `residual` (m, a); returns (lags + 1, a).

    At each lag, the sum of products is divided by the number of all rows, not of all pairs. This keeps the
    spectrum positive.
    """
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
