"""A diagnosis in sentences, for a terminal and for a page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from heli_lab.explain.discover.discovery import Discovery
from heli_lab.explain.evaluate.error_reduction import ErrorReduction
from heli_lab.explain.insufficient_excitation import InsufficientExcitation
from heli_lab.explain.result import Diagnosis, Proposal
from heli_lab.explain.thresholds import CONFIDENCE_NATS, CONFIDENCE_RANDOM_TORQUE, MATTERS_COUNTS, MIN_MARGIN
from heli_lab.explain.wording import capital, dependence_in_words, evidence_in_words
from heli_lab.report.diagnosis import findings
from heli_lab.report.diagnosis.cautions import cautions

METRIC: Final = "2 s free-run rms on the validation flights, deg"
"""Quantity that the error reductions compare if flights are held out."""


def title(result: Diagnosis) -> str:
    """Write the verdict as a headline that claims no more than `summary` does."""
    causes = findings.causes(result)
    effects = [cause["effect"] for cause in causes]
    plural = "s" * (len(effects) > 1)
    is_certain = all(_is_certain(cause) for cause in causes)
    heading = f"Cause{plural} found" if is_certain else f"Probable cause{plural}"
    return {
        "explained": "The model explains these flights",
        "cause_found": f"{heading}: {', '.join(effects)}",
        "ambiguous": "The model lacks an effect; these flights do not show which of several",
        "unexplained": "The model lacks an effect that the catalogue does not list"
        + (", perhaps together with listed ones" if effects else ""),
    }[result.label]


def summary(result: Diagnosis | InsufficientExcitation) -> str:
    """Write the result in a sentence or two: the same on the page, on a terminal and in the JSON."""
    if isinstance(result, InsufficientExcitation):
        return f"These flights do not show what the model lacks: {result.why}."
    limit_text = (
        "" if result.search.complete else " The limit of refits ended the search before everything was tried."
    )
    return _verdict_text(result) + limit_text


def _verdict_text(result: Diagnosis) -> str:
    """Write the verdict with its causes, or with the dependence that no effect explains."""
    label = result.label
    causes = findings.causes(result)
    held_out = result.assessment.after.held_out_fit
    flights_text = "flights that no fit used" if held_out else "the fitted flights"
    disturbance_text = f" What remains are disturbances: {disturbances_in_words(result)}."
    if label == "explained":
        return (
            f"The refitted baseline explains these flights: its errors on {flights_text} cannot be "
            f"predicted.{disturbance_text}"
        )
    if label in ("cause_found", "ambiguous"):
        text = "; ".join(stated(cause) for cause in causes)
        others = sorted({other for cause in causes for other in cause["ambiguous_with"]})
        ambiguity_text = f" These flights do not distinguish it from {', '.join(others)}." if others else ""
        for cause in causes:
            family = cause.get("family")
            if family and {*cause["ambiguous_with"]} & {*family["members"]}:
                ambiguity_text += f" {capital(family['sentence'])}."
        return f"{capital(text)}.{ambiguity_text}{disturbance_text}"
    missing = findings.unexplained(result) or {}
    text = (
        "The model lacks an effect that the catalogue does not list. "
        f"{capital(dependence_in_words(missing['correlates_with'][0]))} predicts the motion about "
        f"{missing['axis']}, with {evidence_in_words(missing['log_likelihood_gain'])}."
    )
    if causes:
        cause_text = "; ".join(
            f"{cause['sentence']} (confidence {cause['confidence']:.2f})" for cause in causes
        )
        text += f" Together with it, perhaps: {cause_text}."
    return text


def stated(cause: Mapping[str, Any], certain: bool = True) -> str:
    """Write the sentence of a `cause` as a fact, or with "perhaps" and its confidence.

    It is a fact if the verdict is `certain`, the confidence in the cause is high, and the test by other
    flights did not leave it unconfirmed.
    """
    if certain and _is_certain(cause):
        return str(cause["sentence"])
    return f"perhaps {cause['sentence']} (confidence {cause['confidence']:.2f})"


def _is_certain(cause: Mapping[str, Any]) -> bool:
    """Whether the confidence in a `cause` is high, and no test left it unconfirmed."""
    return bool(cause["confidence"] >= CONFIDENCE_RANDOM_TORQUE and cause.get("confirmed", True))


def disturbances_in_words(result: Diagnosis) -> str:
    """List the significant fast disturbances with their size and correlation time, and the kicks."""
    parts = [
        f"{1e3 * values['fast_std_Nm']:.2g} mN m about {axis} "
        f"with a correlation time of {values['correlation_time_s']:.1g} s"
        for axis, values in findings.disturbances(result.assessment.residual_analysis).items()
        if values["log_likelihood_ratio"] > MIN_MARGIN
    ]
    parts += thrust_noise_in_words(findings.thrust_noise(result.assessment.residual_analysis) or {})
    parts += [
        f"{kick.count} kick{'s' * (kick.count > 1)} of up to {1e3 * kick.largest_Nms:.2g} mN m s about {axis}"
        for axis, kick in result.assessment.residual_analysis.kicks.items()
    ]
    return ", ".join(parts) or "none that is significant"


def thrust_noise_in_words(noise: Mapping[str, Mapping[str, float]]) -> list[str]:
    """State how much supply and thrust vary at random, if that is significant; `noise` is as in the JSON."""
    beginnings = {
        "supply": "the supply varies by",
        "difference": "the difference of the two rotors' thrusts varies by",
    }
    return [
        f"{beginnings[name]} {100.0 * values['std']:.1g} % with a correlation time of "
        f"{values['correlation_time_s']:.1g} s"
        for name, values in noise.items()
        if values["log_likelihood_ratio"] > MIN_MARGIN
    ]


def lines(result: Diagnosis | InsufficientExcitation) -> list[str]:
    """List the numbers behind the summary, one line each."""
    if isinstance(result, InsufficientExcitation):
        return [
            f"undetectable effects: {', '.join(result.undetectable)}",
            f"unidentifiable parameters: {', '.join(result.unidentifiable)}",
            f"next flight: {result.next_flight.why}",
        ]
    lines = []
    for cause in findings.causes(result):
        others = cause["ambiguous_with"]
        unclear = f"; not distinguished from {', '.join(others)}" if others else ""
        lines.append(
            f"{cause['effect']} (confidence {cause['confidence']:.2f}{unclear}{_confirmation_text(cause)})"
        )
    lines += small_effect_lines(result)
    lines.append(f"{metric(result)}, before and after, and their ratio:")
    for axis, reduction in result.error_reductions.items():
        low, high = reduction.interval95
        lines.append(
            f"  {axis:9}  {reduction.before_deg:<7.3g} {reduction.after_deg:<7.3g} {reduction.ratio:.2f} "
            f"({low:.2f} to {high:.2f})"
        )
    lines += [f"a curve in its place: {curve.what}" for curve in result.curves]
    lines += _error_reduction_text(result.held_out.splines)
    if result.proposal is not None:
        lines += proposal_lines(result.proposal)
    elif result.label == "unexplained":
        lines.append("no equation of a few terms explains it and is confirmed by another flight")
    if result.next_flight is not None:
        lines.append(f"next flight: {result.next_flight.why}")
    elif result.undetectable:
        lines.append(f"these flights would not show at a typical size: {', '.join(result.undetectable)}")
    if findings.causes(result):
        lines.append("\N{PLUS-MINUS SIGN} is one standard error")
    lines.append(f"what to do next: {next_step(result)}")
    return lines + cautions(result)


def small_effect_lines(result: Diagnosis) -> list[str]:
    """List significant effects and dependences that are too small to matter, one line each."""
    entries = [
        (f"{effect['effect']}, {effect['sentence']}", effect["change_counts"])
        for effect in findings.too_small_effects(result)
    ]
    entries += [
        (f"{entry['sentence']}, which no effect of the catalogue explains", entry["change_counts"])
        for entry in findings.small_remainder(result)
    ]
    return [
        f"too small to matter: {text}; it changes the 2 s open-loop prediction by {counts:.2f} encoder "
        f"counts rms, less than {MATTERS_COUNTS:g}"
        for text, counts in entries
    ]


def _confirmation_text(cause: Mapping[str, Any]) -> str:
    """Return the end of a remark: whether a cause is confirmed; empty if that was not tested."""
    if "confirmed" not in cause:
        return ""
    return "; confirmed" if cause["confirmed"] else f"; not confirmed: {cause['replication']['why_not']}"


def unconfirmed_in_rig(result: Diagnosis, with_term: bool = False, with_unconfirmed: bool = False) -> str:
    """State in a sentence which causes are not confirmed, and whether a saved rig has them."""
    reasons = {id_: cause.why_not for id_, cause in result.replication.unconfirmed.items()}
    if not result.has_other_flight:
        reasons |= dict.fromkeys(result.random_torque, "no other flight was given")
    if not reasons:
        return ""
    has_term = with_term and result.proposal is not None
    place = "in this rig all the same" if with_unconfirmed or has_term else "not in this rig"
    return f"Not confirmed, and {place}: {'; '.join(f'{id_} ({why})' for id_, why in reasons.items())}."


def next_step(result: Diagnosis) -> str:
    """Return what to do after this verdict, in one or two sentences."""
    if result.label == "explained":
        return "use the refitted model; to find smaller effects, fly longer or with larger motions"
    if result.label == "cause_found":
        if not result.has_other_flight:
            return (
                "fly another plan, and give that flight to --validate, which confirms the cause or refutes it"
            )
        return "check the cause on the rig, and save the extended model with --save-rig"
    if result.label == "ambiguous":
        return "fly the proposed next flight, which distinguishes these causes, and diagnose both flights"
    if result.proposal is not None:
        return "try the proposed equation in simulation with --effect-file, and confirm it by another flight"
    return "look for a part of the rig that acts as described, and add it as an effect with --effect-file"


def metric(result: Diagnosis) -> str:
    """Name what the error reductions measure, with its unit."""
    return METRIC if result.assessment.after.held_out_fit else METRIC.replace("validation", "fitted")


def proposal_lines(proposal: Proposal) -> list[str]:
    """Describe a proposed equation, one line per fact."""
    term, discovery = proposal.term, proposal.term.discovery
    evidence_text = f"confidence {term.confidence:.2f}; {equation_evidence(discovery)}"
    lines = [f"proposed equation: {term.sentence} ({evidence_text})"]
    for name, (value, std, unit) in discovery.values.items():
        error_text = f" \N{PLUS-MINUS SIGN} {std:.2g}" if std else ""
        unit_text = "" if unit == "1" else unit
        lines.append(f"  {name} = {value:.4g}{error_text} {unit_text}".rstrip())
    close = [rival.key for rival in discovery.rivals if rival.log_likelihood_ratio < CONFIDENCE_NATS]
    if close:
        lines.append(f"  nearly as likely on these flights: {'; '.join(close)}")
    lines += _error_reduction_text(proposal.evaluation.reductions)
    if discovery.superfluous:
        lines.append(f"  causes that are not needed with this equation: {', '.join(discovery.superfluous)}")
    return lines


def equation_evidence(discovery: Discovery) -> str:
    """State the evidence for the equation of a `discovery` on the fitted and on the held-out flights."""
    fitted_text = f"{evidence_in_words(discovery.train)} on the fitted flights"
    if discovery.held_out is None:
        return f"{fitted_text}, no other flight confirms it"
    return f"{fitted_text}, {evidence_in_words(discovery.held_out)} on held-out flights"


def _error_reduction_text(reductions: Mapping[str, ErrorReduction]) -> list[str]:
    """Describe the errors that became smaller: those whose 95 % interval of the ratio is below 1."""
    return [
        f"  with it {axis} has an error of {reduction.after_deg:.3g} deg, ratio {reduction.ratio:.2f}"
        for axis, reduction in reductions.items()
        if reduction.interval95[1] < 1.0
    ]
