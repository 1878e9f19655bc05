"""Reduction of the free-run error on the validation flights, with a bootstrap interval."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_sim.model.parts import AXES

from heli_lab.diagnose.free_run import HORIZONS, FreeRun, WindowErrors

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
        95 % bootstrap interval of the ratio after over before, windows of 2 s resampled.
    """

    before_deg: float
    after_deg: float
    interval95: tuple[float, float]

    @property
    def ratio(self) -> float:
        """After over before; 1 where an axis that hung still left no error to reduce."""
        return self.after_deg / self.before_deg if self.before_deg > 0.0 else 1.0


@dataclass(frozen=True)
class HeldOutComparison:
    """Baseline and extended model on the same flights.

    Parameters
    ----------
    before, after : tuple of FreeRun
        Free runs of both, a flight each.
    horizons : Mapping[str, Mapping[str, ErrorReduction]]
        By horizon, as in `HORIZONS`, and by axis.
    """

    before: tuple[FreeRun, ...]
    after: tuple[FreeRun, ...]
    horizons: Mapping[str, Mapping[str, ErrorReduction]]


def judgement(before: Sequence[FreeRun], after: Sequence[FreeRun], seed: int = 0) -> HeldOutComparison:
    """Compare two models' free runs `before` and `after` an extension over the same flights; `seed` is the
    bootstrap's.
    """
    return HeldOutComparison(
        tuple(before),
        tuple(after),
        {
            key: error_reduction(
                [run.errors[key] for run in before], [run.errors[key] for run in after], seed
            )
            for key in HORIZONS
        },
    )


def error_reduction(
    before: Sequence[WindowErrors], after: Sequence[WindowErrors], seed: int = 0
) -> dict[str, ErrorReduction]:
    """Compare the errors of two models by axis; one of each for each flight, in the same windows. `seed` is
    the bootstrap's.
    """
    rows = np.concatenate([run.rows for run in before])
    squares_before = np.concatenate([run.squares_rad2 for run in before])
    squares_after = np.concatenate([run.squares_rad2 for run in after])
    count = len(rows)
    random = np.random.default_rng(seed)
    weights = random.multinomial(count, np.full(count, 1.0 / count), _RESAMPLES)
    total = weights @ squares_before
    ratios = np.sqrt(np.where(total > 0.0, weights @ squares_after, 1.0) / np.where(total > 0.0, total, 1.0))
    low, high = np.quantile(ratios, [0.025, 0.975], axis=0)
    rms_before = np.rad2deg(np.sqrt(squares_before.sum(axis=0) / rows.sum()))
    rms_after = np.rad2deg(np.sqrt(squares_after.sum(axis=0) / rows.sum()))
    return {
        axis: ErrorReduction(float(rms_before[i]), float(rms_after[i]), (float(low[i]), float(high[i])))
        for i, axis in enumerate(AXES)
    }
