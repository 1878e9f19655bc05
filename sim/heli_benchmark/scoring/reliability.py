"""Calibration: whether the confidence of a cause is the frequency with which it is right."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from heli_host.data.files import save_figure
from scipy.special import bdtr

from heli_benchmark.scoring.judge import Row

BINS = (0.0, 0.5, 0.7, 0.85, 0.95, 1.0)
"""Bounds of the five bins."""
_OUTSIDE_PROBABILITY = 0.05
"""Probability that a bin of a calibrated diagnosis is outside of its bounds, both sides together."""


def reliability(rows: Sequence[Row]) -> list[dict[str, float]]:
    """Compare confidence with the share of right causes."""
    causes = [cause for row in rows for cause in row.answers]
    curve = []
    for low, high in pairwise(BINS):
        # The last bin includes its upper end.
        in_bin = [
            cause for cause in causes if low <= cause.confidence < high or cause.confidence == high == 1.0
        ]
        cause_count, hidden_count = len(in_bin), sum(cause.is_hidden for cause in in_bin)
        mean = sum(cause.confidence for cause in in_bin) / cause_count if cause_count else 0.5 * (low + high)
        curve.append(
            {
                "from": low,
                "to": high,
                "causes": cause_count,
                "mean_confidence": mean,
                "right": hidden_count,
                "share_right": hidden_count / cause_count if cause_count else mean,
                "least": _quantile(_OUTSIDE_PROBABILITY / 2.0, cause_count, mean),
                "most": _quantile(1.0 - _OUTSIDE_PROBABILITY / 2.0, cause_count, mean),
            }
        )
    return curve


def _quantile(share: float, count: int, mean: float) -> int:
    """Return the quantile `share` of a binomial distribution of `count` trials with success rate `mean`."""
    # scipy.stats also has this quantile, but its import takes a second of CPU time.
    return int(np.searchsorted(bdtr(np.arange(count + 1), count, mean), share))


def holds(bin_: dict[str, float]) -> bool:
    """Return whether a bin of `reliability` is within its bounds; an empty `bin_` is."""
    return bin_["least"] <= bin_["right"] <= bin_["most"]


def draw(curve: Sequence[dict[str, float]], path: Path) -> None:
    """Draw the reliability diagram."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.2, 4.0), layout="constrained")
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], color="0.7", lw=1)
    for confidence_bin in curve:
        if not confidence_bin["causes"]:
            continue
        count, mean = confidence_bin["causes"], confidence_bin["mean_confidence"]
        low, high = confidence_bin["least"] / count, confidence_bin["most"] / count
        axes.plot([mean, mean], [low, high], color="0.6", lw=6, solid_capstyle="butt")
        axes.plot(mean, confidence_bin["share_right"], "o", color="C0" if holds(confidence_bin) else "C3")
        axes.annotate(
            f"{count:.0f}", (mean, confidence_bin["share_right"]), (5, -10), textcoords="offset points"
        )
    axes.set(xlabel="confidence given", ylabel="share that is right", xlim=(-0.03, 1.03), ylim=(-0.03, 1.03))
    axes.set_title("grey: range of 95 % of calibrated bins; numbers: causes", fontsize=8)
    save_figure(figure, path, dpi=110)
