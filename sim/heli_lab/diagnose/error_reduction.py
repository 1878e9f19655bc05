"""Reduction of the free-run error on the validation flights, with a bootstrap interval."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_sim.model.parts import AXES

from heli_lab.diagnose.prediction import Prediction
from heli_lab.identify import Fit, trace
from heli_lab.identify.functions import Floats

_RESAMPLES: Final = 2000
"""Bootstrap samples: 50 lie beyond each end of a 95 % interval."""


@dataclass(frozen=True)
class ErrorReduction:
    """Free-run error of one axis, before and after.

    Parameters
    ----------
    before_deg, after_deg : float
        Root mean square error of the refitted baseline and of the extended model, degrees.
    interval95 : (float, float)
        95 % bootstrap interval of the ratio after over before, windows resampled.
    """

    before_deg: float
    after_deg: float
    interval95: tuple[float, float]

    @property
    def ratio(self) -> float:
        """After over before."""
        return self.after_deg / self.before_deg


def error_reduction(before: Prediction, after: Prediction, seed: int = 0) -> dict[str, ErrorReduction]:
    """Measure the free-run error on the validation flights, or without any on those fitted; `seed` is the
    bootstrap's.
    """
    squares_before, rows = _squares(before)
    squares_after, _ = _squares(after)
    count = len(rows)
    random = np.random.default_rng(seed)
    weights = random.multinomial(count, np.full(count, 1.0 / count), _RESAMPLES)
    ratios = np.sqrt((weights @ squares_after) / np.maximum(weights @ squares_before, 1e-30))
    low, high = np.quantile(ratios, [0.025, 0.975], axis=0)
    rms_before = np.rad2deg(np.sqrt(squares_before.sum(axis=0) / rows.sum()))
    rms_after = np.rad2deg(np.sqrt(squares_after.sum(axis=0) / rows.sum()))
    return {
        axis: ErrorReduction(float(rms_before[i]), float(rms_after[i]), (float(low[i]), float(high[i])))
        for i, axis in enumerate(AXES)
    }


def _squares(hypothesis: Prediction) -> tuple[Floats, Floats]:
    """Sum of squared errors in rad^2 and number of samples of each window."""
    fit: Fit = hypothesis.held_out_fit or hypothesis.fit
    squares, rows = [], []
    for index in range(len(fit.problem.records)):
        run = trace(fit, index)
        error = run.residual * run.sigma_rad
        for window in run.windows:
            squares.append((error[window] ** 2).sum(axis=0))
            rows.append(window.stop - window.start)
    return np.array(squares), np.array(rows, float)
