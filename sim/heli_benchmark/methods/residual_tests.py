"""Ljung's recipe with statsmodels: an ARX model of the residuals and tests of whiteness; names no cause."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from scipy.stats import chi2
from statsmodels.stats.diagnostic import acorr_ljungbox
from statsmodels.tsa.ar_model import AutoReg

from heli_benchmark.methods.terms import residual_regression
from heli_benchmark.task import NOTHING, BenchmarkCase, answer_with

_ORDER: Final = 5
"""Order of the autoregressive model: half a second, the correlation time of the disturbances."""
_SIGNIFICANCE: Final = 0.05
"""Level of the tests, divided by the number of axes. Tuned."""


def diagnose(case: BenchmarkCase) -> dict[str, Any]:
    """Test whether the residuals of the nominal model depend on its inputs."""
    regression = residual_regression(case)
    # Of the angles and rates, the first six features, squares are inputs, too.
    inputs = np.hstack([regression.features, regression.features[:, :6] ** 2])
    level = _SIGNIFICANCE / regression.residuals.shape[1]
    detected = False
    for residual in regression.residuals.T:
        without_inputs = AutoReg(residual, _ORDER).fit()
        with_inputs = AutoReg(residual, _ORDER, exog=inputs).fit()
        ratio = 2.0 * (with_inputs.llf - without_inputs.llf)
        is_dependent = chi2.sf(ratio, inputs.shape[1]) < level
        is_white = acorr_ljungbox(with_inputs.resid, [10])["lb_pvalue"].iloc[0] >= level
        # Without whiteness the ratio has another distribution, so that it must be far beyond its limit.
        is_far_beyond = ratio > 3.0 * chi2.isf(level, inputs.shape[1])
        detected |= bool(is_dependent and (is_white or is_far_beyond))
    rig = regression.parameters([])
    if not detected:
        return answer_with(case.causes, {NOTHING: 0.8}, rig)
    rates = case.causes.base_rates
    something = {name: min(0.45, rate / (1.0 - rates[NOTHING])) for name, rate in rates.items()}
    return answer_with(case.causes, {**something, NOTHING: 0.05}, rig)
