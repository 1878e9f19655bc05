"""Section of the page about each cause: its sentence, evidence, equation, symbols and parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from heli_lab.explain.wording import capital, display_unit, evidence_in_words
from heli_lab.fit.identification import rounded
from heli_lab.report.diagnosis import figures
from heli_lab.report.diagnosis.sentences import stated
from heli_lab.report.diagnosis.symbols import legend
from heli_lab.report.page.drawing import Picture

SaveFigure = Callable[[str, Any], Picture | None]
"""Adds a figure, if there is one, to the page by the name of its file."""


def cause_section(
    cause: dict[str, Any], meanings: Mapping[str, str], certain: bool, save_figure: SaveFigure
) -> dict[str, Any]:
    """Return the section of a `cause` as the template of the page expects it."""
    ambiguous_effects = ", ".join(cause["ambiguous_with"])
    equation_figure = figures.figure_of_latex(cause["equation"])
    parameters = cause["parameters"]
    parameter_meanings = [meanings.get(name, "") for name in parameters]
    return {
        "effect": cause["effect"],
        "confidence": f"{cause['confidence']:.2f}",
        "sentence": capital(stated(cause, certain)),
        "unclear": f" These flights do not distinguish it from {ambiguous_effects}."
        if ambiguous_effects
        else "",
        "confirmed": _confirmation_sentence(cause),
        "latex": cause["equation"],
        "equation": save_figure(f"equation-{cause['effect']}", equation_figure),
        "symbols": legend(cause["effect"], cause["equation"], parameter_meanings),
        "rows": [
            [name, plus_minus(number, number["unit"]), display_unit(number["unit"])[1], meaning]
            for (name, number), meaning in zip(parameters.items(), parameter_meanings, strict=True)
        ],
        "evidence": _evidence_sentence(cause["evidence"]),
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


def _confirmation_sentence(cause: Mapping[str, Any]) -> str:
    """State in a sentence whether a cause is confirmed; empty if that was not tested."""
    if "confirmed" not in cause:
        return ""
    if not cause["confirmed"]:
        return f"Not confirmed, and not in the extended rig: {cause['replication']['why_not']}."
    reverse = cause["replication"]["log_likelihood_ratio"]["reverse"]
    if reverse is None:
        return "Confirmed on the validation flights."
    return (
        "Confirmed: it also holds if the fitted and the validation flights are exchanged, with "
        f"{evidence_in_words(reverse)}."
    )


def plus_minus(number: Mapping[str, Any], unit: str) -> str:
    """Write a `number` in the display unit of an SI `unit`: ``value ± standard error``."""
    factor, _ = display_unit(unit)
    value, std = factor * number["value"], factor * number["std"]
    return f"{rounded(value, std)} ± {rounded(std, std)}" if std else f"{rounded(value, std)} (fixed)"


def full_sentence(text: str) -> str:
    """Begin a `text` with a capital, and end it with a full stop."""
    return f"{capital(text)}."
