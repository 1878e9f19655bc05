"""Random effects: one number of several machines, each measured with its own standard error.

A machine's number is the make's mean and a deviation of its own of variance tau^2, which the method of
moments of DerSimonian and Laird (Controlled Clinical Trials 7, 1986, 177) finds from how much more the
machines scatter than their standard errors say.

statsmodels has the same estimate, and a test compares them. It is no dependency here, because it lacks the
prediction interval and takes a second to import, for ten lines.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

CONFIDENCE: Final = 0.95


@dataclass(frozen=True)
class RandomEffects:
    """The mean of a make, and how its machines differ.

    Parameters
    ----------
    mean, std : float
        Mean of the make and its standard error.
    tau : float
        Standard deviation from machine to machine; 0 where they scatter no more than their errors.
    q : float
        Cochran's Q: sum of squared deviations in standard errors, about k - 1 where tau is 0.
    i2 : float
        Share of the scatter that is of the machines and not of the measurements, 0 to 1.
    interval : (float, float)
        95 % of the mean, by Student's t and never narrower than the errors allow (Hartung and Knapp,
        Statistics in Medicine 20, 2001, 3875).
    prediction : (float, float) or None
        95 % of another machine (Higgins, Thompson and Spiegelhalter, J. R. Statist. Soc. A 172, 2009, 137);
        None for fewer than three machines.
    machines : int
        How many were measured.
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
    """Pool the `values` of one number of several machines, each with its standard error in `stds`, all above
    0 and in the same unit.
    """
    from scipy.stats import norm, t

    value, variance = np.array(values, float), np.array(stds, float) ** 2
    k, weight = len(value), 1.0 / variance
    fixed = float(weight @ value / weight.sum())
    q = float(weight @ (value - fixed) ** 2)
    spread = float(weight.sum() - weight @ weight / weight.sum())
    tau2 = max(0.0, (q - (k - 1)) / spread) if k > 1 else 0.0
    weight = 1.0 / (variance + tau2)
    mean, std = float(weight @ value / weight.sum()), float(weight.sum() ** -0.5)
    quantile = float(norm.ppf(0.5 + CONFIDENCE / 2.0))
    if k > 1:
        # tau is an estimate too: the normal quantile holds the mean of twelve machines in 89 % of cases only.
        scatter = float(weight @ (value - mean) ** 2) / (k - 1)
        quantile = float(t.ppf(0.5 + CONFIDENCE / 2.0, k - 1)) * max(1.0, scatter**0.5)
    wide = quantile * std
    prediction = None
    if k > 2:
        far = float(t.ppf(0.5 + CONFIDENCE / 2.0, k - 2)) * (tau2 + std**2) ** 0.5
        prediction = (mean - far, mean + far)
    i2 = max(0.0, 1.0 - (k - 1) / q) if q > 0.0 else 0.0
    return RandomEffects(mean, std, tau2**0.5, q, i2, (mean - wide, mean + wide), prediction, k)


@dataclass(frozen=True)
class Share:
    """On how many machines something is.

    Parameters
    ----------
    found, seen : int
        Machines on which it was found, and all on which it would have shown.
    share : float
        One over the other.
    interval : (float, float)
        95 % of the share among all machines of the make, exact (Clopper and Pearson, Biometrika 26, 1934,
        404).
    """

    found: int
    seen: int
    share: float
    interval: tuple[float, float]


def share(count: int, seen: int) -> Share:
    """Estimate a share from `count` of `seen` machines, one at least."""
    from scipy.stats import binomtest

    interval = binomtest(count, seen).proportion_ci(CONFIDENCE, method="exact")
    return Share(count, seen, count / seen, (float(interval.low), float(interval.high)))
