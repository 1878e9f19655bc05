"""The report of a diagnosis: one self-contained HTML page, and its figures as PNG."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from heli_host.data.files import write_signed
from heli_sim.model.parts import AXES

from heli_lab.explain.discover.missing import MissingTerm
from heli_lab.explain.discover.without_cause import missing_term
from heli_lab.explain.insufficient_excitation import InsufficientExcitation
from heli_lab.explain.result import Diagnosis
from heli_lab.explain.thresholds import MIN_MARGIN
from heli_lab.explain.wording import (
    capital,
    dependence_in_words,
    display_unit,
    evidence_in_words,
    nats_in_words,
    readable_id,
)
from heli_lab.fit.identification import trace
from heli_lab.fit.thresholds import UNINFORMED
from heli_lab.report.diagnosis import equation_figures, figures
from heli_lab.report.diagnosis.cause_sections import SaveFigure, cause_section, full_sentence, plus_minus
from heli_lab.report.diagnosis.gain_section import calibration_tables, gain_rows
from heli_lab.report.diagnosis.missing_section import missing_section
from heli_lab.report.diagnosis.regions_section import regions_section, unknown_torque
from heli_lab.report.diagnosis.residual_section import residual_section
from heli_lab.report.diagnosis.result_figures import figure_of_gain, figure_of_prediction
from heli_lab.report.diagnosis.sentences import (
    disturbances_in_words,
    equation_evidence,
    next_step,
    small_effect_lines,
    summary,
    title,
)
from heli_lab.report.diagnosis.serialize import proposal_json, to_json
from heli_lab.report.page import folder_with, write_page
from heli_lab.report.page.drawing import Drawing, Picture

_PAGE: Final = Path(__file__).with_name("report.html")
_EQUATION_SYMBOLS: Final = (
    "The angles θ, φ, ψ are elevation, pitch and travel, and a dot is a rate. F is a thrust (f front, b "
    "back), and τ a torque. If a quantity has a number as its subscript, it has passed a "
    "first-order lag with this time constant in s. washout(x, T) is the lagged quantity minus the quantity "
    "itself."
)
_MIN_SHOWN_NATS: Final = 3.0
"""Score above which a candidate without a refit is in the table of the ranking."""
_EXCITATION_PAGE: Final = Path(__file__).with_name("insufficient_excitation.html")


def write_report(diagnosis: Diagnosis, folder: str | Path, drawing: Drawing | None = None) -> Path:
    """Write a report: index.html, result.json, figures as PNG, and the effect file of a proposed equation."""
    drawing = drawing or Drawing()
    numbers = to_json(diagnosis)
    folder = folder_with(numbers, folder)
    held_out = diagnosis.held_out.extension
    before, after = held_out.before[0].fit, held_out.after[0].fit
    terms = missing_terms(diagnosis)
    unknown_terms = [term for term in terms if term.is_spline]
    extended = before is not after
    model = diagnosis.assessment.after.fit.problem.model
    meanings = {quantity.name: quantity.meaning for quantity in model.parameters}

    def save_figure(name: str, figure: Any) -> Picture | None:
        """Draw a figure into the folder; None if there is none."""
        return None if figure is None else drawing.add(figure, folder / f"{name}.png")

    if diagnosis.proposal is not None:
        write_effect_file(diagnosis, folder)
    return write_page(
        folder,
        _PAGE,
        title=title(diagnosis),
        label=diagnosis.label,
        heading=_heading_line(numbers),
        extended=extended,
        sentence=numbers["sentence"],
        next_step=capital(next_step(diagnosis)),
        cautions=[full_sentence(caution) for caution in numbers["cautions"]],
        unknown_cause=missing_section("unknown", unknown_terms, save_figure),
        cause=missing_section("cause", [term for term in terms if term not in unknown_terms], save_figure),
        judged="a flight that no fit used"
        if diagnosis.assessment.after.held_out_fit
        else "the fitted flight",
        prediction=save_figure(
            "prediction",
            figure_of_prediction(
                before, after, _drawn_axis(diagnosis, terms), _extrapolated_windows_s(diagnosis)
            ),
        ),
        gain={
            "address": save_figure(
                "gain", figure_of_gain(held_out.horizons, extended, before.problem.records[0].sigma_rad)
            ),
            "rows": gain_rows(numbers["gain"]["axis"]),
        },
        causes=[
            cause_section(cause, meanings, diagnosis.label != "unexplained", save_figure)
            for cause in numbers["causes"]
        ],
        small=[full_sentence(line) for line in small_effect_lines(diagnosis)],
        unknown=_unexplained_section(numbers["unexplained"]),
        curves=save_figure("curves", figures.figure_of_curves(diagnosis.curves))
        if diagnosis.curves
        else None,
        unknown_torque=unknown_torque(diagnosis, save_figure),
        disturbances=_disturbance_section(diagnosis, numbers),
        equation=_equation_section(diagnosis, save_figure),
        uninformed=_uninformed_rows(numbers["rig"]["numbers"], meanings),
        regions=regions_section(diagnosis, save_figure),
        torque=save_figure("torque", figures.figure_of_torque(diagnosis)),
        ranking={
            "address": save_figure("ranking", figures.figure_of_ranking(diagnosis.search.rounds)),
            "rows": _ranking_rows(numbers["ranking"]),
            "more": _omitted_rounds_sentence(diagnosis),
        },
        next_flight=numbers["next_flight"],
        windows=save_figure("windows", figures.figure_of_windows(before, after)),
        flight=save_figure("flight", figures.figure_of_flight(before, after)),
        size=save_figure("size", figures.figure_of_size(diagnosis)),
        calibration=calibration_tables(numbers["gain"]["calibration"]),
        residual=residual_section(numbers["residual"]),
        used=_flight_sections(numbers["flights"]),
        took=f"It took {numbers['refits']} refits of the model, {numbers['seconds_taken']:.0f} s here.",
    )


def write_effect_file(diagnosis: Diagnosis, folder: str | Path) -> Path:
    """Write the proposed equation of a `diagnosis` as effect file ``proposed.py``; return the file.

    The `folder` is made if it is missing. The diagnosis must have a proposed equation.
    """
    assert diagnosis.proposed_term is not None
    labels = ", ".join(record.label for record in diagnosis.assessment.after.fit.problem.records)
    head = f"Equation proposed by heli-host diagnose from {labels} for what no effect explains."
    path = Path(folder) / "proposed.py"
    path.parent.mkdir(parents=True, exist_ok=True)
    write_signed(path, diagnosis.proposed_term.effect_file(head))
    return path


def write_insufficient_excitation(result: InsufficientExcitation, folder: str | Path) -> Path:
    """Write the page and result.json of a `result` without excitation; return the page.

    The `folder` is made if it is missing.
    """
    numbers = to_json(result)
    return write_page(
        folder_with(numbers, folder),
        _EXCITATION_PAGE,
        title="These flights excite nothing",
        heading=f"Rig {result.rig}, model {result.model}.",
        sentence=summary(result),
        undetectable=result.undetectable,
        unidentifiable=result.unidentifiable,
        next_flight=numbers["next_flight"],
    )


def missing_terms(diagnosis: Diagnosis) -> list[MissingTerm]:
    """Compute what the model lacks without each of the two strongest causes of a `diagnosis`, spline terms
    first. A random torque and an absent term have no such figure.
    """
    verdict = diagnosis.verdict
    terms = []
    for cause in (*verdict.unlisted, *verdict.causes)[:2]:
        model = diagnosis.search.final if cause.candidate.is_spline else diagnosis.assessment.extended
        terms.append(missing_term(model.estimate, cause.candidate))
    return terms


def _drawn_axis(diagnosis: Diagnosis, terms: Sequence[MissingTerm]) -> str:
    """Return the axis whose angle is drawn: the most visible error reduction, or the first missing term."""
    baseline = trace(diagnosis.held_out.extension.before[0].fit)
    extended = diagnosis.assessment.extended.candidates
    ranges_deg = dict(zip(AXES, np.rad2deg(np.ptp(baseline.measured_rad, axis=0)), strict=True))

    def visible_share(axis: str) -> float:
        """Error reduction, or the error if no model was extended, as a share of the picture."""
        reduction = diagnosis.error_reductions[axis]
        after_deg = reduction.after_deg if extended else 0.0
        return float((reduction.before_deg - after_deg) / max(ranges_deg[axis], 1e-9))

    return terms[0].axis if terms and not extended else max(AXES, key=visible_share)


def _extrapolated_windows_s(diagnosis: Diagnosis) -> tuple[tuple[float, float], ...]:
    """Return begin and end [s] of the windows in which the first held-out flight is extrapolated."""
    return diagnosis.extrapolations[0].spans_s if diagnosis.extrapolations else ()


def _heading_line(numbers: Mapping[str, Any]) -> str:
    """Return a line with the rig, the fitted flights and the validation flights."""
    by_role: dict[str, list[str]] = {"train": [], "held_out": []}
    for flight in numbers["flights"]:
        by_role[flight["role"]].append(f"{flight['flight']} ({flight['seconds_used']:.0f} s used)")
    validated = ", ".join(by_role["held_out"]) or "no flight"
    rig = f"Rig {numbers['rig']['name']}, model {numbers['rig']['model']}"
    return f"{rig}. Fitted: {', '.join(by_role['train'])}. Validated on: {validated}."


def _uninformed_rows(
    parameters: Mapping[str, Mapping[str, Any]], meanings: Mapping[str, str]
) -> list[list[str]]:
    """Return a table row for each parameter whose estimate is nearly as uncertain as its prior."""
    return [
        [
            name,
            plus_minus(parameter["prior"], parameter["unit"]),
            plus_minus(parameter, parameter["unit"]),
            display_unit(parameter["unit"])[1],
            meanings.get(name, ""),
        ]
        for name, parameter in parameters.items()
        if parameter["std"] > UNINFORMED * parameter["prior"]["std"]
    ]


def _equation_section(diagnosis: Diagnosis, save_figure: SaveFigure) -> dict[str, Any] | None:
    """Return the section of the proposed equation with its figure; None without one."""
    if diagnosis.proposal is None:
        return None
    proposed = diagnosis.proposal.term
    numbers, discovery = proposal_json(diagnosis.proposal), proposed.discovery
    return {
        "sentence": proposed.sentence,
        "evidence": f"Confidence {proposed.confidence:.2f}: {equation_evidence(discovery)}, "
        f"the best of {discovery.tried} terms.",
        "address": save_figure("equation", equation_figures.figure_of_equation(proposed)),
        "axis": proposed.trace.axis,
        "symbols": _EQUATION_SYMBOLS,
        "rows": [
            # A dimensionless parameter is shown as it is, not in per cent.
            [name, f"{number['value']:g}", ""]
            if number["unit"] == "1" and not number["std"]
            else [name, plus_minus(number, number["unit"]), display_unit(number["unit"])[1]]
            for name, number in numbers["numbers"].items()
        ],
        "rivals": [[rival.key, f"{rival.log_likelihood_ratio:.0f}"] for rival in discovery.rivals],
        "gain": gain_rows(numbers["gain"]),
    }


def _unexplained_section(missing: dict[str, Any] | None) -> dict[str, Any] | None:
    """Return the section about the dependence that no effect explains; None without one.

    It has sentences, dependences and error reductions.
    """
    if missing is None:
        return None
    return {
        "text": f"A part of the motion about {missing['axis']} can be predicted, with "
        f"{evidence_in_words(missing['log_likelihood_gain'])}, but no effect of the catalogue explains it. "
        "Possible causes, the most likely first:",
        "depends": [capital(dependence_in_words(dependence)) for dependence in missing["correlates_with"]],
        "gain": gain_rows(missing.get("gain_with_splines", {})),
    }


def _disturbance_section(diagnosis: Diagnosis, numbers: dict[str, Any]) -> dict[str, Any]:
    """Return a sentence and a table row for the disturbances about each axis."""
    rows = []
    for axis, values in numbers["disturbances"].items():
        evidence = nats_in_words(values["log_likelihood_ratio"])
        if values["log_likelihood_ratio"] <= MIN_MARGIN:
            rows.append([axis, "none", "", "", evidence])
            continue
        fast_mNm, slow_mNm = 1e3 * values["fast_std_Nm"], 1e3 * values["slow_std_Nm"]
        correlation_time_s = values["correlation_time_s"]
        rows.append([axis, f"{fast_mNm:.2g}", f"{correlation_time_s:.2g}", f"{slow_mNm:.2g}", evidence])
    return {"text": f"Disturbances that no model predicts: {disturbances_in_words(diagnosis)}.", "rows": rows}


def _ranking_rows(ranking: Sequence[dict[str, Any]]) -> list[list[str]]:
    """Return a table row for each candidate of a round that was refitted or has a notable score."""

    def cell(value: float | None) -> str:
        """Write a number of nats; empty for None."""
        return "" if value is None else f"{value:.0f}"

    rows = []
    for entry in ranking:
        if entry["train"] is None and entry["score"] <= _MIN_SHOWN_NATS:
            continue
        accepted = " (accepted)" if entry["taken"] else ""
        name = f"{entry['round']}: {readable_id(entry['candidate'])}{accepted}"
        rows.append([name, cell(entry["score"]), cell(entry["train"]), cell(entry["penalty"])])
    return rows


def _omitted_rounds_sentence(diagnosis: Diagnosis) -> str:
    """State how many rounds the figure leaves out; empty if it has all."""
    remaining_rounds = len(diagnosis.search.rounds) - figures.MAX_ROUNDS
    return f" {remaining_rounds} later rounds are in the table." if remaining_rounds > 0 else ""


def _flight_sections(flights: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return a section for each flight: its role, and the parts that were used and left out."""
    sections = []
    for flight in flights:
        role = "fitted" if flight["role"] == "train" else "held out"
        spans = ", ".join(f"{begin_s:.1f} to {end_s:.1f} s" for begin_s, end_s in flight["used"])
        notes = "".join(f" {note}." for note in flight["notes"])
        cuts = [[f"{cut['from_s']:.2f}", f"{cut['to_s']:.2f}", cut["why"]] for cut in flight["left_out"]]
        sections.append(
            {
                "text": f"{flight['flight']}, {role}: {flight['seconds_used']:.1f} s used ({spans}).{notes}",
                "left_out": cuts,
            }
        )
    return sections
