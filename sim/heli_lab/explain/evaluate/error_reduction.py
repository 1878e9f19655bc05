"""Reduction of the free-run error by an extension of the model, with a bootstrap interval."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_sim.model.parts import AXES

from heli_lab.explain.evaluate.free_run import HORIZONS, FreeRun, WindowErrors

_RESAMPLES: Final = 2000
"""Bootstrap samples: 50 are beyond each end of a 95 % interval."""


@dataclass(frozen=True)
class ErrorReduction:
    """Free-run error of one axis before and after an extension."""

    before_deg: float
    """before_deg, after_deg: Root mean square error of the baseline and of the extended model."""
    after_deg: float
    interval95: tuple[float, float]
    """(float, float): 95 % interval of the ratio after/before, by a bootstrap over windows of 2 s."""

    @property
    def ratio(self) -> float:
        """Error after over error before; 1 if the axis never moved and there is no error."""
        return self.after_deg / self.before_deg if self.before_deg > 0.0 else 1.0


@dataclass(frozen=True)
class HeldOutComparison:
    """Free runs of two models on the same flights."""

    before: tuple[FreeRun, ...]
    """before, after: Free runs of the baseline and of the extended model, one per flight."""
    after: tuple[FreeRun, ...]
    horizons: Mapping[str, Mapping[str, ErrorReduction]]
    """Error reductions by horizon, a key of `HORIZONS`, and by axis."""


def compare_free_runs(
    before: Sequence[FreeRun], after: Sequence[FreeRun], seed: int = 0
) -> HeldOutComparison:
    """Compare the free runs of two models over the same flights."""
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
    """Compare the errors of two models by axis."""
    rows = np.concatenate([run.rows for run in before])
    squares_before = np.concatenate([run.squares_rad2 for run in before])
    squares_after = np.concatenate([run.squares_rad2 for run in after])
    count = len(rows)
    random = np.random.default_rng(seed)
    # How often each bootstrap sample contains each window, shape (resamples, windows).
    weights = random.multinomial(count, np.full(count, 1.0 / count), _RESAMPLES)
    resampled_before = weights @ squares_before
    resampled_after = weights @ squares_after
    has_error = resampled_before > 0.0
    ratios = np.sqrt(np.where(has_error, resampled_after, 1.0) / np.where(has_error, resampled_before, 1.0))
    low, high = np.quantile(ratios, [0.025, 0.975], axis=0)
    rms_before = np.rad2deg(np.sqrt(squares_before.sum(axis=0) / rows.sum()))
    rms_after = np.rad2deg(np.sqrt(squares_after.sum(axis=0) / rows.sum()))
    return {
        axis: ErrorReduction(float(rms_before[i]), float(rms_after[i]), (float(low[i]), float(high[i])))
        for i, axis in enumerate(AXES)
    }
