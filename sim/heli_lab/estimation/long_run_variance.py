"""Long-run (HAC) variance of an autocorrelated series."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from heli_host.arrays import Floats


def autocovariance(residual: Floats, windows: Sequence[slice], lags: int) -> Floats:
    """Mean lagged product of a residual about zero, shape (lags + 1, a), pairs within windows only: sums of
    products over the number of all rows, which keeps the spectrum positive.

    Parameters
    ----------
    residual : ndarray (m, a)
        Residuals, one column an axis.
    windows : sequence of slice
        Rows of each window.
    lags : int
        Largest lag, in rows.
    """
    total = np.zeros((lags + 1, residual.shape[1]))
    for window in windows:
        part = residual[window]
        size = 1 << int(2 * len(part) - 1).bit_length()
        power = np.abs(np.fft.rfft(part, size, axis=0)) ** 2
        products = np.fft.irfft(power, size, axis=0)
        lag_count = min(lags + 1, len(part))
        total[:lag_count] += products[:lag_count]
    return np.asarray(total / max(1, sum(window.stop - window.start for window in windows)))


def newey_west_variance(covariance: Floats) -> Floats:
    """Long-run variance of a series by Bartlett's weights (Newey and West, Econometrica 55, 1987, eq. 5).

    Parameters
    ----------
    covariance : ndarray (lags + 1, a)
        Autocovariance of each column, as `autocovariance` returns it.

    Returns
    -------
    ndarray (a,)
        In the unit of the autocovariance; not negative but for rounding.
    """
    taper = 1.0 - np.arange(len(covariance)) / len(covariance)
    return np.asarray(2.0 * (taper[:, None] * covariance).sum(axis=0) - covariance[0])
