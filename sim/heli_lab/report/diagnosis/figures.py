"""Figures behind a diagnosis: the whole flight, missing torques, scores, curves.

Margins are set by hand, because matplotlib's own layout takes as long as the rest of the report.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_host.data.flight import broken_at_gaps
from heli_sim.model.parts import AXES

from heli_lab.explain.discover.effect_contribution import accelerations
from heli_lab.explain.discover.spline_curve import SplineCurve
from heli_lab.explain.result import Diagnosis
from heli_lab.explain.search.hypothesis import Round
from heli_lab.explain.wording import channel_in_words, quantity_in_words, readable_id
from heli_lab.fit.estimator import Estimate
from heli_lab.fit.identification import Trace, trace
from heli_lab.fit.innovations import smoothed_disturbances
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
    figure.subplots_adjust(0.075, 0.06, 0.87, 0.95, hspace=0.12)
    thinned_rows = thinned(len(baseline.t_s), _MAX_POINTS)
    for axis in range(3):
        angle_panel, error_panel = panels[2 * axis], panels[2 * axis + 1]
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
    """Draw one panel per axis: the window of 2 s in which the baseline, `before`, has its largest error.

    The extended model, `after`, is drawn in the same window.
    """
    from matplotlib.figure import Figure

    baseline, runs = trace(before), _free_runs(before, after)
    figure = Figure(figsize=(11, 3.4))
    panels = figure.subplots(1, 3)
    figure.subplots_adjust(0.06, 0.22, 0.98, 0.92, wspace=0.18)
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
    """Draw the missing torque about each axis, over time and as a spectrum.

    The baseline is compared with the model that has all named causes.
    """
    from matplotlib.figure import Figure

    torques = [(_smoothed_torque(diagnosis.search.baseline.estimate), BEFORE, "baseline")]
    if diagnosis.assessment.extended.candidates:
        torques.append(
            (_smoothed_torque(diagnosis.assessment.extended.estimate), AFTER, "with all named causes")
        )
    figure = Figure(figsize=(11, 6.5))
    panels = figure.subplots(3, 2, width_ratios=[2.4, 1])
    figure.subplots_adjust(0.07, 0.08, 0.98, 0.91, wspace=0.12, hspace=0.35)
    for axis in range(3):
        for (t_s, torque_Nm), color, label in torques:
            value_mNm = 1e3 * torque_Nm[:, axis]
            legend_text = f"{label}: rms {_rms(value_mNm):.3g} mN m"
            panels[axis, 0].plot(*broken_at_gaps(t_s, value_mNm), color=color, lw=0.7, label=legend_text)
            panels[axis, 1].loglog(*_amplitude_spectrum(t_s, value_mNm), color=color, lw=0.9)
        panels[axis, 0].set_ylabel(f"{AXES[axis]} [mN m]")
        _legend_above(panels[axis, 0])
        for panel in panels[axis]:
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
    figure.subplots_adjust(0.32, 0.5 / height, 0.98, 1.0 - 0.3 / height, hspace=0.4)
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
    gains = [max(scored.log_likelihood_gain, 0.1) for scored in candidates]
    panel.barh(rows, gains, color="#dddddd", label="score test")
    for row, scored in enumerate(candidates):
        refit = refits.get(scored.candidate.id)
        if refit is not None:
            color = AFTER if scored.candidate.id == round_.accepted_id else "#8fb3d1"
            panel.barh(row, max(refit.gain, 0.1), height=0.4, color=color)
            text = f"  {refit.gain:.0f} refitted"
            panel.text(max(scored.log_likelihood_gain, refit.gain, 1.0), row, text, va="center", fontsize=7)
    panel.set_xscale("log")
    largest_gain = max([*gains, *(refit.gain for refit in refits.values())])
    panel.set_xlim(1.0, max(10.0, 5.0 * largest_gain))
    panel.set_yticks(rows, names, fontsize=8)
    outcome = f"accepted: {readable_id(round_.accepted_id)}" if round_.accepted_id else "nothing accepted"
    panel.set_title(f"round {number}: {outcome}", fontsize=10, loc="left")


def figure_of_size(diagnosis: Diagnosis) -> Figure | None:
    """Draw the acceleration that each cause contributes along the first fitted flight.

    The result is None without causes.
    """
    from matplotlib.figure import Figure

    if not diagnosis.verdict.causes:
        return None
    figure = Figure(figsize=(11, 5.5))
    panels = figure.subplots(3, 1, sharex=True)
    figure.subplots_adjust(0.08, 0.09, 0.98, 0.9, hspace=0.3)
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
    """Draw the curves of spline terms, one panel each, with two standard errors.

    Spline terms stand in the model for causes that the catalogue lacks.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 3.4))
    panels = np.atleast_1d(figure.subplots(1, len(curves)))
    figure.subplots_adjust(0.08, 0.16, 0.98, 0.92, wspace=0.25)
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
    except ValueError:
        return None
    scale = _EQUATION_POINTS / 10.0 / 72.0
    figure = Figure(figsize=(width * scale + 0.1, (height + depth) * scale + 0.1))
    figure.text(0.5, 0.5, text, ha="center", va="center", fontsize=_EQUATION_POINTS)
    return figure


def thinned(count: int, max_count: int) -> slice:
    """Return a slice that selects evenly spaced rows of `count` rows: between `max_count` and twice that."""
    return slice(None, None, max(1, count // max_count))


def bin_means(quantity: Floats, value: Floats, bins: int) -> tuple[Floats, Floats]:
    """Return the means of a `quantity` and of a dependent `value` in `bins` bins, shape (bins,) each.

    The bins divide the rows, sorted by the quantity, into equal parts.
    """
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


def _smoothed_torque(estimate: Estimate) -> tuple[Floats, Floats]:
    """Return times (k,) [s] and smoothed disturbance torques (k, 3) [N m] of the first fitted flight."""
    t_s, torque_Nm, _ = smoothed_disturbances(estimate.filtered(), estimate.disturbances)[0]
    return t_s, torque_Nm


def _amplitude_spectrum(t_s: Floats, value: Floats) -> tuple[Floats, Floats]:
    """Return frequencies [Hz] and the root of the power spectral density, by Welch's method.

    The spectrum is the mean over segments of 1024 values that overlap by half.
    """
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
