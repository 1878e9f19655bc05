"""The tail of the evidence without a change: a generalised Pareto tail of block maxima."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from heli_host.data.arrays import Floats
from scipy.optimize import brentq, minimize
from scipy.stats import genpareto

from heli_lab.errors import TwinError

SEGMENT_s: Final = 5.0
"""Length of the segments whose maxima are counted as excursions of the evidence, s. An onset stays in the
window for some seconds. Longer: few excursions to fit. Shorter: one excursion counts several times, and the
alarms are rarer than stated."""
_LEVEL: Final = 0.8
"""Share of the segments whose maxima are below the level at which the generalised Pareto tail begins."""
_MIN_SCALE_nats: Final = 1.0
"""Scale of the tail of a likelihood ratio for white innovations, nats: by Wilks it falls by e per nat."""
_SHAPE_STD: Final = 0.05
"""Standard deviation of the shape before any flight was seen; its mean is 0. The evidence is half a square of
a sum of many innovations, so its tail is exponential but for a remainder of their outliers. Larger: thirty
excesses, which leave the shape open to 0.2, let the alarm level go to hundreds of nats. Smaller: outliers do
not count."""
SUPPORTED_LENGTHS: Final = 120.0
"""Longest interval between false alarms that healthy flights support, in their own length: 30 s support one
false alarm per hour. Their tail is then extrapolated by two powers of ten. More: the rate is a guess. Less:
a useful rate needs more flights than users have."""
_NODES: Final = 15
"""Number of nodes of the Gauss-Hermite quadrature in each of its two dimensions."""


@dataclass(frozen=True)
class Tail:
    """Generalised Pareto tail of the evidence without a change."""

    level_nats: float  # Lowest evidence that the tail describes [nats]
    per_hour: float  # Rate of excursions above the level, per hour of free flight
    scale_nats: float  # Scale of the excesses over the level [nats]; their mean where the shape is 0
    excesses: int  # Number of excursions from which scale and shape were estimated
    shape: float = 0.0  # Shape of the tail; 0 is an exponential one, more is a heavier one
    healthy_s: float = math.inf
    """Length of the healthy flights along which the excursions were drawn [s]; infinite for simulated ones.
    """

    @property
    def supported_interval_h(self) -> float:
        """Longest mean time between two false alarms that the healthy flights support [h]."""
        return SUPPORTED_LENGTHS * self.healthy_s / 3600.0

    def threshold_nats(self, false_alarm_interval_h: float) -> float:
        """Return the evidence that is exceeded once per `false_alarm_interval_h` of free flight [nats].

        The rate is averaged over the tails that could have given the excesses. If the healthy flights do not
        support the interval, the longest supported one is used.
        """
        interval_h = min(false_alarm_interval_h, self.supported_interval_h)
        expected_excursions = self.per_hour * interval_h
        if expected_excursions <= 1.0 or not math.isfinite(self.level_nats):
            return self.level_nats
        shapes, scales_nats, weights = self._posterior_tails()

        def log_expected_alarms(excess_nats: float) -> float:
            """Logarithm of the expected number of excursions in the interval above an excess."""
            chance = weights @ genpareto.sf(excess_nats, shapes, scale=scales_nats)
            return math.log(max(float(chance), 1e-300)) + math.log(expected_excursions)

        # The threshold is where one alarm is expected: double the excess until fewer are, then find the root.
        high_nats = self.scale_nats
        while log_expected_alarms(high_nats) > 0.0:
            high_nats *= 2.0
        return self.level_nats + float(brentq(log_expected_alarms, 0.0, high_nats, xtol=1e-6))

    def _posterior_tails(self) -> _PosteriorTails:
        """Return tails from the posterior of shape and log scale, with weights of Gauss-Hermite quadrature.

        The posterior is approximately normal. Its precision is the sum of the Fisher information of the
        generalised Pareto distribution and the precision of the shape's prior.
        """
        # The Fisher information is infinite at a shape of -1/2.
        xi = max(self.shape, -0.4)
        # Information of a single excess about shape and log scale (Smith 1987), (2, 2).
        fisher = np.array([[2.0 / (1.0 + xi), 1.0 / (1.0 + xi)], [1.0 / (1.0 + xi), 1.0]]) / (1.0 + 2.0 * xi)
        precision = self.excesses * fisher + np.diag([_SHAPE_STD**-2.0, 0.0])
        # Shape and log scale are their means plus root @ u, with a standard normal u, (2,).
        root = np.linalg.cholesky(np.linalg.inv(precision))
        nodes, node_weights = np.polynomial.hermite_e.hermegauss(_NODES)
        first, second = (grid.ravel() for grid in np.meshgrid(nodes, nodes))
        weights = np.outer(node_weights, node_weights).ravel()
        return _PosteriorTails(
            shapes=self.shape + root[0, 0] * first,
            scales_nats=self.scale_nats * np.exp(root[1, 0] * first + root[1, 1] * second),
            weights=weights / weights.sum(),
        )


class _PosteriorTails(NamedTuple):
    """Shapes and scales [nats] of tails that could have given the excesses, and their probabilities, (k,)."""

    shapes: Floats
    scales_nats: Floats
    weights: Floats


IDEAL: Final = Tail(5.37, 145.0, 1.0, 29)
"""Tail of a twin with the true parameters, from simulated flights of the rig makki2024 in the disturbances
of a quiet room. No trained twin has a lower threshold: half a minute of nominal flight may show less by
chance."""


def segment_maxima(history: Sequence[tuple[float, float]]) -> list[float]:
    """Return the largest evidence [nats] of each segment of `SEGMENT_s`."""
    t_s, evidence_nats = np.array(history, float).reshape(-1, 2).T
    is_known = np.isfinite(evidence_nats)
    t_s, evidence_nats = t_s[is_known], evidence_nats[is_known]
    if not len(t_s):
        return []
    segment_number = ((t_s - t_s[0]) // SEGMENT_s).astype(int)
    return [float(evidence_nats[segment_number == segment].max()) for segment in np.unique(segment_number)]


def fit_tail(flights: Sequence[Sequence[tuple[float, float]]], healthy_s: float = math.inf) -> Tail:
    """Fit the tail of the evidence to nominal flights."""
    maxima = [maximum for history in flights for maximum in segment_maxima(history)]
    if len(maxima) < 10:
        raise TwinError(
            f"{len(maxima)} segments of {SEGMENT_s:g} s of nominal flight are too few for a threshold",
            "give a longer flight",
        )
    level_nats = float(np.quantile(maxima, _LEVEL))
    excesses_nats = np.array([maximum - level_nats for maximum in maxima if maximum > level_nats])
    shape, scale_nats = _fit_excesses(excesses_nats)
    flight_h = len(maxima) * SEGMENT_s / 3600.0
    return Tail(
        level_nats,
        per_hour=len(excesses_nats) / flight_h,
        scale_nats=max(scale_nats, _MIN_SCALE_nats),
        excesses=len(excesses_nats),
        shape=shape,
        healthy_s=healthy_s,
    )


def _fit_excesses(excesses_nats: Floats) -> tuple[float, float]:
    """Return the most probable shape and scale [nats] of a generalised Pareto distribution of excesses."""

    def minus_log_posterior(shape_and_log_scale: Floats) -> float:
        shape, scale = float(shape_and_log_scale[0]), math.exp(shape_and_log_scale[1])
        log_likelihood = genpareto.logpdf(excesses_nats, shape, scale=scale).sum()
        if not math.isfinite(log_likelihood):
            return 1e9  # an excess is beyond the end of this tail
        return 0.5 * (shape / _SHAPE_STD) ** 2 - float(log_likelihood)

    best = minimize(
        minus_log_posterior,
        [0.0, math.log(excesses_nats.mean())],
        method="Nelder-Mead",
        options={"xatol": 1e-4},
    )
    return float(best.x[0]), math.exp(best.x[1])
