"""Whether the model of a twin fits its machine well enough for the accepted rate of false alarms.

If the model is right, its innovations are white. The evidence of a change sums them over seconds, so errors
that last matter, and not the variance of a single innovation. Sums over 1 s show both. On measured flights of
machines that the twin has not learned, the variance of these sums is 5 to 40 times as large as stated, and
that of single innovations 1 to 4 times (2026-11).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.model.effect import AXES
from scipy.stats import f as f_distribution

from heli_lab.watch.likelihood_ratio import CUT_OFF_STD

PIECE: Final = 25
"""Length of the pieces over which innovations are summed or drawn together, in measurements: 1 s. Longer:
few pieces in half a minute of flight. Shorter: they do not show the dependence that a model with small
errors leaves in the innovations."""
_MIN_PIECES: Final = 4
"""Number of pieces below which nothing is decided. Fewer: chance allows four times the stated deviation."""
_CHANCE: Final = 1e-3
"""Probability that a model that fits is called unfit, for each axis. Larger: healthy flights are not judged.
Smaller: a model that is wrong from the start raises alarms."""
_MANY_PIECES: Final = 1e6
"""Number of pieces that stands for a variance that is known exactly."""


@dataclass(frozen=True)
class PieceVariance:
    """Variance of sums of innovations over 1 s, in units of that of white innovations."""

    variance: Floats  # (3,): Variance of each axis; 1 if the model is right
    pieces: float  # Number of pieces from which it was estimated


STATED: Final = PieceVariance(np.ones(3), _MANY_PIECES)
"""The variance that the model itself states."""


def piece_variance(innovations: Floats) -> PieceVariance:
    """Compute the variance of sums over pieces of successive innovations, (n, 3); nan without a piece."""
    # Innovations are cut off as for the alarm, so that a single kick does not decide.
    pieces = len(innovations) // PIECE
    if not pieces:
        return PieceVariance(np.full(3, np.nan), 0)
    cut = np.clip(innovations[: pieces * PIECE], -CUT_OFF_STD, CUT_OFF_STD)
    sums = cut.reshape(pieces, PIECE, 3).sum(axis=1)
    return PieceVariance(np.mean(sums**2, axis=0) / PIECE, pieces)


@dataclass(frozen=True)
class ModelFit:
    """The beginning of a flight, compared with the variance that the alarm threshold was set for."""

    axis: str  # Axis with the largest errors
    ratio: float  # Its errors over 1 s, divided by those for which the threshold was set
    chance_ratio: float  # Ratio that chance alone exceeds once in a thousand flights
    is_decided: bool  # False if there were too few measurements

    @property
    def fits(self) -> bool:
        """Whether nothing contradicts that the model fits."""
        return not self.is_decided or self.ratio <= self.chance_ratio


def compare_with(expected: PieceVariance, observed: PieceVariance) -> ModelFit:
    """Compare the piece variance of a flight's beginning with the expected one."""
    if observed.pieces < _MIN_PIECES:
        return ModelFit(AXES[0], np.nan, np.nan, is_decided=False)
    ratios = observed.variance / expected.variance
    worst_axis = int(np.argmax(ratios))
    chance = float(f_distribution.isf(_CHANCE, observed.pieces, expected.pieces))
    return ModelFit(AXES[worst_axis], float(ratios[worst_axis]) ** 0.5, chance**0.5, is_decided=True)
