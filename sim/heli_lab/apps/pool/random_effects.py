"""Estimate how a parameter varies over the rigs of one type, by a random-effects model.

The parameter of a rig is the mean of the rig type plus a random deviation of variance tau^2. Each rig has an
estimate of its parameter with a standard error. The method of moments of DerSimonian and Laird (Controlled
Clinical Trials 7, 1986, 177) estimates tau^2 from the scatter of the rigs in excess of these standard errors.

A test compares the result with that of statsmodels. That package is not a dependency here, because it lacks
the prediction interval and takes a second to import.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

CONFIDENCE: Final = 0.95
"""Coverage of all intervals."""


@dataclass(frozen=True)
class RandomEffects:
    """Mean of a parameter over a rig type, and its variation between rigs; all in the parameter's unit.

    Parameters
    ----------
    mean, std : float
        Mean over the rig type and its standard error.
    tau : float
        Standard deviation between rigs; 0 if they scatter no more than their standard errors.
    q : float
        Cochran's Q: sum of squared deviations in standard errors; about k - 1 for k rigs if tau is 0.
    i2 : float
        Share of the scatter that is due to differences between rigs, 0 to 1.
    interval : (float, float)
        95 % confidence interval of the mean by Student's t, never narrower than the standard errors allow
        (Hartung and Knapp, Statistics in Medicine 20, 2001, 3875).
    prediction : (float, float) or None
        95 % prediction interval for another rig (Higgins, Thompson and Spiegelhalter, J. R. Statist. Soc. A
        172, 2009, 137); None for fewer than three rigs.
    machines : int
        Number of rigs.
    """

    mean: float
    std: float
    tau: float
    q: float
    i2: float
    interval: tuple[float, float]
    prediction: tuple[float, float] | None
    machines: int


def der_simonian_laird(values: Sequence[float], stds: Sequence[float]) -> RandomEffects:
    """Estimate mean and variation of one parameter over a rig type, by the method of moments.

    Parameters
    ----------
    values, stds : sequence of float
        Estimate of each rig and its standard error, above 0, all in the same unit.
    """
    from scipy.stats import norm, t

    estimates, variances = np.array(values, float), np.array(stds, float) ** 2
    k, fixed_weights = len(estimates), 1.0 / variances
    fixed_effect_mean = float(fixed_weights @ estimates / fixed_weights.sum())
    q = float(fixed_weights @ (estimates - fixed_effect_mean) ** 2)
    # The expectation of Q is k - 1 + tau^2 times this factor.
    factor = float(fixed_weights.sum() - fixed_weights @ fixed_weights / fixed_weights.sum())
    tau2 = max(0.0, (q - (k - 1)) / factor) if k > 1 else 0.0
    weights = 1.0 / (variances + tau2)
    mean, std = float(weights @ estimates / weights.sum()), float(weights.sum() ** -0.5)
    probability = 0.5 + CONFIDENCE / 2.0
    quantile = float(norm.ppf(probability))
    if k > 1:
        # tau is an estimate too: with the normal quantile, the interval covers the mean of twelve rigs in 89
        # % of cases only.
        scatter = float(weights @ (estimates - mean) ** 2) / (k - 1)
        quantile = float(t.ppf(probability, k - 1)) * max(1.0, scatter**0.5)
    half_width = quantile * std
    prediction = None
    if k > 2:
        prediction_half_width = float(t.ppf(probability, k - 2)) * (tau2 + std**2) ** 0.5
        prediction = (mean - prediction_half_width, mean + prediction_half_width)
    return RandomEffects(
        mean=mean,
        std=std,
        tau=tau2**0.5,
        q=q,
        i2=max(0.0, 1.0 - (k - 1) / q) if q > 0.0 else 0.0,
        interval=(mean - half_width, mean + half_width),
        prediction=prediction,
        machines=k,
    )


@dataclass(frozen=True)
class Share:
    """Share of rigs of a type that have a cause.

    Parameters
    ----------
    present, detectable : int
        Number of rigs with the cause, and of all rigs whose flights could show it.
    share : float
        Their ratio.
    interval : (float, float)
        Exact 95 % confidence interval of the share among all rigs of the type (Clopper and Pearson,
        Biometrika 26, 1934, 404).
    """

    present: int
    detectable: int
    share: float
    interval: tuple[float, float]


def share(present: int, detectable: int) -> Share:
    """Estimate the share of rigs with a cause: `present` of `detectable` rigs have it, of which there is at
    least one.
    """
    from scipy.stats import binomtest

    interval = binomtest(present, detectable).proportion_ci(CONFIDENCE, method="exact")
    return Share(present, detectable, present / detectable, (float(interval.low), float(interval.high)))
