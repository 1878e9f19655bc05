"""The report of a diagnosis: one self-contained HTML page, and its figures as PNG."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from heli_host.data.files import write_signed
from heli_sim.model.effect import AXES

from heli_lab.explain.contributions import TIME, MissingTerm, missing_term
from heli_lab.explain.experiment_design import InsufficientExcitation
from heli_lab.explain.replication import CauseReplication
from heli_lab.explain.residuals import FailingRegions, RegionTest
from heli_lab.explain.result import Diagnosis
from heli_lab.explain.thresholds import MIN_MARGIN
from heli_lab.explain.wording import (
    capital,
    dependence_in_words,
    display_unit,
    evidence_in_words,
    nats_in_words,
    quantity_in_words,
    readable_id,
)
from heli_lab.fit.identification import rounded, trace
from heli_lab.fit.thresholds import UNINFORMED
from heli_lab.report.diagnosis import figures
from heli_lab.report.diagnosis.figures import figure_of_gain, figure_of_missing_terms, figure_of_prediction
from heli_lab.report.diagnosis.serialize import proposal_json, to_json
from heli_lab.report.diagnosis.text import (
    SHARE_HEADS,
    CauseEntry,
    cause_entries,
    disturbances_in_words,
    equation_evidence,
    error_share_rows,
    error_share_sentences,
    next_step,
    share_heading,
    small_effect_lines,
    summary,
    title,
)
from heli_lab.report.page import folder_with, write_page
from heli_lab.report.page.drawing import Drawing, Picture
from heli_lab.watch.error_shares import ErrorShares

_NAMES: Final = r"(?:\\[A-Za-z]+|[A-Za-z])(?:_(?:\{[^}]*\}|\\[a-z]+|[A-Za-z0-9]))?"
_SYMBOL: Final = re.compile(_NAMES)
_BOLD: Final = re.compile(r"\\boldsymbol\{(\w)\}")
_NO_SYMBOLS: Final = re.compile(
    r"\\mathrm\{[^}]*\}|e\^|\\[,; ]|"
    r"\\(?:frac|quad|dot|sin|cos|tanh|sqrt|min|max|to|cdot|approx|sum|pi|exp)(?![A-Za-z])"
)
"""Functions, units, spaces and relations of the equations."""
_GREEK: Final = {
    "theta": "\u03b8",
    "phi": "\u03c6",
    "psi": "\u03c8",
    "tau": "\u03c4",
    "omega": "\u03c9",
    "sigma": "\u03c3",
    "kappa": "\u03ba",
    "Delta": "\u0394",
}
_MEANINGS: Final[Mapping[str, str]] = {
    r"\theta": "elevation",
    r"\phi": "pitch",
    r"\psi": "travel",
    r"\tau": "torque that is added (of three: about elevation, pitch and travel)",
    r"\tau_\theta": "torque about elevation that is added",
    r"\tau_\phi": "torque about pitch that is added",
    r"\tau_\psi": "torque about travel that is added",
    r"\tau_n": "torque about the normal of the short arm",
    r"\omega": "angular rate of the axis",
    r"\omega_0": "angular rate of the axis without this friction",
    "A": "area that meets the air",
    "C_D": "drag coefficient",
    "F": "thrust by the baseline's thrust curve",
    "F_b": "thrust of the back rotor",
    "F_f": "thrust of the front rotor",
    "F_i": "thrust of rotor i, front (f) or back (b)",
    "H": "angular momentum of the rotors along the normal of the short arm",
    "J": "moment of inertia about the axis",
    r"L_\phi": "distance from the pitch axis down to the short arm",
    r"L_\theta": "distance from the elevation axis down to the long arm",
    "L_a": "distance from the elevation axis to the pitch axis",
    "L_b": "distance from the elevation axis to the counterweight",
    "L_h": "distance from the pitch axis to a propeller",
    "P_{18}": "equation (18) of the paper",
    "V_0": "voltage below which a rotor gives no thrust",
    "V_b": "voltage of the back motor",
    "V_f": "voltage of the front motor",
    "V_i": "voltage of motor i, front (f) or back (b)",
    "d": "random torque",
    "e_i": "voltage of motor i above the dead zone",
    "f": "viscous friction",
    "g": "gravity",
    "h_i": "height of rotor i above the table",
    "k": "thrust per volt above the dead zone",
    "m_j": "masses of the rig",
    "q": "angle of the axis",
    "r_j": "positions of the masses",
    "t": "time",
    "v": "speed of the rotors across their axes",
    "v_i": "speed of rotor i along its axis",
    "w_i": "speed of rotor i, as the voltage that holds it",
    "y": "angle that the encoder measures",
}
"""Meanings of symbols that are no parameters of an effect."""
_MEANINGS_BY_EFFECT: Final[Mapping[str, Mapping[str, str]]] = {
    "axis_tilt": {"U": "potential energy", "n": "unit vector along the travel axis"},
    "flywheel": {"w": "speed of both rotors, as the sum of the voltages that hold it"},
    "inflow_damping": {
        "i": "number of the rotor, front or back",
        "l": "1 if the loss is proportional to the thrust, 0 if it is the same at any thrust",
        "n": "unit vector along the rotors' axes",
        "r": "position of a rotor",
    },
    "random_torque": {"w": "white noise"},
    "supply_sag": {"l": "0 if each driver loses a share of its voltage, 1 if both lose the same voltage"},
}
"""Meanings of symbols that differ in the equation of an effect, by effect id without its axis."""


@dataclass(frozen=True)
class Meaning:
    """A symbol for a page, and its meaning."""

    letter: str  # letter, index: The symbol and its subscript, which may be empty
    index: str
    text: str  # The meaning in words


def symbols_of(equation: str) -> list[str]:
    """List the symbols of an `equation` in LaTeX, each once, in their order."""
    return list(dict.fromkeys(_SYMBOL.findall(_NO_SYMBOLS.sub(" ", _BOLD.sub(r"\1", equation)))))


def legend(effect: str, equation: str, parameters: Sequence[str] = ()) -> list[Meaning]:
    """Explain the symbols of an `equation` that no parameter of the `effect` explains."""
    meanings = {**_MEANINGS, **_MEANINGS_BY_EFFECT.get(effect.partition(".")[0], {})}
    return [
        Meaning(*_letter_and_index(symbol), meanings[symbol])
        for symbol in symbols_of(equation)
        if symbol in meanings and not explained_by(symbol, parameters)
    ]


def explained_by(symbol: str, meanings: Sequence[str]) -> bool:
    """Whether one of the `meanings` of parameters contains a `symbol`."""
    without_backslash = symbol.removeprefix("\\")
    word = re.compile(rf"(?<!\w){re.escape(without_backslash)}(?![\w'])")
    return any(word.search(meaning) for meaning in meanings)


def _letter_and_index(symbol: str) -> tuple[str, str]:
    """Return the letter and the subscript of a symbol, with Greek letters."""
    letter, _, index = symbol.partition("_")
    return _with_greek(letter), _with_greek(index.strip("{}"))


def _with_greek(text: str) -> str:
    """Replace a LaTeX name of a Greek letter by the letter."""
    return _GREEK.get(text.removeprefix("\\"), text)


SaveFigure = Callable[[str, Any], Picture | None]
"""Adds a figure, if there is one, to the page by the name of its file."""


def cause_section(
    cause: CauseEntry, meanings: Mapping[str, str], certain: bool, save_figure: SaveFigure
) -> dict[str, Any]:
    """Return the section of a `cause` as the template of the page expects it."""
    ambiguous_effects = ", ".join(cause.ambiguous_with)
    parameter_meanings = [meanings.get(name, "") for name in cause.parameters]
    return {
        "effect": cause.effect,
        "confidence": f"{cause.confidence:.2f}",
        "sentence": capital(cause.statement(certain)),
        "unclear": f" These flights do not distinguish it from {ambiguous_effects}."
        if ambiguous_effects
        else "",
        "confirmed": _confirmation_sentence(cause.replication),
        "latex": cause.equation,
        "equation": save_figure(f"equation-{cause.effect}", figures.figure_of_latex(cause.equation)),
        "symbols": legend(cause.effect, cause.equation, parameter_meanings),
        "rows": [
            [name, plus_minus(asdict(number), number.unit), display_unit(number.unit)[1], meaning]
            for (name, number), meaning in zip(cause.parameters.items(), parameter_meanings, strict=True)
        ],
        "evidence": _evidence_sentence(cause.evidence),
    }


def _evidence_sentence(evidence: Mapping[str, Any]) -> str:
    """Write the evidence for a cause in a sentence."""
    if "standard_errors_from_zero" in evidence:
        return (
            f"The estimate of the term is {evidence['standard_errors_from_zero']:.1f} standard errors from "
            f"zero, and {evidence['standard_errors_from_rig']:.1f} from the value in the rig file."
        )
    if "log_likelihood_ratio" in evidence:
        return f"On the fitted flights: {evidence_in_words(evidence['log_likelihood_ratio'])}."
    held_out = evidence["log_likelihood_ratio_held_out"]
    return (
        f"On the fitted flights: {evidence_in_words(evidence['log_likelihood_ratio_train'])}, of which "
        f"{evidence['penalty']:.0f} nats are needed to outweigh the number of parameters and of candidates"
        f"{f'; on the validation flights: {evidence_in_words(held_out)}' if held_out is not None else ''}."
    )


def _confirmation_sentence(replication: CauseReplication | None) -> str:
    """State in a sentence whether a cause is confirmed; empty if that was not tested."""
    if replication is None:
        return ""
    if not replication.confirmed:
        return f"Not confirmed, and not in the extended rig: {replication.why_not}."
    if replication.reverse is None:
        return "Confirmed on the validation flights."
    return (
        "Confirmed: it also holds if the fitted and the validation flights are exchanged, with "
        f"{evidence_in_words(replication.reverse)}."
    )


def plus_minus(number: Mapping[str, Any], unit: str) -> str:
    """Write a `number` in the display unit of an SI `unit`: ``value ± standard error``."""
    factor, _ = display_unit(unit)
    value, std = factor * number["value"], factor * number["std"]
    return f"{rounded(value, std)} ± {rounded(std, std)}" if std else f"{rounded(value, std)} (fixed)"


def full_sentence(text: str) -> str:
    """Begin a `text` with a capital, and end it with a full stop."""
    return f"{capital(text)}."


_BEFORE_AFTER: Final = ("before", "after")


def residual_section(residual: dict[str, Any]) -> dict[str, Any]:
    """Return the table of normalised errors and autocorrelations before and after, and a note on it."""
    role = "held_out" if "held_out" in residual["white"] else "train"
    correlation = residual["correlation"][role]
    rows = [
        [
            axis,
            *(f"{errors[when]:.3f}" for when in _BEFORE_AFTER),
            *(f"{correlation[when][axis]:.2f}" for when in _BEFORE_AFTER),
            "yes" if residual["white"][role]["after"][axis] else "no",
        ]
        for axis, errors in residual["axis"].items()
    ]
    normalised = residual["normalised"]
    rows.append(["all", *(f"{normalised[when]:.3f}" for when in _BEFORE_AFTER), "", "", ""])
    rows.append(
        ["all, held out", *(f"{normalised[f'held_out_{when}']:.3f}" for when in _BEFORE_AFTER), "", "", ""]
    )
    flight_role = "held-out" if role == "held_out" else "fitted"
    innovations = residual["innovations"]
    max_autocorrelation = max(
        abs(value) for values in innovations["autocorrelation"].values() for value in values
    )
    return {
        "rows": rows,
        "note": "The error is the root mean square in the fitted flight, in standard deviations of the "
        "quantisation: 1 if nothing is missing. The autocorrelation is over 0.1 s in the "
        f"{flight_role} flight; it is white if it is within three standard deviations of that of white "
        "noise. Innovations (one-step prediction errors) have an autocorrelation of at most "
        f"{max_autocorrelation:.2f} over "
        f"{innovations['lags_s'][0]:.2g} to {innovations['lags_s'][-1]:.2g} s; white noise would stay below "
        f"{innovations['bound']:.2f}.",
    }


def gain_rows(gain: Mapping[str, Mapping[str, Any]]) -> list[list[str]]:
    """Return a table row for each axis: errors before and after [deg], their ratio and its 95 % interval."""
    return [
        [
            axis,
            f"{reduction['before']:.3g}",
            f"{reduction['after']:.3g}",
            f"{reduction['ratio']:.2f}",
            f"{reduction['interval95'][0]:.2f} to {reduction['interval95'][1]:.2f}",
        ]
        for axis, reduction in gain.items()
    ]


def _share_section(shares: ErrorShares, label: str) -> dict[str, Any]:
    """Return the parts of the forecast error for the page."""
    return {
        "text": full_sentence(capital(share_heading(shares))),
        "heads": SHARE_HEADS,
        "rows": error_share_rows(shares),
        "sentences": [full_sentence(line) for line in error_share_sentences(shares, label)],
    }


def calibration_tables(flights: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return a table for each calibrated validation flight, with the zeros and constant torques of baseline
    and extended model.
    """
    tables = []
    for flight in flights:
        if not flight["after"]:
            continue  # nothing was calibrated
        rows = []
        for name, after in flight["after"].items():
            unit = after["unit"]
            cells = [name]
            for constant in (flight["before"][name], after):
                cells += [plus_minus(constant["prior"], unit), plus_minus(constant, unit)]
            rows.append([*cells, display_unit(unit)[1]])
        note = (
            f"{flight['flight']}: zeros and constant torques from its first "
            f"{flight['calibrated_s']:.1f} s of free flight; "
            f"the next {flight['evaluated_s']:.1f} s are evaluated."
        )
        tables.append({"rows": rows, "note": note})
    return tables


def regions_section(diagnosis: Diagnosis, save_figure: SaveFigure) -> dict[str, Any]:
    """Describe in words and in a figure, which `save_figure` writes, where the models fail about each
    axis.
    """
    first = diagnosis.failing_regions
    all_regions = [first, *(diagnosis.failing_regions_about(axis) for axis in AXES if axis != first.axis)]
    models = _compared_models(diagnosis)
    figure = figures.figure_of_failing_regions(all_regions, models)
    return {
        "address": save_figure("regions", figure),
        "sentences": [_regions_sentence(regions, models) for regions in all_regions],
        "note": _regions_note(diagnosis, first.after if len(models) > 1 else first.before),
    }


def _compared_models(diagnosis: Diagnosis) -> list[str]:
    """Name the models that the regions compare: before and after the last extension of the model."""
    if diagnosis.proposal is not None:
        return ["model with all named causes", "with the proposed equation"]
    if diagnosis.assessment.extended.candidates:
        return ["baseline", "model with all named causes"]
    return ["baseline"]


def _regions_sentence(regions: FailingRegions, models: Sequence[str]) -> str:
    """State the missing torque about an axis, and how often each model fails."""
    texts = []
    for model, test in zip(models, (regions.before, regions.after), strict=False):
        name = model.replace("with the", "model with the")
        share = f"in {100 * test.share:.0f} % of the time" if test.fails.any() else "in no cell"
        texts.append(f"the {name} lacks {_torque_text_mNm(test.rms_Nm)} mN m rms and fails {share}")
    return f"About {regions.axis}: " + "; ".join(texts)


def _regions_note(diagnosis: Diagnosis, test: RegionTest) -> str:
    """Explain an apparent contradiction between the verdict and the cells of the last model; else empty."""
    first = diagnosis.failing_regions
    if diagnosis.label == "unexplained" and not test.fails.any():
        x, y = quantity_in_words(first.x), quantity_in_words(first.y)
        return (
            f"No cell of {x} and {y} fails about {first.axis}, although the model lacks a torque: this "
            "torque is spread over many cells, or depends on other quantities."
        )
    if diagnosis.label != "unexplained" and test.fails.any():
        return (
            "The verdict does not depend on these cells: no candidate explains the missing torque there, "
            "which is small or due to chance."
        )
    return ""


def unexplained_torque(diagnosis: Diagnosis, save_figure: SaveFigure) -> Picture | None:
    """Draw the missing torque over its quantity, if neither a curve nor an equation describes it."""
    if diagnosis.missing is None or diagnosis.verdict.unlisted or diagnosis.proposal is not None:
        return None
    if (diagnosis.failing_regions.axis, diagnosis.failing_regions.x) != diagnosis.missing:
        return None
    return save_figure("unknown", figures.figure_of_unknown_torque(diagnosis.failing_regions))


def _torque_text_mNm(torque_Nm: float) -> str:
    """Write a torque in mN m: whole numbers from 10 mN m on, two digits below."""
    return f"{1e3 * torque_Nm:.0f}" if torque_Nm >= 0.01 else f"{1e3 * torque_Nm:.2g}"


_DOTS: Final = "Each grey dot is 40 ms of the fitted flights; black dots are means."
_OVER_TIME: Final = "Each dot is 40 ms of the seconds in which the cause acts most."
_SMOOTHED: Final = (
    "A Kalman smoother estimates the torque that the model lacks without the {0}; all other parameters stay "
    "the same. It does not use the {1}. Means are subtracted, because a constant torque is a parameter of "
    "the model."
)
_STEADY: Final = "If the cause also changes the steady thrust, the dots contain this change."
_POINTS: Final = (
    "The points are of a smooth curve that is estimated instead of the cause, with two standard errors. This "
    "estimate does not use the equation of the cause."
)
_FAINT: Final = 0.3
"""Share of the variance below which a caption says that the dots hardly show a term."""


def missing_section(
    file: str, terms: Sequence[MissingTerm], save_figure: SaveFigure
) -> dict[str, Any] | None:
    """Draw missing `terms` into a `file`, which `save_figure` writes, and describe it; None without terms."""
    if not terms:
        return None
    return {
        "address": save_figure(file, figure_of_missing_terms(terms)),
        "meaning": "; ".join(f"missing {term.what} about {term.axis} over {term.on}" for term in terms),
        "caption": " ".join([*(_caption(term) for term in terms), *_method_sentences(terms)]),
    }


def _method_sentences(terms: Sequence[MissingTerm]) -> list[str]:
    """Explain in sentences how the terms of a figure were estimated and drawn."""
    torques = [term for term in terms if term.what == "torque"]
    if not torques:
        return [_POINTS]
    lines = []
    if any(term.on != TIME for term in torques):
        lines.append(_DOTS)
    if any(term.on == TIME for term in torques):
        lines.append(_OVER_TIME)
    if any(term.is_spline for term in torques):
        return [*lines, _SMOOTHED.format("curve", "curve")]
    return [*lines, _SMOOTHED.format("cause", "equation of the cause"), _STEADY]


def _caption(term: MissingTerm) -> str:
    """State the share of variance that a cause or curve explains."""
    name, kind = term.id, "equation"
    if term.is_spline:
        name, kind = capital(readable_id(name)), "curve"
    hidden_text = " In this figure, disturbances hide it." if term.share < _FAINT else ""
    return f"{name}: the {kind} explains {100 * max(term.share, 0.0):.0f} % of the variance.{hidden_text}"


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


def write_report(
    diagnosis: Diagnosis,
    folder: str | Path,
    drawing: Drawing | None = None,
    shares: ErrorShares | None = None,
) -> Path:
    """Write a report: index.html, result.json, figures as PNG, and the effect file of a proposed equation."""
    # Without a `drawing`, this process renders the figures. Without `shares` of the forecast error, the page
    # has no section on them.
    drawing = drawing or Drawing()
    numbers = to_json(diagnosis, shares)
    folder = folder_with(numbers, folder)
    held_out = diagnosis.held_out.extension
    before, after = held_out.before[0].fit, held_out.after[0].fit
    terms = missing_terms(diagnosis)
    # A curve stands for an unknown cause; all other terms belong to known causes.
    curves = [term for term in terms if term.is_spline]
    known_terms = [term for term in terms if not term.is_spline]
    # If nothing was added to the baseline, its fit is also the one after.
    extended = before is not after
    is_certain = diagnosis.label != "unexplained"
    judged_flight = (
        "a flight that no fit used" if diagnosis.assessment.after.held_out_fit else "the fitted flight"
    )
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
        unexplained_curve=missing_section("unknown", curves, save_figure),
        missing_part=missing_section("cause", known_terms, save_figure),
        judged_flight=judged_flight,
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
        forecast_error=None if shares is None else _share_section(shares, diagnosis.label),
        causes=[
            cause_section(cause, meanings, is_certain, save_figure) for cause in cause_entries(diagnosis)
        ],
        small_effects=[full_sentence(line) for line in small_effect_lines(diagnosis)],
        unexplained=_unexplained_section(numbers["unexplained"]),
        curves=save_figure("curves", figures.figure_of_curves(diagnosis.curves))
        if diagnosis.curves
        else None,
        unexplained_torque=unexplained_torque(diagnosis, save_figure),
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
        flights_used=_flight_sections(numbers["flights"]),
        effort=f"It took {numbers['refits']} refits of the model, {numbers['seconds_taken']:.0f} s here.",
    )


def write_effect_file(diagnosis: Diagnosis, folder: str | Path) -> Path:
    """Write the proposed equation of a `diagnosis` as effect file ``proposed.py``; return the file."""
    assert diagnosis.proposed_term is not None
    labels = ", ".join(record.label for record in diagnosis.assessment.after.fit.problem.records)
    head = f"Equation proposed by heli-host diagnose from {labels} for what no effect explains."
    path = Path(folder) / "proposed.py"
    path.parent.mkdir(parents=True, exist_ok=True)
    write_signed(path, diagnosis.proposed_term.effect_file(head))
    return path


def write_insufficient_excitation(result: InsufficientExcitation, folder: str | Path) -> Path:
    """Write the page and result.json of a `result` without excitation; return the page."""
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
        "address": save_figure("equation", figures.figure_of_equation(proposed)),
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
    """Return the section about the dependence that no effect explains; None without one."""
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
    return {
        "text": "Disturbances, torques that neither the model nor a cause predicts: "
        f"{disturbances_in_words(diagnosis)}.",
        "rows": rows,
    }


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
