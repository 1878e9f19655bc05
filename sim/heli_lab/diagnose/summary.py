"""A diagnosis in sentences, for a terminal and for a page."""

from __future__ import annotations

from typing import Final

from heli_lab.diagnose import findings
from heli_lab.diagnose.insufficient_excitation import InsufficientExcitation
from heli_lab.diagnose.result import Diagnosis
from heli_lab.diagnose.words import curve_in_words

_WORTH_A_LINE: Final = 0.9
"""Ratio of errors below which a spline term's gain is told."""


_WEATHER_MIN: Final = 6.0
"""Log-likelihood ratio, nats, from which on the weather about an axis is told."""


def title(result: Diagnosis) -> str:
    """The verdict in a line, no surer than the sentence under it."""
    named = [cause["effect"] for cause in findings.causes(result)]
    return {
        "explained": "Nothing is missing that these flights show",
        "cause_found": f"Cause{'s' if len(named) > 1 else ''} found: {', '.join(named)}",
        "ambiguous": "Cause found, but not told apart from others",
        "unexplained": "Something unknown is missing" + (", perhaps beside known causes" if named else ""),
    }[result.label]


def summary(result: Diagnosis | InsufficientExcitation) -> str:
    """What was found, in a sentence or two: the same on the page, on a terminal and in the JSON."""
    if isinstance(result, InsufficientExcitation):
        return f"Nothing can be said of what the model lacks: {result.why}."
    cut = "" if result.search.complete else " The work allowed ran out before everything was tried."
    return _found(result) + cut


def _found(result: Diagnosis) -> str:
    label = result.label
    causes = findings.causes(result)
    where = "flights that no fit saw" if result.after.held_out_fit else "the flights that were fitted"
    disturbances = f" What remains is weather: {weather_of(result)}." if label != "unexplained" else ""
    if label == "explained":
        return (
            "Nothing is missing that these flights could show: what the refitted baseline leaves on "
            f"{where} cannot be foretold.{disturbances}"
        )
    if label in ("cause_found", "ambiguous"):
        text = "; ".join(cause["sentence"] for cause in causes)
        others = sorted({other for cause in causes for other in cause["ambiguous_with"]})
        unclear = f" These flights do not tell it from {', '.join(others)}." if others else ""
        return f"{text[:1].upper()}{text[1:]}.{unclear}{disturbances}"
    missing = findings.unexplained(result) or {}
    text = (
        "Something is missing that no effect of the catalogue explains: "
        f"{curve_in_words(missing['correlates_with'][0])} foretells the motion about {missing['axis']} "
        f"(log-likelihood ratio {missing['log_likelihood_gain']:.0f} nats)."
    )
    if causes:
        perhaps = "; ".join(f"{cause['sentence']} (confidence {cause['confidence']:.2f})" for cause in causes)
        text += f" Beside it, perhaps: {perhaps}."
    return text


def weather_of(result: Diagnosis) -> str:
    """The torques by chance about each axis in words."""
    parts = [
        f"gusts of {1e3 * values['fast_std_Nm']:.2g} mN m about {axis} "
        f"that last {values['correlation_time_s']:.1g} s"
        for axis, values in findings.disturbances(result.residual_analysis).items()
        if values["log_likelihood_ratio"] > _WEATHER_MIN
    ]
    return ", ".join(parts) or "none that shows"


def lines(result: Diagnosis | InsufficientExcitation) -> list[str]:
    """Numbers behind the summary, a line each."""
    if isinstance(result, InsufficientExcitation):
        return [
            f"undetectable effects: {', '.join(result.undetectable)}",
            f"unidentifiable parameters: {', '.join(result.unidentifiable)}",
            f"next flight: {result.next_flight.why}",
        ]
    lines = []
    for cause in findings.causes(result):
        others = cause["ambiguous_with"]
        unclear = f"; could as well be {', '.join(others)}" if others else ""
        lines.append(f"{cause['effect']} (confidence {cause['confidence']:.2f}{unclear})")
    lines.append(f"{result.metric}, before and after, and their ratio:")
    for axis, reduction in result.gains.items():
        low, high = reduction.interval95
        lines.append(
            f"  {axis:9}  {reduction.before_deg:<7.3g} {reduction.after_deg:<7.3g} {reduction.ratio:.2f} "
            f"({low:.2f} to {high:.2f})"
        )
    for curve in result.curves:
        lines.append(f"a curve in its place: {curve.what}")
    for axis, reduction in result.spline_gains.items():
        if reduction.ratio < _WORTH_A_LINE:
            lines.append(
                f"  with it {axis} is off by {reduction.after_deg:.3g} deg, ratio {reduction.ratio:.2f}"
            )
    if result.proposed_term is not None:
        lines += result.proposed_term.lines()
    elif result.label == "unexplained":
        lines.append("no law of a few terms explains it so that another flight confirms it")
    if result.next_flight is not None:
        lines.append(f"next flight: {result.next_flight.why}")
    elif result.undetectable:
        lines.append(f"at a typical size these flights would not show: {', '.join(result.undetectable)}")
    return lines + result.cautions
