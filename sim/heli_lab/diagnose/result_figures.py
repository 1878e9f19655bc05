"""Figures that stand on top of a diagnosis: the cause, the prediction, the gain."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np
from heli_host.arrays import Floats
from heli_sim.model.parts import AXES

from heli_lab.diagnose.error_reduction import ErrorReduction
from heli_lab.diagnose.figures import AFTER, BEFORE, MEASURED
from heli_lab.diagnose.missing_term import MissingTerm
from heli_lab.identify import Fit, Trace, trace

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_BINS: Final = 24
"""Means over as many equal parts of the dots: fewer hide a bend, more are noise."""
_TAIL: Final = 0.003
"""Share of the dots at each end that may lie outside the picture, so that one does not flatten the rest."""
_EXCERPT_s: Final = 40.0
"""Longest time that is drawn of a prediction: of more, runs of 2 s are not told apart."""
_MOST_DOTS: Final = 4000


def figure_of_missing_terms(equations: Sequence[MissingTerm]) -> Figure:
    """Draw what is missing against what it goes with, a row a cause: without the cause on the left with the
    law that was found, with it on the right.
    """
    from matplotlib.figure import Figure

    rows = len(equations)
    figure = Figure(figsize=(11, 4.1 * rows))
    panels = figure.subplots(rows, 2, sharey="row", squeeze=False)
    high = 4.1 * rows
    figure.subplots_adjust(0.085, 0.62 / high, 0.985, 1.0 - 0.42 / high, wspace=0.05, hspace=0.42)
    for equation, (left_panel, right) in zip(equations, panels, strict=True):
        noun = (
            f"torque about {equation.axis}"
            if equation.what == "torque"
            else f"angle of the {equation.axis} encoder"
        )
        _dots(left_panel, equation.place, equation.missing, equation)
        _dots(right, equation.place, equation.left, equation)
        place, value = (
            _binned(equation.place, equation.equation, 4 * _BINS)
            if equation.what == "torque"
            else (equation.place, equation.equation)
        )
        left_panel.plot(place, value, color=AFTER, lw=2.2, label="the law found")
        left_panel.set_title(f"before: {noun} that the model lacks", fontsize=10.5, color=BEFORE, loc="left")
        right.set_title(
            "after: what is left with the law in the model", fontsize=10.5, color=AFTER, loc="left"
        )
        left_panel.set_ylabel(f"{noun} [{equation.unit}]", fontsize=10)
        for panel in (left_panel, right):
            panel.axhline(0.0, color="#9aa0a6", lw=0.8, zorder=0)
            panel.set_xlabel(f"{equation.on} [{equation.on_unit}]", fontsize=10)
            panel.grid(alpha=0.25)
        wide = 2.0 * equation.std if equation.what == "angle" else np.zeros(1)
        shown = np.concatenate(
            (equation.missing - wide, equation.missing + wide, equation.left, equation.equation)
        )
        low, top = np.quantile(shown, [_TAIL, 1.0 - _TAIL])
        room = 0.12 * (top - low)
        left_panel.set_ylim(min(low, value.min()) - room, max(top, value.max()) + room)
        ends = np.quantile(equation.place, [_TAIL, 1.0 - _TAIL])
        for panel in (left_panel, right):
            panel.set_xlim(*(ends + np.array([-0.03, 0.03]) * np.ptp(ends)))
        left_panel.legend(loc="best", fontsize=9, framealpha=0.85)
    return figure


def _dots(panel: Axes, place: Floats, value: Floats, equation: MissingTerm) -> None:
    if equation.what == "angle":
        panel.errorbar(
            place,
            value,
            2.0 * equation.std,
            fmt="o",
            ms=4,
            lw=1,
            color=MEASURED,
            label="as the flights show it",
        )
        return
    keep = slice(None, None, max(1, len(place) // _MOST_DOTS))
    panel.plot(place[keep], value[keep], ".", ms=2.5, color="#b4b9bf", rasterized=True)
    panel.plot(
        *_binned(place, value, _BINS), "o", ms=5, color=MEASURED, label="as the flights show it, means"
    )


def _binned(place: Floats, value: Floats, bins: int) -> tuple[Floats, Floats]:
    """Means of as many parts of the same number of dots."""
    parts = np.array_split(np.argsort(place), min(bins, len(place)))
    return np.array([place[part].mean() for part in parts]), np.array([value[part].mean() for part in parts])


def figure_of_prediction(before: Fit, after: Fit, first: str) -> Figure:
    """Draw a flight in free runs of two seconds: the angle of the axis `first`, and the errors of all three
    beneath, `first` on top; of a long flight the part where the baseline is off most. Of two models
    that are one there is one curve.
    """
    from matplotlib.figure import Figure

    old, new = trace(before), trace(after)
    order = sorted(range(3), key=lambda axis: AXES[axis] != first)
    keep = _excerpt(old, order[0])
    t_s = old.t_s[keep]
    figure = Figure(figsize=(11, 7.2))
    panels = figure.subplots(4, 1, sharex=True, height_ratios=[2.4, 1.3, 1.0, 1.0])
    figure.subplots_adjust(0.085, 0.075, 0.985, 0.955, hspace=0.13)
    angle = panels[0]
    measured = np.rad2deg(old.measured_rad[keep, order[0]])
    angle.plot(t_s, measured, ".", ms=2.2, color=MEASURED, label="measured")
    models = [(old, BEFORE, "baseline"), (new, AFTER, "extended")][: 1 if before is after else 2]
    for run, color, label in models:
        for window in (w for w in run.windows if w.start >= keep.start and w.stop <= keep.stop):
            name = label if window.start == keep.start else None
            angle.plot(
                run.t_s[window],
                np.rad2deg(run.predicted_rad[window, order[0]]),
                color=color,
                lw=1.1,
                label=name,
            )
            for panel, axis in zip(panels[1:], order, strict=True):
                error_deg = np.rad2deg(run.predicted_rad[window, axis] - run.measured_rad[window, axis])
                panel.plot(run.t_s[window], error_deg, color=color, lw=0.9)
    angle.set_ylabel(f"{AXES[order[0]]} [deg]", fontsize=10)
    for panel, axis in zip(panels[1:], order, strict=True):
        panel.axhline(0.0, color="#9aa0a6", lw=0.8, zorder=0)
        panel.set_ylabel(f"{AXES[axis]}\nerror [deg]", fontsize=9)
    for panel in panels:
        panel.grid(alpha=0.25)
        panel.margins(x=0.01)
    figure.legend(
        *angle.get_legend_handles_labels(),
        loc="upper right",
        ncols=3,
        fontsize=9,
        frameon=False,
        markerscale=4,
    )
    angle.set_title(f"{old.label}, predicted in runs of 2 s", fontsize=10.5, loc="left")
    panels[-1].set_xlabel("time of the flight [s]", fontsize=10)
    return figure


def _excerpt(drawn: Trace, axis: int) -> slice:
    """Whole windows, of at most `_EXCERPT_s` in all, with the largest error of an axis."""
    spans = [
        (drawn.t_s[a.start], drawn.t_s[b.stop - 1], a.start, b.stop)
        for a in drawn.windows
        for b in drawn.windows
    ]
    fits = [(a, b) for start_s, stop_s, a, b in spans if 0.0 < stop_s - start_s <= _EXCERPT_s]
    if not fits:
        return slice(drawn.windows[0].start, drawn.windows[0].stop)
    squares = np.concatenate(([0.0], np.cumsum(drawn.residual[:, axis] ** 2)))
    return slice(*max(fits, key=lambda span: float(squares[span[1]] - squares[span[0]])))


def figure_of_gain(horizons: Mapping[str, Mapping[str, ErrorReduction]], extended: bool) -> Figure:
    """Draw the errors before and after over the horizon, a panel an axis; whiskers are 95 % intervals of the
    ratio, which stands above. The baseline's alone where no model was `extended`.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 3.5))
    panels = figure.subplots(1, 3)
    figure.subplots_adjust(0.065, 0.155, 0.985, 0.86, wspace=0.18)
    place = np.arange(len(horizons))
    for axis, panel in zip(AXES, panels, strict=True):
        measured = [horizon[axis] for horizon in horizons.values()]
        before = np.array([reduction.before_deg for reduction in measured])
        after = np.array([reduction.after_deg for reduction in measured])
        ends = before * np.array([reduction.interval95 for reduction in measured]).T
        panel.bar(place - (0.18 if extended else 0.0), before, 0.32, color=BEFORE, label="baseline")
        panel.set_xticks(place, [f"{key} s" for key in horizons])
        panel.set_title(axis, fontsize=10.5)
        panel.set_xlabel("length of the free run", fontsize=9)
        panel.grid(axis="y", alpha=0.25)
        panel.set_axisbelow(True)
        if not extended:
            continue
        panel.bar(place + 0.18, after, 0.32, color=AFTER, label="extended")
        whiskers = np.abs(ends - after)
        panel.errorbar(
            place + 0.18, after, whiskers, fmt="none", ecolor=MEASURED, elinewidth=1.2, capsize=3.5
        )
        top = np.maximum(before, np.maximum(after, ends[1]))
        highest = float(top.max())
        for where, height, reduction in zip(place, top, measured, strict=True):
            panel.text(
                where,
                height + 0.03 * highest,
                f"\N{MULTIPLICATION SIGN} {reduction.ratio:.2f}",
                ha="center",
                fontsize=10,
            )
        panel.set_ylim(0.0, 1.2 * highest or 1.0)
    panels[0].set_ylabel("rms error [deg]", fontsize=10)
    figure.legend(
        *panels[0].get_legend_handles_labels(), loc="upper right", ncols=2, fontsize=9, frameon=False
    )
    return figure
