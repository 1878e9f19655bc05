"""The main figures of a diagnosis: the cause, the prediction, the error reduction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_host.data.flight import broken_at_gaps
from heli_sim.model.parts import AXES

from heli_lab.explain.discover.missing import TIME, MissingTerm
from heli_lab.explain.evaluate.error_reduction import ErrorReduction
from heli_lab.explain.wording import readable_id
from heli_lab.fit.identification import Trace, trace
from heli_lab.fit.problem import Fit
from heli_lab.report.diagnosis.figures import AFTER, BEFORE, MEASURED, bin_means, thinned

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_BINS: Final = 24
"""Number of means over equal parts of the dots: fewer hide a bend, more show noise."""
_TAIL: Final = 0.003
"""Share of the dots at each end that may be outside the picture, so that outliers do not flatten the rest."""
_EXCERPT_s: Final = 40.0
"""Longest part of a prediction that is drawn: in a longer one, runs of 2 s are not visible."""
_LINES_s: Final = 12.0
"""Length of the part that is drawn of a term over time: in a longer part, lines overlap."""
_MAX_DOTS: Final = 4000
"""Dots of a scatter plot: more hide each other."""


def figure_of_missing_terms(terms: Sequence[MissingTerm]) -> Figure:
    """Draw the missing torques or angles of `terms` over the quantities that they depend on.

    Each cause has a row. The left panel shows the missing values without the cause in the model, together
    with the equation of the cause. The right panel shows the remaining values with the cause in the model.
    """
    from matplotlib.figure import Figure

    height = 4.1 * len(terms)
    figure = Figure(figsize=(11, height))
    panels = figure.subplots(len(terms), 2, sharey="row", squeeze=False)
    figure.subplots_adjust(0.085, 0.62 / height, 0.985, 1.0 - 0.6 / height, wspace=0.05, hspace=0.48)
    for term, (before, after) in zip(terms, panels, strict=True):
        if term.on == TIME:
            _draw_missing_term(_part_of_largest_contribution(term), before, after)
        else:
            _draw_missing_term(term, before, after)
    return figure


def _draw_missing_term(term: MissingTerm, before: Axes, after: Axes) -> None:
    """Draw the missing values of a term with its contribution, and what remains with it in the model."""
    noun = f"torque about {term.axis}" if term.what == "torque" else f"angle of the {term.axis} encoder"
    if term.is_spline:
        name = f"curve in place of the unknown: {readable_id(term.id).removeprefix('any ')}"
        kind, label = "curve", "smooth curve"
    else:
        name, kind, label = term.id, "cause", "equation of the cause"
    _draw_dots(before, term.missing, term)
    _draw_dots(after, term.remaining, term)
    quantity, contribution = term.quantity, term.contribution
    if term.what == "torque" and term.on != TIME:
        quantity, contribution = bin_means(quantity, contribution, 4 * _BINS)
    line = broken_at_gaps(quantity, contribution) if term.on == TIME else (quantity, contribution)
    before.plot(*line, color=AFTER, lw=1.4 if term.on == TIME else 2.2, label=label)
    before.set_title(f"{name}\nbefore: {noun} that the model lacks", fontsize=10.5, color=BEFORE, loc="left")
    after.set_title(
        f"after: what remains with the {kind} in the model", fontsize=10.5, color=AFTER, loc="left"
    )
    before.set_ylabel(f"{noun} [{term.unit}]", fontsize=10)
    for panel in (before, after):
        panel.axhline(0.0, color="#9aa0a6", lw=0.8, zorder=0)
        panel.set_xlabel(f"{term.on} [{term.on_unit}]", fontsize=10)
        panel.grid(alpha=0.25)
    bar = 2.0 * term.std if term.what == "angle" else np.zeros(1)
    values = np.concatenate((term.missing - bar, term.missing + bar, term.remaining, term.contribution))
    low, high = np.quantile(values, [_TAIL, 1.0 - _TAIL])
    margin = 0.12 * (high - low)
    before.set_ylim(min(low, contribution.min()) - margin, max(high, contribution.max()) + margin)
    ends = np.quantile(term.quantity, [_TAIL, 1.0 - _TAIL])
    for panel in (before, after):
        panel.set_xlim(*(ends + np.array([-0.03, 0.03]) * np.ptp(ends)))
    before.legend(loc="best", fontsize=9, framealpha=0.85)


def _part_of_largest_contribution(term: MissingTerm) -> MissingTerm:
    """Return the `_LINES_s` of one flight in which a term contributes most.

    `term` is drawn over time: its quantity is the time of each flight.
    """
    t_s = term.quantity
    # The flights follow each other, so time steps back where a new flight starts.
    ends = np.append(np.flatnonzero(np.diff(t_s) < 0.0) + 1, len(t_s))
    starts = np.append(0, ends[:-1])
    squares = np.append(0.0, np.cumsum(np.square(term.contribution)))
    parts = []
    for start, end in zip(starts, ends, strict=True):
        # For each possible first row, the row after the last one; then the part with most squares.
        stops = start + np.searchsorted(t_s[start:end], t_s[start:end] + _LINES_s)
        first = start + int(np.argmax(squares[stops] - squares[start:end]))
        parts.append(slice(first, int(stops[first - start])))
    part = max(parts, key=lambda part: float(squares[part.stop] - squares[part.start]))
    names = ("quantity", "missing", "std", "remaining", "contribution")
    return replace(term, **{name: getattr(term, name)[part] for name in names})


def _draw_dots(panel: Axes, value: Floats, term: MissingTerm) -> None:
    """Draw values of a missing term over its quantity: dots, and means or error bars."""
    quantity = term.quantity
    if term.on == TIME:
        panel.plot(quantity, value, ".", ms=3.5, color=MEASURED, label="from the flights")
        return
    if term.what == "angle":
        panel.errorbar(
            quantity, value, 2.0 * term.std, fmt="o", ms=4, lw=1, color=MEASURED, label="from the flights"
        )
        return
    thinned_rows = thinned(len(quantity), _MAX_DOTS)
    panel.plot(quantity[thinned_rows], value[thinned_rows], ".", ms=2.5, color="#b4b9bf", rasterized=True)
    panel.plot(*bin_means(quantity, value, _BINS), "o", ms=5, color=MEASURED, label="from the flights, means")


def figure_of_prediction(
    before: Fit, after: Fit, first: str, outside_s: Sequence[tuple[float, float]] = ()
) -> Figure:
    """Draw free runs of 2 s: the angle of an axis, and the errors of all three axes.

    A circle marks the start of a run, and a grey band the rounding of the encoder.
    """
    from matplotlib.figure import Figure

    baseline, extended = trace(before), trace(after)
    axes = sorted(range(3), key=lambda axis: AXES[axis] != first)
    excerpt = _rows_with_largest_error(baseline, axes[0])
    t_s = baseline.t_s[excerpt]
    figure = Figure(figsize=(11, 7.2))
    panels = figure.subplots(4, 1, sharex=True, height_ratios=[2.4, 1.3, 1.0, 1.0])
    figure.subplots_adjust(0.085, 0.075, 0.985, 0.955, hspace=0.13)
    angle_panel = panels[0]
    measured_deg = np.rad2deg(baseline.measured_rad[excerpt, axes[0]])
    angle_panel.plot(t_s, measured_deg, ".", ms=2.2, color=MEASURED, label="measured")
    _draw_runs(panels, baseline, excerpt, axes, BEFORE, "baseline")
    if before is not after:
        _draw_runs(panels, extended, excerpt, axes, AFTER, "extended")
    _shade_extrapolations(panels, t_s, outside_s)
    angle_panel.set_ylabel(f"{AXES[axes[0]]} [deg]", fontsize=10)
    # The largest rounding error is half a count.
    half_counts_deg = np.rad2deg(np.sqrt(3.0) * baseline.sigma_rad)
    for panel, axis in zip(panels[1:], axes, strict=True):
        panel.axhline(0.0, color="#9aa0a6", lw=0.8, zorder=0)
        half_deg = half_counts_deg[axis]
        panel.axhspan(-half_deg, half_deg, color="#c9ced4", lw=0.0, zorder=0.5)
        panel.set_ylabel(f"{AXES[axis]}\nerror [deg]", fontsize=9)
    for panel in panels:
        panel.grid(alpha=0.25)
        panel.margins(x=0.01)
    figure.legend(
        *angle_panel.get_legend_handles_labels(),
        loc="upper right",
        ncols=4,
        fontsize=9,
        frameon=False,
        markerscale=4,
    )
    angle_panel.set_title(f"{baseline.label}, simulated in runs of 2 s", fontsize=10.5, loc="left")
    panels[-1].set_xlabel("time of the flight [s]", fontsize=10)
    return figure


def _draw_runs(
    panels: Sequence[Axes], run: Trace, excerpt: slice, axes: Sequence[int], color: str, label: str
) -> None:
    """Draw the simulated angle of a model into the first panel, and the errors of its axes into the others.

    `axes` are the axes of the error panels; the first of them is the axis of the angle.
    """
    angle_panel, error_panels = panels[0], panels[1:]
    for window in run.windows:
        if window.start < excerpt.start or window.stop > excerpt.stop:
            continue
        angle_deg = np.rad2deg(run.predicted_rad[window, axes[0]])
        angle_panel.plot(
            run.t_s[window],
            angle_deg,
            color=color,
            lw=1.1,
            label=label if window.start == excerpt.start else None,
        )
        start = run.t_s[window.start], angle_deg[0]
        angle_panel.plot(*start, "o", ms=4.5, mfc="white", mec=color, mew=1.1, zorder=4)
        for panel, axis in zip(error_panels, axes, strict=True):
            error_deg = np.rad2deg(run.predicted_rad[window, axis] - run.measured_rad[window, axis])
            panel.plot(run.t_s[window], error_deg, color=color, lw=0.9)


def _shade_extrapolations(
    panels: Sequence[Axes], t_s: Floats, outside_s: Sequence[tuple[float, float]]
) -> None:
    """Shade the times at which the model extrapolates, if they are within the drawn times `t_s`."""
    shaded_s = [(begin_s, end_s) for begin_s, end_s in outside_s if t_s[0] <= begin_s and end_s <= t_s[-1]]
    for number, (begin_s, end_s) in enumerate(shaded_s):
        for panel in panels:
            is_first = number == 0 and panel is panels[0]  # the legend has one entry
            label = "voltages that were not fitted" if is_first else None
            panel.axvspan(begin_s, end_s, color="#f3e3c3", lw=0.0, zorder=-1, label=label)


def _rows_with_largest_error(run: Trace, axis: int) -> slice:
    """Return the rows of consecutive windows in which the error of an axis is largest.

    The windows have a total duration of at most `_EXCERPT_s`; if a single window is longer, the first one is
    returned.
    """
    candidates = []
    for first in run.windows:
        for last in run.windows:
            duration_s = run.t_s[last.stop - 1] - run.t_s[first.start]
            if 0.0 < duration_s <= _EXCERPT_s:
                candidates.append(slice(first.start, last.stop))
    if not candidates:
        return slice(run.windows[0].start, run.windows[0].stop)
    squares = np.concatenate(([0.0], np.cumsum(run.residual[:, axis] ** 2)))
    return max(candidates, key=lambda rows: float(squares[rows.stop] - squares[rows.start]))


def figure_of_gain(
    horizons: Mapping[str, Mapping[str, ErrorReduction]], extended: bool, rounding_rad: Floats
) -> Figure:
    """Draw free-run errors before and after by horizon, one panel per axis, with 95 % intervals of their
    ratio, and the rms error that the encoders' rounding makes. Shapes: `rounding_rad` (3,).
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 3.5))
    panels = figure.subplots(1, 3)
    figure.subplots_adjust(0.065, 0.155, 0.985, 0.83, wspace=0.18)
    positions = np.arange(len(horizons))
    for axis, panel, rounding_deg in zip(AXES, panels, np.rad2deg(rounding_rad), strict=True):
        reductions = [horizon[axis] for horizon in horizons.values()]
        before_deg = np.array([reduction.before_deg for reduction in reductions])
        after_deg = np.array([reduction.after_deg for reduction in reductions])
        interval_deg = before_deg * np.array([reduction.interval95 for reduction in reductions]).T
        panel.bar(positions - (0.18 if extended else 0.0), before_deg, 0.32, color=BEFORE, label="baseline")
        panel.set_xticks(positions, [f"{key} s" for key in horizons])
        panel.axhline(rounding_deg, color=MEASURED, lw=1.0, ls="--", label="rounding of the encoder alone")
        panel.set_title(axis, fontsize=10.5, loc="left")
        panel.set_xlabel("length of the free run", fontsize=9)
        panel.grid(axis="y", alpha=0.25)
        panel.set_axisbelow(True)
        if not extended:
            panel.set_ylim(0.0, 1.5 * float(max(before_deg.max(), rounding_deg)) or 1.0)
            continue
        panel.bar(positions + 0.18, after_deg, 0.32, color=AFTER, label="extended")
        whiskers_deg = np.abs(interval_deg - after_deg)
        panel.errorbar(
            positions + 0.18,
            after_deg,
            whiskers_deg,
            fmt="none",
            ecolor=MEASURED,
            elinewidth=1.2,
            capsize=3.5,
        )
        top_deg = np.maximum(before_deg, np.maximum(after_deg, interval_deg[1]))
        highest_deg = float(top_deg.max())
        for position, top_of_bar_deg, reduction in zip(positions, top_deg, reductions, strict=True):
            panel.text(
                position,
                top_of_bar_deg + 0.03 * highest_deg,
                f"\N{MULTIPLICATION SIGN} {reduction.ratio:.2f}",
                ha="center",
                fontsize=10,
            )
        panel.set_ylim(0.0, 1.2 * highest_deg or 1.0)
    panels[0].set_ylabel("rms error [deg]", fontsize=10)
    figure.legend(
        *panels[0].get_legend_handles_labels(), loc="upper right", ncols=3, fontsize=9, frameon=False
    )
    return figure
