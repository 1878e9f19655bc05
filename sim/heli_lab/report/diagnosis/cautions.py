"""Cautions: what weakens a diagnosis."""

from __future__ import annotations

from heli_lab.explain.evaluate.fitted_voltages import Extrapolation
from heli_lab.explain.evaluate.prior_conflict import PriorConflict
from heli_lab.explain.evaluate.replication import worse_axis_sentence
from heli_lab.explain.result import Diagnosis
from heli_lab.explain.thresholds import SHORT_s
from heli_lab.explain.wording import evidence_in_words


def cautions(result: Diagnosis) -> list[str]:
    """List what weakens a `result`, in sentences without full stops; empty if nothing does."""
    lines = [f"not used: {why}" for why in result.skipped]
    held_out = result.assessment.after.held_out_fit
    if held_out is None:
        lines.append("no flight was held out: nothing here is confirmed; give one to --validate")
    else:
        lines += _held_out_cautions(result, sum(record.used_s for record in held_out.problem.records))
    unconfirmed = ", ".join(result.replication.unconfirmed)
    model = "the model with all named causes" if unconfirmed else "the extended model"
    lines += [worse_axis_sentence(worse, model) for worse in result.replication.worse]
    if unconfirmed:
        lines.append(
            f"not confirmed, and not in the extended rig: {unconfirmed}; --with-unconfirmed adds what is not "
            "confirmed to the rig of --save-rig"
        )
    meanings = {
        quantity.name: quantity.meaning for quantity in result.assessment.after.fit.problem.model.parameters
    }
    lines += [
        prior_conflict_sentence(conflict, meanings.get(conflict.name, ""))
        for conflict in result.prior_conflicts
    ]
    if not result.has_converged_estimate:
        lines.append(
            "the estimate of the final model did not converge, as may happen with an axis that sticks: its "
            "parameters may be less exact than their standard errors"
        )
    if not result.has_converged_prediction:
        lines.append("the free runs of the extended model did not converge: their errors may be too large")
    if not result.search.complete:
        lines.append("the limit of refits ended the search before everything was tried; raise --budget")
    return lines


def _held_out_cautions(result: Diagnosis, seconds: float) -> list[str]:
    """Return cautions about the comparison on held-out flights of so many `seconds` of free flight."""
    requested_s = result.held_out.requested_s
    runs = result.held_out.extension.after
    lines = []
    if seconds < SHORT_s:
        lines.append(f"only {seconds:.0f} s were held out: too few for the intervals of the ratios")
    lines += [
        f"{run.label} is short: its zeros and torques are calibrated on {run.calibrated_s:.1f} s of it, "
        f"not on {requested_s:g}"
        for run in runs
        # A difference of a sample is not worth a line.
        if run.calibrated_s < 0.99 * requested_s
    ]
    return lines + [extrapolation_sentence(flight) for flight in result.extrapolations if flight.spans_s]


def extrapolation_sentence(flight: Extrapolation) -> str:
    """Describe the windows of a `flight` in which the model extrapolates, without a full stop."""
    ranges = ", ".join(f"{rotor} {low:.1f} to {high:.1f} V" for rotor, (low, high) in flight.ranges_V.items())
    return (
        f"in {len(flight.spans_s)} of {flight.windows} windows of {flight.label}, the prediction "
        f"extrapolates: a voltage is outside the fitted range ({ranges})"
    )


def prior_conflict_sentence(conflict: PriorConflict, meaning: str = "") -> str:
    """Describe a `conflict` of a parameter with this `meaning` in a sentence without its full stop."""
    unit = "" if conflict.unit == "1" else f" {conflict.unit}"
    prior = conflict.prior
    meaning_text = f" ({meaning})" if meaning else ""
    text = (
        f"the parameter {conflict.name}{meaning_text} is estimated as {conflict.value:.3g}{unit}, "
        f"{abs(conflict.deviations):.1f} "
        f"standard deviations from its prior, {prior.mean:.3g} \N{PLUS-MINUS SIGN} {prior.std:.2g}{unit} "
        "(1 standard deviation): either the prior is wrong, or the parameter replaces what the model lacks"
    )
    without_prior = conflict.freed
    if without_prior is None:
        return text
    return (
        f"{text}; these flights alone give {without_prior.value:.3g} \N{PLUS-MINUS SIGN} "
        f"{without_prior.std:.2g}{unit} "
        f"(1 standard error), with {evidence_in_words(without_prior.log_likelihood_gain)} against the prior"
    )
