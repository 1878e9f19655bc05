"""The report of an identification: one HTML page that needs no other file, and its figures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from heli_sim.model.parts import AXES

from heli_lab.fit.identification import Identification, rounded, unexcited_axes
from heli_lab.fit.thresholds import QUANTISATION_ONLY
from heli_lab.report.identification.figures import (
    figure_of_correlations,
    figure_of_parameters,
    identification_figure,
)
from heli_lab.report.page import folder_with, write_page
from heli_lab.report.page.drawing import Drawing


def write_identification_report(
    identification: Identification, folder: str | Path, drawing: Drawing | None = None
) -> Path:
    """Write index.html, result.json and the figures into a folder; return the path of the page."""
    drawing = drawing or Drawing()
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
        Path(__file__).with_name("report.html"),
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
    """Write sentences on what the flights do not show, because axes rest or move too evenly.

    `unexcited` has the range of these axes [deg], 0 for an axis at rest, and `window_s` is the length of the
    free runs.
    """
    if not unexcited:
        return []
    sentences = []
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
