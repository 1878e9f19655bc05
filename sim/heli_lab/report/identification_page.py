"""The report of an identification: one HTML page that needs no other file, and its figures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from heli_host.data.flight import broken_at_gaps
from heli_sim.model.effect import AXES

from heli_lab.fit.identification import Identification, Trace, rounded, unexcited_axes
from heli_lab.fit.thresholds import QUANTISATION_ONLY
from heli_lab.report.page import folder_with, write_page
from heli_lab.report.page.drawing import Drawing

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_MEASURED, _PREDICTED, _RESIDUAL = "#222222", "#d1495b", "#0b5fa5"
_MAX_POINTS = 6000
"""Points of a curve, about: no more than a page can show."""
_MIN_AXIS_COUNTS = 1.0
"""Smallest range of an error axis to either side, in encoder counts, so that the grey band stays visible."""


def identification_figure(trace: Trace, role: str) -> Figure:
    """Draw measured and predicted angles, with the error below each axis: six panels on one time axis."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 9), layout="constrained")
    panels = figure.subplots(6, 1, sharex=True, height_ratios=[2, 1, 2, 1, 2, 1])
    drawn_rows = slice(None, None, max(1, len(trace.t_s) // _MAX_POINTS))
    t_s = trace.t_s[drawn_rows]
    measured_deg = np.rad2deg(trace.measured_rad[drawn_rows])
    predicted_deg = np.rad2deg(trace.predicted_rad[drawn_rows])
    label = "predicted freely, window by window"
    for index, (axis, (above, below)) in enumerate(zip(AXES, panels.reshape(3, 2), strict=True)):
        measured, predicted = measured_deg[:, index], predicted_deg[:, index]
        above.plot(*broken_at_gaps(t_s, measured), color=_MEASURED, lw=1.0, label="measured")
        above.plot(*broken_at_gaps(t_s, predicted), color=_PREDICTED, lw=0.8, label=label)
        above.set_ylabel(f"{axis} [deg]")
        error_deg = np.rad2deg(trace.residual[drawn_rows, index] * trace.sigma_rad[index])
        # The error of rounding is uniform over a count, so its standard deviation is count / sqrt(12).
        count_deg = np.rad2deg(trace.sigma_rad[index]) * np.sqrt(12.0)
        below.axhspan(-0.5 * count_deg, 0.5 * count_deg, color="#e5e5e5", label="half a count")
        below.plot(*broken_at_gaps(t_s, error_deg), color=_RESIDUAL, lw=0.6)
        below.set_ylabel("error [deg]")
        largest_deg = float(np.nanmax(np.abs(error_deg), initial=0.0))
        limit_deg = max(_MIN_AXIS_COUNTS * count_deg, largest_deg * 1.05)
        below.set_ylim(-limit_deg, limit_deg)
        for panel in (above, below):
            panel.grid(alpha=0.25)
            for window in trace.windows:
                panel.axvline(trace.t_s[window.start], color="#bbbbbb", lw=0.4)
    legend_entries = [*panels[0].get_lines()[:2], *panels[1].patches[:1]]
    panels[0].legend(
        handles=legend_entries, loc="lower right", bbox_to_anchor=(1.0, 1.0), fontsize=8, ncols=3
    )
    panels[-1].set_xlabel("time [s]; thin lines: where a window begins and the state is free")
    panels[0].set_title(f"{trace.label} ({role})", loc="left", fontsize=11)
    return figure


def figure_of_parameters(identification: Identification) -> Figure:
    """Draw each parameter's change from its prior mean, in standard deviations of the prior."""
    from matplotlib.figure import Figure

    problem, fit = identification.fit.problem, identification.fit
    names = problem.names
    # The first parameter is at the top.
    y_position = np.arange(len(names))[::-1]
    change = (fit.theta - problem.parameter_vector.mean) / problem.parameter_vector.std
    half_interval = 2.0 * np.array(list(fit.std.values())) / problem.parameter_vector.std
    figure = Figure(figsize=(8, 1.2 + 0.28 * len(names)), layout="constrained")
    panel = figure.subplots()
    panel.axvspan(-2, 2, color="#eeeeee", label="prior, 95 %")
    label = "estimate, 95 %"
    panel.errorbar(
        change, y_position, xerr=half_interval, fmt="o", ms=4, color=_RESIDUAL, capsize=3, label=label
    )
    panel.set_yticks(y_position, names)
    panel.set_xlabel("change from the prior, in its standard deviations")
    panel.grid(alpha=0.25)
    panel.legend(loc="best", fontsize=8)
    return figure


def figure_of_correlations(identification: Identification) -> Figure:
    """Draw the correlation matrix of the estimates in colours; large correlations are also printed."""
    from matplotlib.figure import Figure

    names, correlation = identification.fit.problem.names, identification.fit.correlation
    height = 2.5 + 0.32 * len(names)
    figure = Figure(figsize=(height + 0.8, height), layout="constrained")
    panel = figure.subplots()
    image = panel.imshow(correlation, vmin=-1, vmax=1, cmap="RdBu_r")
    panel.set_xticks(range(len(names)), names, rotation=90, fontsize=8)
    panel.set_yticks(range(len(names)), names, fontsize=8)
    for i in range(len(names)):
        for j in range(len(names)):
            size = abs(correlation[i, j])
            if i != j and size > 0.5:
                # White is legible on dark colours; a second digit distinguishes 0.95 from 1.
                colour = "white" if size > 0.7 else "black"
                digits = 2 if size >= 0.95 else 1
                text = f"{correlation[i, j]:.{digits}f}"
                panel.text(j, i, text, ha="center", va="center", fontsize=6, color=colour)
    figure.colorbar(image, shrink=0.7, label="correlation")
    return figure


def write_identification_report(
    identification: Identification, folder: str | Path, drawing: Drawing | None = None
) -> Path:
    """Write index.html, result.json and the figures into a folder; return the path of the page."""
    drawing = drawing or Drawing()  # in this process
    folder = folder_with(identification.json(), folder)
    flights = [
        {
            "address": drawing.add(identification_figure(trace, role), folder / f"{role}-{number}.png"),
            "meaning": f"{trace.label}, {role}",
        }
        for role, traces in (
            ("train", identification.training_traces),
            ("validation", identification.validation_traces),
        )
        for number, trace in enumerate(traces, 1)
    ]
    fit, problem = identification.fit, identification.fit.problem
    end = "converged" if fit.converged else "ended before it had converged,"
    return write_page(
        folder,
        Path(__file__).with_name("identification.html"),
        title=f"Identification of {problem.rig.name}: the {problem.model.name} model",
        verdict=verdict(identification),
        errors=_free_run_table(identification),
        flights=flights,
        parameters=_parameter_table(identification),
        parameters_figure=drawing.add(figure_of_parameters(identification), folder / "parameters.png"),
        combinations=[
            ", ".join(f"{name} {change:+.2g}" for name, change in combination.change.items())
            for combination in identification.combinations
        ],
        pairs=[[a, b, f"{value:.3f}"] for a, b, value in identification.strong_correlations],
        correlations_figure=drawing.add(figure_of_correlations(identification), folder / "correlations.png"),
        used=_used_flights(identification),
        ended=f"The fit {end} in {fit.elapsed_s:.1f} s and {fit.evaluations} evaluations.",
    )


def verdict(identification: Identification) -> str:
    """Summarise how good the model is, and what the flights do not show."""
    numbers = identification.json()
    role = numbers["free_run_of"]
    normalised_error = numbers["normalised_residual"][role]
    which = "the fitted flights" if role == "train" else "the validation flights"
    window_s = identification.fit.problem.grids.window_s
    errors = ", ".join(f"{axis} {numbers['free_run_rms_deg'][axis]:.3g}" for axis in AXES)
    unexcited = unexcited_axes(identification.validation_traces or identification.training_traces)
    if normalised_error > QUANTISATION_ONLY:
        first_sentence = (
            f"The model has an error of {normalised_error:.3g} times the encoders' quantisation on {which}: "
            "it lacks something, and its parameters are biased."
        )
    elif len(unexcited) == len(AXES):
        moves = "moves in a way that tests the model" if any(unexcited.values()) else "moves"
        first_sentence = (
            f"No axis {moves} on {which}, so the small error, {normalised_error:.3f} when normalised, shows "
            "nothing."
        )
    else:
        first_sentence = (
            f"Only the encoders' quantisation remains on {which}: normalised error {normalised_error:.3f}."
        )
    not_shown = _sentences_on_unexcited_axes(identification, unexcited, window_s)
    return " ".join(
        [
            *_sentences_on_convergence(identification),
            first_sentence,
            *not_shown,
            f"Free-run error over {window_s:g} s, rms in degrees: {errors}.",
        ]
    )


def _sentences_on_convergence(identification: Identification) -> list[str]:
    """Write a sentence if the limits of the work ended the fit before it had converged."""
    if not identification.fit.converged:
        return [
            "The fit did not converge: its limits ended it first, so these estimates are not the best ones, "
            "and their standard errors mean nothing; use a rig file that is closer to this rig, or estimate "
            "fewer parameters with --free."
        ]
    if not identification.validation_converged:
        return [
            "The prediction of the validation flights did not converge, so its error is larger than that of "
            "the model."
        ]
    return []


def _sentences_on_unexcited_axes(
    identification: Identification, unexcited: Mapping[str, float], window_s: float
) -> list[str]:
    """Write sentences on what the flights do not show, because axes rest or move too evenly."""
    # `unexcited` has the range of these axes [deg], 0 for an axis at rest, and `window_s` is the length of
    # the free runs.
    if not unexcited:
        return []
    sentences = []
    # If no axis is excited, the first sentence of `verdict` says so.
    if len(unexcited) < len(AXES):
        at_rest = [axis for axis, range_deg in unexcited.items() if not range_deg]
        if at_rest:
            axes = " and ".join(at_rest)
            sentences.append(f"But {axes} did not move there, so the error shows nothing about {axes}.")
        sentences += [
            f"But {axis} moved there by {range_deg:.2g} degrees so evenly that any model predicts it over "
            f"{window_s:g} s, so the error shows nothing about {axis}."
            for axis, range_deg in unexcited.items()
            if range_deg
        ]
    uninformed = identification.uninformed_parameters
    if uninformed:
        sentences.append(
            f"The fitted flights do not determine {', '.join(uninformed)}; fly the plan `identify`, which "
            "moves every axis."
        )
    return sentences


def _free_run_table(identification: Identification) -> dict[str, Any]:
    """Make the table of the free-run errors, with one row per flight: its heads and rows."""
    heads = ["flight", "used for", *(f"{axis} [deg]" for axis in AXES), "normalised"]
    rows = []
    for role, flights in (("train", identification.training), ("validation", identification.validation)):
        for errors in flights:
            # An asterisk marks an axis whose errors are not white.
            axes = [f"{errors.rms_deg[axis]:.3g}{'' if errors.white[axis] else '*'}" for axis in AXES]
            rows.append([errors.label, role, *axes, f"{errors.normalised:.3f}"])
    return {"heads": heads, "rows": rows}


def _parameter_table(identification: Identification) -> dict[str, Any]:
    """Make the table of the estimates, with one row per free parameter: its heads and rows."""
    fit, problem = identification.fit, identification.fit.problem
    rows = []
    for parameter, value, std in zip(problem.free, fit.theta, fit.std.values(), strict=True):
        remark = identification.remark(parameter.name)
        prior = f"{parameter.prior.mean:g} ± {parameter.prior.std:g}"
        estimate = f"{rounded(value, std)} ± {rounded(std, std)}"
        share = f"{std / parameter.prior.std:.2g}"
        rows.append([parameter.name, estimate, parameter.unit, prior, share, remark])
    heads = [
        "parameter",
        "estimate ± 1 standard error",
        "unit",
        "prior ± 1 standard error",
        "standard error over prior's",
        "",
    ]
    return {"heads": heads, "rows": rows}


def _used_flights(identification: Identification) -> list[dict[str, Any]]:
    """For each fitted flight: a sentence on what was used, the parts left out, and the number of outlying
    windows.
    """
    fit = identification.fit
    sections = []
    flights = zip(fit.problem.records, identification.training, fit.weights, strict=True)
    for record, errors, weights in flights:
        notes = "".join(f" {note}." for note in record.notes)
        sections.append(
            {
                "sentence": f"{record.label}: {errors.seconds_used:.1f} s of free flight in windows of "
                f"{errors.window_s:.2f} s.{notes}",
                "left_out": [[f"{cut.start_s:.2f}", f"{cut.stop_s:.2f}", cut.why] for cut in record.cuts],
                "outlier_count": sum(1 for weight in weights if weight < 1.0),
            }
        )
    return sections
