"""Figures of a diagnosis: cause, prediction, error reduction, missing torques, scores, regions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_host.data.flight import broken_at_gaps
from heli_sim.model.effect import AXES

from heli_lab.explain.candidates import QUANTITIES
from heli_lab.explain.comparison import Round
from heli_lab.explain.contributions import TIME, MissingTerm, SplineCurve, accelerations
from heli_lab.explain.prediction import ErrorReduction
from heli_lab.explain.proposal import ProposedTerm, TermTrace, latex
from heli_lab.explain.residuals import FailingRegions, RegionTest
from heli_lab.explain.result import Diagnosis
from heli_lab.explain.thresholds import FALSE_DISCOVERY_RATE
from heli_lab.explain.wording import channel_in_words, display_unit, quantity_in_words, readable_id
from heli_lab.fit.estimator import Estimate
from heli_lab.fit.identification import Trace, trace
from heli_lab.fit.innovations import SmoothedDisturbances, smoothed_disturbances
from heli_lab.fit.problem import Fit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


BEFORE, AFTER = "#d1495b", "#0b5fa5"
MEASURED: Final = "#30343a"
"""Colours of the baseline, the extended model and the measurement in all figures."""
MAX_ROUNDS: Final = 4
"""Rounds that are drawn; the table has all."""
_BARS, _SPLINE_BARS = 7, 3
"""Candidates of a round that are drawn: effects, then splines."""
_MAX_POINTS: Final = 5000
"""Points of a drawn line: more are not visible."""
_EQUATION_POINTS: Final = 12.0
"""Font size of a typeset equation."""


def figure_of_flight(before: Fit, after: Fit) -> Figure:
    """Draw the flight of the fits `before` and `after`: measured and simulated angles, and their errors."""
    from matplotlib.figure import Figure

    baseline, runs = trace(before), _free_runs(before, after)
    figure = Figure(figsize=(11, 9))
    panels = figure.subplots(6, 1, sharex=True, height_ratios=[2, 1.2, 2, 1.2, 2, 1.2])
    figure.subplots_adjust(left=0.075, bottom=0.06, right=0.87, top=0.95, hspace=0.12)
    thinned_rows = thinned(len(baseline.t_s), _MAX_POINTS)
    # For each axis, a panel of the angle and, below it, a panel of the error.
    for axis, (angle_panel, error_panel) in enumerate(panels.reshape(3, 2)):
        angle_panel.plot(
            baseline.t_s[thinned_rows],
            np.rad2deg(baseline.measured_rad[thinned_rows, axis]),
            ".",
            ms=1.8,
            color=MEASURED,
            label="measured",
        )
        angle_panel.set_ylabel(f"{AXES[axis]} [deg]")
        for run, color, label in runs:
            predicted_deg = np.rad2deg(run.predicted_rad[:, axis])
            angle_panel.plot(*_with_window_gaps(run, predicted_deg), color=color, lw=1.0, label=label)
            error_deg = np.rad2deg(run.residual[:, axis] * run.sigma_rad[axis])
            error_text = f"rms {_rms(error_deg):.3g}"
            error_panel.plot(*_with_window_gaps(run, error_deg), color=color, lw=0.7, label=error_text)
        error_panel.set_ylabel("error [deg]")
        _legend_beside(error_panel)
        for panel in (angle_panel, error_panel):
            panel.grid(alpha=0.25)
    _legend_beside(panels[0])
    panels[-1].set_xlabel("time [s]; the simulation restarts every 2 s, from the state that fits best")
    figure.suptitle(f"{baseline.label}: measured against simulated", fontsize=11)
    return figure


def figure_of_windows(before: Fit, after: Fit) -> Figure:
    """Draw one panel per axis: the window of 2 s in which the baseline, `before`, has its largest error."""
    from matplotlib.figure import Figure

    baseline, runs = trace(before), _free_runs(before, after)
    figure = Figure(figsize=(11, 3.4))
    panels = figure.subplots(1, 3)
    figure.subplots_adjust(left=0.06, bottom=0.22, right=0.98, top=0.92, wspace=0.18)
    for axis, panel in enumerate(panels):
        worst_window = max(
            baseline.windows, key=lambda window: float(np.mean(baseline.residual[window, axis] ** 2))
        )
        t_s = baseline.t_s[worst_window]
        panel.plot(
            t_s,
            np.rad2deg(baseline.measured_rad[worst_window, axis]),
            ".",
            ms=3,
            color=MEASURED,
            label="measured",
        )
        error_texts = []
        for run, color, label in runs:
            panel.plot(
                t_s, np.rad2deg(run.predicted_rad[worst_window, axis]), color=color, lw=1.3, label=label
            )
            # Residuals are in multiples of the encoder's standard deviation.
            error_deg = np.rad2deg(_rms(run.residual[worst_window, axis]) * run.sigma_rad[axis])
            error_texts.append(f"{error_deg:.3g} deg {label}")
        panel.set_title(f"{AXES[axis]}: rms {', '.join(error_texts)}", fontsize=9)
        panel.set_xlabel("time [s]")
        panel.grid(alpha=0.25)
    panels[0].set_ylabel("angle [deg]")
    lines, names = panels[0].get_legend_handles_labels()
    figure.legend(lines, names, loc="lower center", ncols=3, fontsize=8, frameon=False)
    return figure


def _free_runs(before: Fit, after: Fit) -> list[tuple[Trace, str, str]]:
    """Return the free runs of the baseline and of the extended model, if any, with colour and label."""
    runs = [(trace(before), BEFORE, "baseline")]
    if after is not before:
        runs.append((trace(after), AFTER, "extended"))
    return runs


def figure_of_torque(diagnosis: Diagnosis) -> Figure:
    """Draw the missing torque about each axis, over time and as a spectrum."""
    from matplotlib.figure import Figure

    torques = [(_smoothed_torques(diagnosis.search.baseline.estimate), BEFORE, "baseline")]
    if diagnosis.assessment.extended.candidates:
        torques.append(
            (_smoothed_torques(diagnosis.assessment.extended.estimate), AFTER, "with all named causes")
        )
    figure = Figure(figsize=(11, 6.5))
    panels = figure.subplots(3, 2, width_ratios=[2.4, 1])
    figure.subplots_adjust(left=0.07, bottom=0.08, right=0.98, top=0.91, wspace=0.12, hspace=0.35)
    for axis, (time_panel, spectrum_panel) in enumerate(panels):
        for (t_s, torque_Nm, _), color, label in torques:
            value_mNm = 1e3 * torque_Nm[:, axis]
            legend_text = f"{label}: rms {_rms(value_mNm):.3g} mN m"
            time_panel.plot(*broken_at_gaps(t_s, value_mNm), color=color, lw=0.7, label=legend_text)
            spectrum_panel.loglog(*_amplitude_spectrum(t_s, value_mNm), color=color, lw=0.9)
        time_panel.set_ylabel(f"{AXES[axis]} [mN m]")
        _legend_above(time_panel)
        for panel in (time_panel, spectrum_panel):
            panel.grid(alpha=0.25)
    figure.suptitle("torque about each axis that the model lacks, and its spectrum", fontsize=11)
    panels[0, 1].set_title("[mN m / sqrt(Hz)]", fontsize=8)
    panels[2, 0].set_xlabel("time [s]")
    panels[2, 1].set_xlabel("frequency [Hz]")
    return figure


def figure_of_ranking(rounds: tuple[Round, ...]) -> Figure:
    """Draw the scores of the candidates, one panel per round; narrow bars are gains of refits."""
    from matplotlib.figure import Figure

    drawn_rounds = rounds[:MAX_ROUNDS]
    height = 2.9 * len(drawn_rounds)
    figure = Figure(figsize=(11, height))
    panels: Floats = np.atleast_1d(figure.subplots(len(drawn_rounds), 1))
    figure.subplots_adjust(left=0.32, bottom=0.5 / height, right=0.98, top=1.0 - 0.3 / height, hspace=0.4)
    for number, (round_, panel) in enumerate(zip(drawn_rounds, panels, strict=True), 1):
        _draw_round(round_, number, panel)
    panels[-1].set_xlabel("log-likelihood ratio [nats]; grey: score test, blue: refitted", fontsize=9)
    return figure


def _draw_round(round_: Round, number: int, panel: Axes) -> None:
    """Draw scores and refits of the best candidates of a round as horizontal bars."""
    refits = {refit.candidate.id: refit for refit in round_.refits}
    candidates = sorted(
        (*round_.screened[:_BARS], *round_.splines[:_SPLINE_BARS]),
        key=lambda scored: scored.log_likelihood_gain,
    )
    names = [readable_id(scored.candidate.id) for scored in candidates]
    rows = np.arange(len(candidates))
    # On a logarithmic axis, a bar of 0 cannot be drawn; 0.1 is left of the axis.
    gains = [max(scored.log_likelihood_gain, 0.1) for scored in candidates]
    panel.barh(rows, gains, color="#dddddd", label="score test")
    for row, scored in enumerate(candidates):
        refit = refits.get(scored.candidate.id)
        if refit is not None:
            color = AFTER if scored.candidate.id == round_.accepted_id else "#8fb3d1"
            panel.barh(row, max(refit.gain, 0.1), height=0.4, color=color)
            text = f"  {refit.gain:.0f} refitted"
            end_of_bars = max(scored.log_likelihood_gain, refit.gain, 1.0)
            panel.text(end_of_bars, row, text, va="center", fontsize=7)
    panel.set_xscale("log")
    largest_gain = max([*gains, *(refit.gain for refit in refits.values())])
    # Five times the largest gain leaves space for the texts.
    panel.set_xlim(1.0, max(10.0, 5.0 * largest_gain))
    panel.set_yticks(rows, names, fontsize=8)
    outcome = f"accepted: {readable_id(round_.accepted_id)}" if round_.accepted_id else "nothing accepted"
    panel.set_title(f"round {number}: {outcome}", fontsize=10, loc="left")


def figure_of_size(diagnosis: Diagnosis) -> Figure | None:
    """Draw the acceleration that each cause contributes along the first fitted flight."""
    from matplotlib.figure import Figure

    if not diagnosis.verdict.causes:
        return None
    figure = Figure(figsize=(11, 5.5))
    panels = figure.subplots(3, 1, sharex=True)
    figure.subplots_adjust(left=0.08, bottom=0.09, right=0.98, top=0.9, hspace=0.3)
    for number, cause in enumerate(diagnosis.verdict.causes):
        t_s, change_rad_s2 = accelerations(diagnosis.assessment.extended.estimate, cause.candidate.id)
        for axis, panel in enumerate(panels):
            change_deg_s2 = np.rad2deg(change_rad_s2[:, axis])
            size_text = (
                f"rms {_rms(change_deg_s2):.3g} deg/s$^2$" if change_deg_s2.any() else "no acceleration"
            )
            legend_text = f"{cause.candidate.id}: {size_text}"
            # The parts of a flight that were left out have no acceleration.
            drawn = broken_at_gaps(t_s, change_deg_s2)
            panel.plot(*drawn, lw=0.7, color=f"C{number}", label=legend_text)
    for axis, panel in enumerate(panels):
        panel.set_ylabel(f"{AXES[axis]} [deg/s$^2$]")
        panel.grid(alpha=0.25)
        _legend_above(panel)
    figure.suptitle("acceleration that each cause contributes in the fitted flight", fontsize=11)
    panels[-1].set_xlabel("time [s]")
    return figure


def figure_of_curves(curves: Sequence[SplineCurve]) -> Figure:
    """Draw the curves of spline terms, one panel each, with two standard errors."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 3.4))
    panels = np.atleast_1d(figure.subplots(1, len(curves)))
    figure.subplots_adjust(left=0.08, bottom=0.16, right=0.98, top=0.92, wspace=0.25)
    for curve, panel in zip(curves, panels, strict=True):
        low, high = curve.value - 2.0 * curve.std, curve.value + 2.0 * curve.std
        panel.fill_between(curve.quantity, low, high, color=AFTER, alpha=0.2, lw=0)
        panel.plot(curve.quantity, curve.value, color=AFTER)
        panel.set_xlabel(f"{quantity_in_words(curve.on)} [{curve.quantity_unit}]")
        panel.set_ylabel(f"{channel_in_words(curve.channel)} [{curve.value_unit}]", fontsize=9)
        panel.grid(alpha=0.25)
    return figure


def figure_of_latex(latex: str) -> Figure | None:
    """Typeset an equation in `latex` (without dollar signs); None if matplotlib cannot."""
    from matplotlib.figure import Figure
    from matplotlib.mathtext import MathTextParser

    text = "$" + latex.replace("\\boldsymbol", "\\mathbf") + "$"
    try:
        width, height, depth, *_ = MathTextParser("path").parse(text, dpi=72)
    except ValueError:  # mathtext knows only a part of LaTeX
        return None
    scale = _EQUATION_POINTS / 10.0 / 72.0
    figure = Figure(figsize=(width * scale + 0.1, (height + depth) * scale + 0.1))
    figure.text(0.5, 0.5, text, ha="center", va="center", fontsize=_EQUATION_POINTS)
    return figure


def thinned(count: int, max_count: int) -> slice:
    """Return a slice that selects evenly spaced rows of `count` rows: between `max_count` and twice that."""
    return slice(None, None, max(1, count // max_count))


def bin_means(quantity: Floats, value: Floats, bins: int) -> tuple[Floats, Floats]:
    """Return the means of a `quantity` and of a dependent `value` in `bins` bins, shape (bins,) each."""
    # The bins divide the rows, sorted by the quantity, into equal parts.
    bin_rows = np.array_split(np.argsort(quantity), min(bins, len(quantity)))
    mean_quantity = np.array([quantity[rows].mean() for rows in bin_rows])
    mean_value = np.array([value[rows].mean() for rows in bin_rows])
    return mean_quantity, mean_value


def _rms(values: Floats) -> float:
    """Return the root mean square of values."""
    return float(np.sqrt(np.mean(values**2)))


def _legend_beside(panel: Axes) -> None:
    """Place the legend to the right of a panel."""
    panel.legend(loc="upper left", bbox_to_anchor=(1.0, 1.03), fontsize=8, frameon=False)


def _legend_above(panel: Axes) -> None:
    """Place the legend in a line above a panel."""
    position = (1.0, 0.97)
    panel.legend(loc="lower right", bbox_to_anchor=position, ncols=4, fontsize=8, frameon=False)


def _with_window_gaps(run: Trace, values: Floats) -> tuple[Floats, Floats]:
    """Return times [s] and `values` (m,) of a run, thinned, with nan after each window."""
    t_s: list[Floats] = []
    thinned_values: list[Floats] = []
    step = max(1, len(run.t_s) // _MAX_POINTS)
    for window in run.windows:
        thinned_rows = slice(window.start, window.stop, step)
        last_row = slice(window.stop - 1, window.stop)
        t_s += [run.t_s[thinned_rows], run.t_s[last_row]]
        thinned_values += [values[thinned_rows], np.array([np.nan])]
    return np.concatenate(t_s), np.concatenate(thinned_values)


def _smoothed_torques(estimate: Estimate) -> SmoothedDisturbances:
    """Return the smoothed disturbance torques [N m] of the first fitted flight."""
    return smoothed_disturbances(estimate.filtered(), estimate.disturbances)[0]


def _amplitude_spectrum(t_s: Floats, value: Floats) -> tuple[Floats, Floats]:
    """Return frequencies [Hz] and the root of the power spectral density, by Welch's method."""
    step_s = float(np.median(np.diff(t_s)))
    size = min(len(value), 1024)
    segments = [value[start : start + size] for start in range(0, len(value) - size + 1, size // 2)]
    window = np.hanning(size)
    power = np.mean(
        [np.abs(np.fft.rfft((segment - segment.mean()) * window)) ** 2 for segment in segments], axis=0
    )
    density: Floats = np.sqrt(2.0 * power * step_s / np.sum(window**2)).astype(np.float64)
    frequency_Hz: Floats = np.fft.rfftfreq(size, step_s).astype(np.float64)
    is_drawn = (frequency_Hz > 0.0) & (frequency_Hz < 20.0)
    # A positive lower bound, because the axis is logarithmic.
    return frequency_Hz[is_drawn], np.maximum(density[is_drawn], 1e-6)


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
    """Draw the missing torques or angles of `terms` over the quantities that they depend on."""
    # Each cause has a row. The left panel shows the missing values without the cause in the model, together
    # with the equation of the cause. The right panel shows the remaining values with the cause in the model.
    from matplotlib.figure import Figure

    height = 4.1 * len(terms)
    figure = Figure(figsize=(11, height))
    panels = figure.subplots(len(terms), 2, sharey="row", squeeze=False)
    figure.subplots_adjust(
        left=0.085, bottom=0.62 / height, right=0.985, top=1.0 - 0.6 / height, wspace=0.05, hspace=0.48
    )
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
        # The contribution may depend on more than this quantity: its means are a line, its dots a cloud.
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
    # The limits of the panels leave out the tails, in which few dots are far away.
    bar = 2.0 * term.std if term.what == "angle" else np.zeros(1)  # only angles have error bars
    values = np.concatenate((term.missing - bar, term.missing + bar, term.remaining, term.contribution))
    low, high = np.quantile(values, [_TAIL, 1.0 - _TAIL])
    margin = 0.12 * (high - low)
    before.set_ylim(min(low, contribution.min()) - margin, max(high, contribution.max()) + margin)
    ends = np.quantile(term.quantity, [_TAIL, 1.0 - _TAIL])
    for panel in (before, after):
        panel.set_xlim(*(ends + np.array([-0.03, 0.03]) * np.ptp(ends)))
    before.legend(loc="best", fontsize=9, framealpha=0.85)


def _part_of_largest_contribution(term: MissingTerm) -> MissingTerm:
    """Return the `_LINES_s` of one flight in which a term contributes most."""
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
    """Draw free runs of 2 s: the angle of an axis, and the errors of all three axes."""
    from matplotlib.figure import Figure

    baseline, extended = trace(before), trace(after)
    first_axis = AXES.index(first)
    axes = [first_axis, *(axis for axis in range(3) if axis != first_axis)]
    excerpt = _rows_with_largest_error(baseline, first_axis)
    t_s = baseline.t_s[excerpt]
    figure = Figure(figsize=(11, 7.2))
    panels = figure.subplots(4, 1, sharex=True, height_ratios=[2.4, 1.3, 1.0, 1.0])
    figure.subplots_adjust(left=0.085, bottom=0.075, right=0.985, top=0.955, hspace=0.13)
    angle_panel = panels[0]
    measured_deg = np.rad2deg(baseline.measured_rad[excerpt, first_axis])
    angle_panel.plot(t_s, measured_deg, ".", ms=2.2, color=MEASURED, label="measured")
    _draw_runs(panels, baseline, excerpt, axes, BEFORE, "baseline")
    if before is not after:
        _draw_runs(panels, extended, excerpt, axes, AFTER, "extended")
    _shade_extrapolations(panels, t_s, outside_s)
    angle_panel.set_ylabel(f"{first} [deg]", fontsize=10)
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
    """Draw the simulated angle of a model into the first panel, and the errors of its axes into the
    others.
    """
    # `axes` are the axes of the error panels; the first of them is the axis of the angle.
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
    """Return the rows of consecutive windows in which the error of an axis is largest."""
    # The windows have a total duration of at most `_EXCERPT_s`; if a single window is longer, the first one
    # is returned.
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
    figure.subplots_adjust(left=0.065, bottom=0.155, right=0.985, top=0.83, wspace=0.18)
    positions = np.arange(len(horizons))
    bar_width = 0.32
    bar_offset = 0.18 if extended else 0.0  # two bars stand next to each other, a single one in the middle
    for axis, panel, rounding_deg in zip(AXES, panels, np.rad2deg(rounding_rad), strict=True):
        reductions = [horizon[axis] for horizon in horizons.values()]
        before_deg = np.array([reduction.before_deg for reduction in reductions])
        after_deg = np.array([reduction.after_deg for reduction in reductions])
        interval_deg = before_deg * np.array([reduction.interval95 for reduction in reductions]).T
        panel.bar(positions - bar_offset, before_deg, bar_width, color=BEFORE, label="baseline")
        panel.set_xticks(positions, [f"{key} s" for key in horizons])
        panel.axhline(rounding_deg, color=MEASURED, lw=1.0, ls="--", label="rounding of the encoder alone")
        panel.set_title(axis, fontsize=10.5, loc="left")
        panel.set_xlabel("length of the free run", fontsize=9)
        panel.grid(axis="y", alpha=0.25)
        panel.set_axisbelow(True)
        if not extended:
            # A range from 0 to 0 is invalid.
            panel.set_ylim(0.0, 1.5 * float(max(before_deg.max(), rounding_deg)) or 1.0)
            continue
        panel.bar(positions + bar_offset, after_deg, bar_width, color=AFTER, label="extended")
        whiskers_deg = np.abs(interval_deg - after_deg)
        panel.errorbar(
            positions + bar_offset,
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


_MISSING, _TERM, _OUTLINE = "#8d959e", "#0b5fa5", "#111111"
_POINTS: Final = 4000
"""Dots of a scatter plot: more hide each other."""
_MEANS: Final = 24
"""Means over equal parts of the dots: fewer hide a bend, more show noise."""


def figure_of_equation(proposed: ProposedTerm) -> Figure:
    """Draw the equation of a `proposed` term along a flight, together with the missing torque."""
    from matplotlib.figure import Figure

    trace = proposed.trace
    figure = Figure(figsize=(11, 6.6))
    grid = figure.add_gridspec(2, 2, left=0.08, right=0.98, bottom=0.08, top=0.88, hspace=0.32, wspace=0.22)
    time_panel, scatter_panel, quantity_panel = (
        figure.add_subplot(cell) for cell in (grid[0, :], grid[1, 0], grid[1, 1])
    )
    missing_mNm, term_mNm = 1e3 * trace.missing_Nm, 1e3 * trace.term_Nm
    _draw_equation_over_time(time_panel, trace)
    thinned_rows = thinned(len(term_mNm), _POINTS)
    scatter_panel.plot(
        term_mNm[thinned_rows], missing_mNm[thinned_rows], ".", color=_MISSING, ms=2.5, alpha=0.6
    )
    span = np.array([min(term_mNm.min(), missing_mNm.min()), max(term_mNm.max(), missing_mNm.max())])
    scatter_panel.plot(span, span, color=_TERM, lw=1.2)
    correlation = np.corrcoef(term_mNm, missing_mNm)[0, 1] if term_mNm.std() > 0 else 0.0
    scatter_panel.set_xlabel(f"equation [mN m]; correlation {correlation:.2f}")
    scatter_panel.set_ylabel("missing without it [mN m]")
    factor, unit = display_unit(trace.unit)
    quantity_panel.plot(
        factor * trace.value[thinned_rows], missing_mNm[thinned_rows], ".", color=_MISSING, ms=2.5, alpha=0.6
    )
    quantity_panel.plot(factor * trace.value[thinned_rows], term_mNm[thinned_rows], ".", color=_TERM, ms=2.0)
    quantity_panel.set_xlabel(f"{trace.on.replace('_', ' ')} [{unit}]")
    quantity_panel.set_ylabel("torque [mN m]")
    for panel in (time_panel, scatter_panel, quantity_panel):
        panel.grid(alpha=0.25)
    flight_text = (
        "a flight that no fit used" if proposed.discovery.held_out_nats is not None else "the fitted flight"
    )
    figure.suptitle(f"${latex(proposed.equation, proposed.numbers)}$   on {flight_text}", fontsize=11)
    return figure


def _draw_equation_over_time(panel: Axes, trace: TermTrace) -> None:
    """Draw the missing torque with two standard errors, and the torque of the equation, over time."""
    missing_mNm, two_std_mNm = 1e3 * trace.missing_Nm, 2e3 * trace.std_Nm
    panel.fill_between(
        trace.t_s, missing_mNm - two_std_mNm, missing_mNm + two_std_mNm, color=_MISSING, alpha=0.25, lw=0
    )
    label = "missing without the equation, with two standard errors"
    panel.plot(trace.t_s, missing_mNm, color=_MISSING, lw=0.9, label=label)
    panel.plot(trace.t_s, 1e3 * trace.term_Nm, color=_TERM, lw=1.3, label="equation")
    panel.set_xlabel(f"time in {trace.label} [s]")
    panel.set_ylabel(f"torque about {trace.axis} [mN m]")
    panel.legend(loc="lower right", bbox_to_anchor=(1.0, 0.99), ncols=2, fontsize=8, frameon=False)


def figure_of_failing_regions(all_regions: Sequence[FailingRegions], models: Sequence[str]) -> Figure:
    """Draw the fitted flights in the plane of each axis, coloured by the missing torque; cells in which a
    model fails are outlined.
    """
    from matplotlib.figure import Figure

    height = 0.8 + 4.1 * len(all_regions)
    figure = Figure(figsize=(11, height))
    rows = figure.subplots(len(all_regions), len(models), sharex="row", sharey="row", squeeze=False)
    figure.subplots_adjust(
        left=0.075, bottom=0.55 / height, right=0.9, top=1.0 - 0.85 / height, wspace=0.1, hspace=0.34
    )
    for regions, panels in zip(all_regions, rows, strict=True):
        _regions_row(figure, panels, regions, models)
    figure.suptitle(
        "outlined: cells in which the missing torque is too large for chance;"
        f" about {100 * FALSE_DISCOVERY_RATE:.0f} % of the outlined cells are false",
        y=1.0 - 0.2 / height,
        fontsize=11,
    )
    return figure


def _regions_row(
    figure: Figure, panels: Sequence[Axes], regions: FailingRegions, models: Sequence[str]
) -> None:
    """Draw the plane of one axis for each model, with a colour bar of the missing torque."""
    torques = np.concatenate([np.abs(flight.torque_Nm) for flight in regions.before.flights])
    # Single large torques must not make all others pale; a colour range of 0 is invalid.
    color_limit_mNm = 1e3 * float(np.quantile(torques, 0.98)) or 1.0
    (x_factor, x_unit), (y_factor, y_unit) = (
        _display_factor_and_unit(regions.x),
        _display_factor_and_unit(regions.y),
    )
    points = None
    # A model that was not extended has the panel before the extension only.
    for panel, test, model in zip(panels, (regions.before, regions.after), models, strict=False):
        for flight in test.flights:
            panel.plot(
                x_factor * flight.x, y_factor * flight.y, color="#d7dbe0", lw=0.4, zorder=1, rasterized=True
            )
            points = panel.scatter(
                x_factor * flight.x,
                y_factor * flight.y,
                c=1e3 * flight.torque_Nm,
                s=5,
                cmap="coolwarm",
                vmin=-color_limit_mNm,
                vmax=color_limit_mNm,
                zorder=2,
                lw=0,
            )
        _outline_failing_cells(panel, regions, test)
        panel.set_title(f"{regions.axis}: {model}", fontsize=10, loc="left")
        panel.set_xlabel(f"{regions.x.replace('_', ' ')} [{x_unit}]")
        panel.grid(alpha=0.2)
    panels[0].set_ylabel(f"{regions.y.replace('_', ' ')} [{y_unit}]")
    if points is not None:
        box = panels[-1].get_position()
        colorbar = figure.colorbar(points, cax=figure.add_axes((0.915, box.y0, 0.015, box.height)))
        colorbar.set_label(f"missing torque about {regions.axis} [mN m]", fontsize=9)


def figure_of_unknown_torque(regions: FailingRegions) -> Figure:
    """Draw the torque that the model after the extension lacks, over the first quantity of `regions`."""
    from matplotlib.figure import Figure

    flights = regions.after.flights
    factor, unit = _display_factor_and_unit(regions.x)
    quantity = factor * np.concatenate([flight.x for flight in flights])
    torque_mNm = 1e3 * np.concatenate([flight.torque_Nm for flight in flights])
    thinned_rows = thinned(len(quantity), _POINTS)
    figure = Figure(figsize=(11, 3.6))
    panel = figure.subplots()
    figure.subplots_adjust(left=0.08, bottom=0.16, right=0.98, top=0.9)
    panel.plot(
        quantity[thinned_rows], torque_mNm[thinned_rows], ".", ms=2.5, color="#b4b9bf", rasterized=True
    )
    panel.plot(*bin_means(quantity, torque_mNm, _MEANS), "o", ms=5, color=_OUTLINE, label="means")
    panel.set_title(
        f"unknown: torque about {regions.axis} that the model with all named causes lacks",
        fontsize=10.5,
        loc="left",
    )
    panel.set_xlabel(f"{regions.x.replace('_', ' ')} [{unit}]")
    panel.set_ylabel(f"torque about {regions.axis} [mN m]")
    panel.grid(alpha=0.25)
    panel.legend(loc="best", fontsize=9)
    return figure


def _outline_failing_cells(panel: Axes, regions: FailingRegions, test: RegionTest) -> None:
    """Draw lines between cells that fail and cells that do not."""
    (x_factor, _), (y_factor, _) = _display_factor_and_unit(regions.x), _display_factor_and_unit(regions.y)
    # A frame of cells that do not fail, so that each cell has neighbours.
    x, y, fails = x_factor * regions.x_edges, y_factor * regions.y_edges, np.pad(test.fails, 1)
    for i in range(len(x)):
        for j in range(len(y)):
            if j + 1 < len(y) and fails[i, j + 1] != fails[i + 1, j + 1]:
                panel.plot([x[i], x[i]], [y[j], y[j + 1]], color=_OUTLINE, lw=1.8, zorder=3)
            if i + 1 < len(x) and fails[i + 1, j] != fails[i + 1, j + 1]:
                panel.plot([x[i], x[i + 1]], [y[j], y[j]], color=_OUTLINE, lw=1.8, zorder=3)


def _display_factor_and_unit(quantity: str) -> tuple[float, str]:
    """Return the factor from the SI unit of a quantity to its display unit, and that unit."""
    return display_unit(QUANTITIES[quantity].unit)
