"""A report for someone who looks before reading: one HTML page that needs nothing else, and its figures."""

from __future__ import annotations

from pathlib import Path

from heli_sim.model.parts import AXES

from heli_lab.identify.check import Check
from heli_lab.identify.figures import figure_of_correlations, figure_of_flight, figure_of_parameters
from heli_lab.identify.result import Identification, rounded
from heli_lab.identify.thresholds import NOTHING_LEFT
from heli_lab.identify.uncertainty import Combination
from heli_lab.page import escaped, folder_with, image, table, write_page


def write_report(identification: Identification, folder: str | Path) -> Path:
    """Write index.html, result.json and the figures as PNG into a `folder`, made if it is missing; return the
    page.
    """
    folder = folder_with(identification.json(), folder)
    flights = [
        image(figure_of_flight(trace, role), folder / f"{role}-{number}.png", f"{trace.label}, {role}")
        for role, traces in (
            ("train", identification.training_traces),
            ("validation", identification.validation_traces),
        )
        for number, trace in enumerate(traces, 1)
    ]
    parameters = image(figure_of_parameters(identification), folder / "parameters.png", "parameters")
    correlations = image(figure_of_correlations(identification), folder / "correlations.png", "correlations")
    problem = identification.fit.problem
    sections = [
        f"<h1>{escaped(problem.model.name)} model on {escaped(problem.rig.name)}</h1>",
        f'<p class="verdict">{escaped(verdict(identification))}</p>',
        "<h2>Measured against predicted</h2>",
        _errors(identification),
        *flights,
        "<h2>What was found</h2>",
        _parameters(identification),
        parameters,
        "<h2>What the flights cannot identify</h2>",
        _combinations(identification),
        correlations,
        "<h2>What was used</h2>",
        _used(identification),
    ]
    return write_page(folder, f"Identification of {problem.rig.name}", sections)


def verdict(identification: Identification) -> str:
    """Summarise in two sentences how good the model is."""
    numbers = identification.json()
    residual = numbers["normalised_residual"]
    judged = residual["train"] if residual["validation"] is None else residual["validation"]
    held_out = residual["validation"] is not None
    where = "flights that it never saw" if held_out else "the flights that it was fitted to"
    window_s = identification.fit.problem.window_s
    errors = ", ".join(f"{axis} {numbers['free_run_rms_deg'][axis]:.3g}" for axis in AXES)
    if judged <= NOTHING_LEFT:
        first = f"Nothing but the encoders' quantisation is left on {where}: normalised error {judged:.3f}."
    else:
        first = (
            f"The model is wrong by {judged:.3g} times the encoders' quantisation on {where}: something is "
            "missing in it, and its parameters are biased."
        )
    return f"{first} Free-run error over {window_s:g} s, rms in degrees: {errors}."


def _errors(identification: Identification) -> str:
    rows = [
        [check.label, role, *_axis_cells(check), f"{check.normalised:.3f}"]
        for role, checks in (("train", identification.training), ("validation", identification.validation))
        for check in checks
    ]
    heads = ["flight", "used for", *(f"{axis} [deg]" for axis in AXES), "normalised"]
    note = (
        "Root mean square error of the free run: each window is predicted from its own initial state with "
        "nothing but the voltages. Normalised: in standard deviations of the quantisation, 1 if "
        "nothing else is left. A star marks an axis whose error is not white over 0.1 s."
    )
    return table(heads, rows) + f'<p class="note">{note}</p>'


def _axis_cells(check: Check) -> list[str]:
    return [f"{check.rms_deg[axis]:.3g}{'' if check.white[axis] else '*'}" for axis in AXES]


def _parameters(identification: Identification) -> str:
    fit, problem = identification.fit, identification.fit.problem
    rows = []
    for one, value, std in zip(problem.free, fit.theta, fit.std.values(), strict=True):
        remark = "on its bound" if one.name in fit.at_bound else ""
        remark = remark or ("uninformed" if one.name in identification.uninformed_parameters else "")
        prior = f"{one.prior.mean:g} ± {2 * one.prior.std:g}"
        found = f"{rounded(value, std)} ± {rounded(2 * std, std)}"
        rows.append([one.name, found, one.unit, prior, f"{std / one.prior.std:.2g}", remark])
    heads = ["parameter", "found ± 2 std", "unit", "prior ± 2 std", "std over prior's", ""]
    return table(heads, rows)


def _combinations(identification: Identification) -> str:
    found = identification.combinations
    lines = [f"<li>{_combination(one)}</li>" for one in found]
    text = (
        f"<p>{len(found)} combinations of parameters are informed less by the flights than by the rig file's "
        "tolerances; each line is one, by its standard deviation after the flights.</p>"
        f"<ul>{''.join(lines)}</ul>"
        if found
        else "<p>Every combination of the free parameters is identified.</p>"
    )
    pairs = identification.strong_correlations
    if pairs:
        rows = [[a, b, f"{value:.3f}"] for a, b, value in pairs]
        text += "<p>Strongly correlated pairs:</p>" + table(["parameter", "and", "correlation"], rows)
    return text


def _combination(combination: Combination) -> str:
    parts = [f"{escaped(name)} {change:+.2g}" for name, change in combination.change.items()]
    return ", ".join(parts)


def _used(identification: Identification) -> str:
    parts = []
    for index, (record, check) in enumerate(
        zip(identification.fit.problem.records, identification.training, strict=True)
    ):
        rows = [[f"{cut.start_s:.2f}", f"{cut.stop_s:.2f}", cut.why] for cut in record.cuts]
        parts.append(
            f"<p>{escaped(record.label)}: {check.seconds_used:.1f} s of free flight in windows of "
            f"{check.window_s:.2f} s.{''.join(f' {escaped(note)}.' for note in record.notes)}</p>"
        )
        if rows:
            parts.append(table(["left out from [s]", "to [s]", "because"], rows))
        lowered = sum(1 for weight in identification.fit.weights[index] if weight < 1.0)
        if lowered:
            parts.append(f"<p>{lowered} windows are outliers and have less weight.</p>")
    fit = identification.fit
    end = "converged" if fit.converged else "stopped by its budget before it had converged"
    parts.append(f"<p>The fit {end} in {fit.seconds:.1f} s and {fit.evaluations} evaluations.</p>")
    return "".join(parts)
