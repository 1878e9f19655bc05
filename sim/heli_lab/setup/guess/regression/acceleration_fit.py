"""Regress the acceleration of one axis on one signal that may drive it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.data.arrays import Booleans, Floats

from heli_lab.setup.guess import thresholds

_MIN_REGRESSION_ROWS: Final = 20
"""Smallest number of rows of a regression; it has four coefficients."""
_DECIMATION: Final = 10
"""The regressions use every tenth row: 10 Hz samples all that the low-pass filter leaves."""


@dataclass(frozen=True)
class RegressionFit:
    """Regression of an axis' acceleration on the signal that may drive it."""

    log_likelihood_ratio: float
    """Log-likelihood with this signal minus log-likelihood with the axis' deflection and rate only [nats]."""
    gain: float  # Acceleration per unit of the signal, with its sign
    lag_s: float = 0.0  # Delay from the signal to the acceleration [s]
    lag_range_s: tuple[float, float] = (-math.inf, math.inf)
    """Shortest and longest delay that are not decisively less likely [s]."""
    no_rotor_lag_nats: float = 0.0
    """Log-likelihood without a rotor lag minus log-likelihood with the best lag [nats]; 0 if not computed."""


def regress_acceleration(
    acceleration: Floats,
    axis_terms: tuple[Floats, Floats],
    cause: Floats,
    stiffness: tuple[float, float],
    rows: Booleans,
) -> RegressionFit:
    """Ridge regression of an axis' acceleration on a cause, with stiffness, damping and a constant. Shapes:
    `acceleration` (n,), `axis_terms` (n,), `cause` (n,), `rows` (n,).
    """
    deflection, rate, response, regressor = (
        signal[rows][::_DECIMATION] for signal in (*axis_terms, acceleration, cause)
    )
    y = response - stiffness[0] * deflection
    if len(y) < _MIN_REGRESSION_ROWS:
        return RegressionFit(0.0, 0.0)
    columns = np.column_stack([deflection, rate, np.ones(len(y)), regressor])
    # Columns of unit deviation keep the normal equations well conditioned; the constant column has none.
    scale = np.maximum(columns.std(axis=0), 1e-12)
    scale[2] = 1.0
    columns = columns / scale
    prior_std = np.array([stiffness[1], 1.0, np.inf, np.inf]) * scale
    # A file needs thousands of these regressions, so each builds its normal equations only once.
    normal_matrix, right_side, sum_of_squares = columns.T @ columns, columns.T @ y, float(y @ y)
    noise_variance = float(y.var())
    variance_without_cause = variance_with_cause = gain = 0.0

    def solve(count: int) -> tuple[Floats, float]:
        """Coefficients of the first `count` columns, and the mean of squared residuals plus penalty."""
        penalty = np.diag(noise_variance / prior_std[:count] ** 2 + 1e-9 * len(y))
        solution = np.linalg.solve(normal_matrix[:count, :count] + penalty, right_side[:count])
        return solution, (sum_of_squares - float(solution @ right_side[:count])) / len(y)

    # The penalty depends on the variance of the noise, which only the residuals give.
    for _ in range(3):
        _, variance_without_cause = solve(3)
        solution, variance_with_cause = solve(4)
        gain = float(solution[-1] / scale[3])
        noise_variance = max(variance_with_cause, 1e-12 * float(y.var()) + 1e-300)
    duration_s = len(y) * _DECIMATION * thresholds.SAMPLE_STEP_s
    independent_samples = duration_s * thresholds.INDEPENDENT_SAMPLES_Hz
    log_ratio = float(np.log(max(variance_without_cause, 1e-300) / max(variance_with_cause, 1e-300)))
    return RegressionFit(0.5 * independent_samples * log_ratio, gain)
