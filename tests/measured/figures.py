"""Drawings for docs/validation/measured-flights.md: predictions before and after, and common causes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from heli_lab.fit.identification import trace

from tests.measured.pairs import PairFit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MEASURED, _BEFORE, _AFTER = "#30343a", "#d1495b", "#0b5fa5"


def figure_of_pair(before: PairFit, after: PairFit, title: str) -> Figure:
    """Draw a flight that no fit saw: pitch and travel, measured and predicted in runs of two seconds."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 5.2))
    angle, pitch, travel = figure.subplots(3, 1, sharex=True, height_ratios=[2, 1.3, 1.3])
    figure.subplots_adjust(0.085, 0.09, 0.985, 0.93, hspace=0.12)
    figure.suptitle(title, fontsize=10)
    for fit_pair, colour, label in ((before, _BEFORE, "baseline"), (after, _AFTER, "extended")):
        seen = trace(fit_pair.run.fit)
        t_s = seen.t_s - seen.t_s[0]
        error_deg = np.rad2deg(seen.measured_rad - seen.predicted_rad)
        if fit_pair is before:
            angle.plot(
                t_s, np.rad2deg(seen.measured_rad[:, 1]), ".", ms=1.5, color=_MEASURED, label="measured"
            )
        for number, window in enumerate(seen.windows):
            # Each run starts from the state that fits it best; a line across two runs would hide that.
            once = label if number == 0 else None
            angle.plot(
                t_s[window], np.rad2deg(seen.predicted_rad[window, 1]), color=colour, lw=0.9, label=once
            )
            pitch.plot(t_s[window], error_deg[window, 1], color=colour, lw=0.9)
            travel.plot(t_s[window], error_deg[window, 2], color=colour, lw=0.9)
    labels = ("pitch / deg", "pitch error / deg", "travel error / deg")
    for axes, label in zip((angle, pitch, travel), labels, strict=True):
        axes.set_ylabel(label, fontsize=8)
        axes.tick_params(labelsize=8)
        axes.grid(alpha=0.25)
        axes.margins(x=0.01)
    angle.legend(loc="upper right", fontsize=8, ncol=3, frameon=False, markerscale=4)
    travel.set_xlabel("time in free flight / s", fontsize=8)
    return figure


def figure_of_sizes(sizes: Mapping[str, Sequence[tuple[float, float]]], names: Sequence[str]) -> Figure:
    """Draw each effect's size on each machine, learned from either flight of its pair."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 2.9))
    panels = figure.subplots(1, len(sizes), squeeze=False)[0]
    figure.subplots_adjust(0.07, 0.2, 0.985, 0.88, wspace=0.3)
    place = np.arange(len(names))
    for axes, (label, values) in zip(panels, sizes.items(), strict=True):
        for flight, colour in ((0, _AFTER), (1, _BEFORE)):
            value = np.array(values[flight::2])
            where = place + 0.16 * (flight - 0.5)
            which = ("learned from the first flight", "from the second")[flight]
            axes.errorbar(where, value[:, 0], 2 * value[:, 1], fmt="o", ms=4, color=colour, lw=1, label=which)
        axes.axhline(0, color="#9aa0a6", lw=0.8)
        axes.set_title(label, fontsize=9)
        axes.set_xticks(place, names, fontsize=7, rotation=12)
        axes.tick_params(axis="y", labelsize=8)
        axes.grid(axis="y", alpha=0.25)
    panels[0].legend(fontsize=7, frameon=False, loc="upper left")
    return figure
