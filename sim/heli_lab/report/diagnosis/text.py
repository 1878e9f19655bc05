"""A diagnosis in words: its findings as records for text and JSON, cautions, and sentences."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Final

from heli_host.data.log.comparison import table_lines
from heli_sim.model.effect import AXES, NEVER_s

from heli_lab.explain.experiment_design import InsufficientExcitation
from heli_lab.explain.prediction import ErrorReduction, Extrapolation
from heli_lab.explain.regression import Discovery
from heli_lab.explain.replication import CauseReplication, worse_axis_sentence
from heli_lab.explain.residuals import Kicks, ResidualAnalysis, correlates
from heli_lab.explain.result import Diagnosis, Proposal
from heli_lab.explain.thresholds import (
    CONFIDENCE_FACTOR_UNEXPLAINED,
    CONFIDENCE_NATS,
    CONFIDENCE_RANDOM_TORQUE,
    MATTERS_COUNTS,
    MIN_MARGIN,
    SHORT_s,
)
from heli_lab.explain.verdict import CauseParameter, FamilyNumber, NamedCause, PriorConflict
from heli_lab.explain.wording import capital, dependence_in_words, evidence_in_words
from heli_lab.fit.voltage_timing import slow_log_notes
from heli_lab.watch.error_shares import ErrorShares
from heli_lab.watch.forecast import MAIN_HORIZON_s


@dataclass(frozen=True)
class CauseEntry:
    """A cause as a report states it."""

    effect: str  # Id of the effect
    parameters: Mapping[str, CauseParameter]
    confidence: float
    sentence: str
    equation: str
    evidence: Mapping[str, Any]  # As in the JSON
    ambiguous_with: tuple[str, ...] = ()  # Ids of effects that the flights do not distinguish from it
    replication: CauseReplication | None = None  # None if no other flights test the cause
    moments_s: Mapping[str, float | None] | None = None
    """Time of an event by label of the flight, None in a flight without it; None for other effects."""
    family: FamilyNumber | None = None

    @property
    def is_certain(self) -> bool:
        """Whether the confidence is high, and no test left the cause unconfirmed."""
        is_refuted = self.replication is not None and not self.replication.confirmed
        return self.confidence >= CONFIDENCE_RANDOM_TORQUE and not is_refuted

    @property
    def is_unclear_in_family(self) -> bool:
        """Whether the flights do not distinguish the cause from a member of its family."""
        return self.family is not None and bool({*self.ambiguous_with} & {*self.family.members})

    @property
    def family_sentence(self) -> str:
        """The number of the family in words, with a remark if its members are not distinguished."""
        if self.family is None:
            return ""
        unclear = f"; {self.family.unclear}" if self.is_unclear_in_family else ""
        return f"{self.family.sentence}{unclear}"

    def statement(self, certain: bool = True) -> str:
        """Write the sentence as a fact, or with "perhaps" and the confidence."""
        if certain and self.is_certain:
            return self.sentence
        return f"perhaps {self.sentence} (confidence {self.confidence:.2f})"

    def to_json(self) -> dict[str, Any]:
        """Write the cause as a JSON object."""
        entry: dict[str, Any] = {
            "effect": self.effect,
            "parameters": _parameter_entries(self.parameters),
            "confidence": self.confidence,
            "sentence": self.sentence,
            "equation": self.equation,
            "evidence": dict(self.evidence),
            "ambiguous_with": list(self.ambiguous_with),
        }
        if self.replication is not None:
            ratios = {"forward": self.replication.forward, "reverse": self.replication.reverse}
            entry["confirmed"] = self.replication.confirmed
            entry["replication"] = {
                "log_likelihood_ratio": ratios,
                "why_not": self.replication.why_not or None,
            }
        if self.moments_s is not None:
            entry["moments_s"] = dict(self.moments_s)
        if self.family is not None:
            entry["family"] = {
                "name": self.family.name,
                "value": self.family.value,
                "std": self.family.std,
                "unit": self.family.unit,
                "members": list(self.family.members),
                "sentence": self.family_sentence,
            }
        return entry


def cause_entries(result: Diagnosis) -> list[CauseEntry]:
    """List the causes, the strongest first."""
    return [*_effect_causes(result), *_random_torque_causes(result), *_absent_term_causes(result)]


def _effect_causes(result: Diagnosis) -> list[CauseEntry]:
    """Return the causes that are effects of the catalogue."""
    return [
        CauseEntry(
            effect=cause.effect,
            parameters=cause.parameters,
            confidence=round(cause.confidence, 3),
            sentence=cause.sentence,
            equation=cause.equation,
            evidence={
                "log_likelihood_ratio_train": cause.train_nats,
                "log_likelihood_ratio_held_out": cause.held_out_nats,
                "penalty": cause.penalty,
                "alternatives": {other.id: other.log_likelihood_ratio for other in cause.alternatives},
            },
            ambiguous_with=tuple(cause.ambiguous_with),
            replication=result.replication.causes[cause.effect],
            moments_s=_event_times_s(cause, result),
            family=cause.family,
        )
        for cause in result.verdict.causes
    ]


def too_small_effects(result: Diagnosis) -> list[dict[str, Any]]:
    """List significant effects that are too small to matter, each as a JSON object."""
    # ``change_counts`` is by how many encoder counts an effect changes the open-loop prediction.
    return [
        {
            "effect": effect.cause.effect,
            "parameters": _parameter_entries(effect.cause.parameters),
            "sentence": effect.cause.sentence,
            "change_counts": effect.change_counts,
            "log_likelihood_ratio": effect.cause.train_nats,
        }
        for effect in result.verdict.negligible_effects
    ]


def small_remainder(result: Diagnosis) -> list[dict[str, Any]]:
    """List significant dependences that no effect explains and that are too small to matter, each as a JSON
    object.
    """
    return [
        {
            "dependence": dependence.what,
            "sentence": dependence_in_words(dependence.what),
            "change_counts": dependence.change_counts,
            "log_likelihood_gain": dependence.log_likelihood_gain,
        }
        for dependence in result.verdict.negligible_dependences
    ]


def _event_times_s(cause: NamedCause, result: Diagnosis) -> dict[str, float | None] | None:
    """Return the times of an effect that begins during a flight, by label of the flight; None for other
    effects.
    """
    effect = cause.candidate.effect
    if not effect.flight:
        return None
    after = result.assessment.after
    records = [
        *after.fit.problem.records,
        *(after.held_out_fit.problem.records if after.held_out_fit else ()),
    ]
    values = {name: number.value for name, number in cause.parameters.items()}
    times_s = {record.label: effect.values_in(record.label, values)[effect.moment] for record in records}
    return {label: None if at_s == NEVER_s else at_s for label, at_s in times_s.items()}


def _random_torque_causes(result: Diagnosis) -> list[CauseEntry]:
    """Return the cause of a random torque about a single axis, if the verdict has one."""
    return [
        CauseEntry(
            id_,
            parameters=values,
            confidence=CONFIDENCE_RANDOM_TORQUE,
            sentence=result.kinds[id_].describe(
                {key: number.value for key, number in values.items()},
                {key: number.std for key, number in values.items()},
            ),
            equation=result.kinds[id_].equation,
            evidence={"log_likelihood_ratio": float(result.assessment.residual_analysis.gains.max())},
        )
        for id_, values in result.random_torque.items()
    ]


def _absent_term_causes(result: Diagnosis) -> list[CauseEntry]:
    """Return the causes that are absent terms of the baseline."""
    factor = CONFIDENCE_FACTOR_UNEXPLAINED if result.label == "unexplained" else 1.0
    entries = []
    for term in result.assessment.absent_terms:
        kind = result.kinds[term.id]
        (name,) = kind.size
        evidence = {
            "standard_errors_from_zero": term.z_from_zero,
            "standard_errors_from_rig": term.z_from_rig,
        }
        entries.append(
            CauseEntry(
                effect=term.id,
                parameters={name: CauseParameter(term.share, term.std, "1")},
                confidence=round(term.confidence * factor, 3),
                sentence=kind.describe({name: term.share}, {name: term.std}),
                equation=kind.equation,
                evidence=evidence,
            )
        )
    return entries


def unexplained(result: Diagnosis) -> dict[str, Any] | None:
    """Describe the dependence that no effect explains; None if everything is explained."""
    if result.missing is None:
        return None
    axis, quantity = result.missing
    residual = result.assessment.residual_analysis
    if not result.verdict.unlisted:
        # The same quantity may be listed as a spline and as a linear term.
        dependence_names = list(dict.fromkeys(dependence.what for dependence in residual.dependences))
        return {
            "axis": axis,
            "correlates_with": dependence_names,
            "share_of_variance": round(residual.predictable_share, 4),
            "log_likelihood_gain": residual.dependences[0].log_likelihood_gain,
        }
    strongest = result.verdict.unlisted[0]
    channel = strongest.candidate.dependence.channel
    round_of_term = next(
        round_ for round_ in result.search.rounds if round_.accepted_id == strongest.candidate.id
    )
    others = [name for name in correlates(round_of_term.splines) if name != f"{channel} on {quantity}"]
    reductions = result.held_out.splines
    return {
        "axis": axis,
        "channel": channel,
        "correlates_with": [f"{channel} on {quantity}", *others],
        "share_of_variance": round(max(0.0, 1.0 - reductions[axis].ratio ** 2), 4),
        "log_likelihood_gain": strongest.train_nats,
        "splines": [cause.candidate.id.removeprefix("spline:") for cause in result.verdict.unlisted],
        "gain_with_splines": reductions_json(reductions),
    }


def disturbances(analysis: ResidualAnalysis) -> dict[str, dict[str, float]]:
    """Write the disturbances about each axis."""
    estimated, none = analysis.disturbances, Kicks(0, 0.0)
    return {
        axis: {
            "fast_std_Nm": float(estimated.fast_std[i]),
            "correlation_time_s": float(estimated.correlation_time_s[i]),
            "slow_std_Nm": float(estimated.slow_std[i]),
            "log_likelihood_ratio": float(analysis.gains[i]),
            "kicks": analysis.kicks.get(axis, none).count,
            "largest_kick_Nms": analysis.kicks.get(axis, none).largest_Nms,
        }
        for i, axis in enumerate(AXES)
    }


def thrust_noise(analysis: ResidualAnalysis) -> dict[str, dict[str, float]] | None:
    """Write how much the thrusts vary at random; None if torques suffice as disturbances."""
    # ``supply`` is a relative variation of both thrusts together, ``difference`` one of the rotors against
    # each other.
    estimated = analysis.disturbances
    if not estimated.gains:
        return None
    return {
        name: {
            "std": gain.std,
            "correlation_time_s": gain.correlation_time_s,
            "log_likelihood_ratio": float(ratio),
        }
        for name, gain, ratio in zip(
            ("supply", "difference"), estimated.gains, analysis.thrust_gains, strict=True
        )
    }


def reductions_json(reductions: Mapping[str, ErrorReduction]) -> dict[str, dict[str, Any]]:
    """Write error `reductions` by axis: errors before and after in degrees, ratio and its 95 % interval."""
    return {
        axis: {
            "before": reduction.before_deg,
            "after": reduction.after_deg,
            "ratio": reduction.ratio,
            "interval95": list(reduction.interval95),
        }
        for axis, reduction in reductions.items()
    }


def _parameter_entries(parameters: Mapping[str, CauseParameter]) -> dict[str, dict[str, float | str]]:
    """Write parameters by name: value, standard error and unit."""
    return {name: asdict(parameter) for name, parameter in parameters.items()}


def cautions(result: Diagnosis) -> list[str]:
    """List what weakens a `result`, in sentences without full stops; empty if nothing does."""
    lines = [*slow_log_cautions(result), *(f"not used: {why}" for why in result.skipped)]
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
    lines += [
        f"without {cause}, a model with {estimates_with_priors(conflicts)} predicts these flights as well: "
        f"measure what the rig file states there; if it is wrong, nothing shows {cause}"
        for cause, conflicts in result.assessment.instead.items()
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


def estimates_with_priors(conflicts: Iterable[PriorConflict]) -> str:
    """State estimates of parameters, each with its prior."""
    return " and ".join(
        f"{conflict.name} = {conflict.value:.3g}{_unit(conflict)} (rig file: {conflict.prior.mean:.3g} "
        f"\N{PLUS-MINUS SIGN} {conflict.prior.std:.2g}{_unit(conflict)})"
        for conflict in conflicts
    )


def _unit(conflict: PriorConflict) -> str:
    """Return the unit of a parameter as text that follows its value."""
    return "" if conflict.unit == "1" else f" {conflict.unit}"


def slow_log_cautions(result: Diagnosis | InsufficientExcitation) -> list[str]:
    """List what logs that are slower than the control loop do not show, in sentences without full stops."""
    if isinstance(result, InsufficientExcitation):
        return []
    after = result.assessment.after
    records = [
        *after.fit.problem.records,
        *(after.held_out_fit.problem.records if after.held_out_fit else ()),
    ]
    return slow_log_notes(records)


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
    unit, prior = _unit(conflict), conflict.prior
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


METRIC: Final = "2 s free-run rms on the validation flights, deg"
"""Quantity that the error reductions compare if flights are held out."""


def title(result: Diagnosis) -> str:
    """Write the verdict as a headline that claims no more than `summary` does."""
    causes = cause_entries(result)
    effects = [cause.effect for cause in causes]
    plural = "s" * (len(effects) > 1)
    is_certain = all(cause.is_certain for cause in causes)
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
    causes = cause_entries(result)
    held_out = result.assessment.after.held_out_fit
    flights_text = "flights that no fit used" if held_out else "the fitted flights"
    disturbance_text = f" What remains are disturbances: {disturbances_in_words(result)}."
    if label == "explained":
        return (
            f"The refitted baseline explains these flights: its errors on {flights_text} cannot be "
            f"predicted.{disturbance_text}"
        )
    if label in ("cause_found", "ambiguous"):
        text = "; ".join(cause.statement() for cause in causes)
        others = sorted({other for cause in causes for other in cause.ambiguous_with})
        ambiguity_text = f" These flights do not distinguish it from {', '.join(others)}." if others else ""
        for cause in causes:
            if cause.is_unclear_in_family:
                ambiguity_text += f" {capital(cause.family_sentence)}."
        return f"{capital(text)}.{ambiguity_text}{disturbance_text}"
    missing = unexplained(result) or {}
    text = (
        "The model lacks an effect that the catalogue does not list. "
        f"{capital(dependence_in_words(missing['correlates_with'][0]))} predicts the motion about "
        f"{missing['axis']}, with {evidence_in_words(missing['log_likelihood_gain'])}."
    )
    if causes:
        cause_text = "; ".join(f"{cause.sentence} (confidence {cause.confidence:.2f})" for cause in causes)
        text += f" Together with it, perhaps: {cause_text}."
    return text


def disturbances_in_words(result: Diagnosis) -> str:
    """List the significant fast disturbances with their size and correlation time, and the kicks."""
    parts = [
        f"{1e3 * values['fast_std_Nm']:.2g} mN m about {axis} "
        f"with a correlation time of {values['correlation_time_s']:.1g} s"
        for axis, values in disturbances(result.assessment.residual_analysis).items()
        if values["log_likelihood_ratio"] > MIN_MARGIN
    ]
    parts += thrust_noise_in_words(thrust_noise(result.assessment.residual_analysis) or {})
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


def error_share_rows(shares: ErrorShares) -> list[list[str]]:
    """Return a table row for each axis: error without and with the causes [deg], and each part of the error
    in degrees and in percent of its mean square.
    """
    return [
        [
            axis,
            f"{of_axis.before_deg:.3g}",
            f"{of_axis.after_deg:.3g}",
            *(f"{part.deg:z.2g} ({100.0 * part.share:z.0f} %)" for part in of_axis.parts.values()),
        ]
        for axis, of_axis in shares.axes.items()
    ]


SHARE_HEADS: Final = ("axis", "without causes", "with causes", "causes", "disturbances", "unknown")
"""Heads of the columns of `error_share_rows`."""


def error_share_sentences(shares: ErrorShares, label: str) -> list[str]:
    """State on what the remaining forecast error depends, in sentences without full stops; `label` is that of
    the verdict.
    """
    judged = ", ".join(shares.labels)
    sentences = [
        f"{capital(dependence_in_words(curve))} predicts a part of the unknown error of {judged}"
        for curve in shares.curves
    ]
    sentences += [
        f"In {judged}, the error of {axis} is {of_axis.larger_where.ratio:.1f} times as large if a forecast "
        f"begins with {of_axis.larger_where.text}"
        for axis, of_axis in shares.axes.items()
        if of_axis.larger_where is not None
    ]
    if label != "unexplained":
        return sentences
    if not shares.has_other_flight:
        return ["No other flight was given, so a dependence of the unknown error was not tested"]
    sentences += [
        f"{capital(dependence_in_words(dependence))} is significant, but forecasts do not show how much of "
        "the disturbances it is"
        for dependence in shares.unresolved
    ]
    if not any(of_axis.larger_where for of_axis in shares.axes.values()):
        sentences.append(f"No range of voltage, angle or rate has significantly larger errors in {judged}")
    return sentences


def share_heading(shares: ErrorShares) -> str:
    """Name what the parts are parts of, with their units."""
    return (
        f"error of forecasts {MAIN_HORIZON_s:g} s ahead on {', '.join(shares.labels)}, deg rms, and its "
        "parts (% of the mean square)"
    )


def _free_run_lines(result: Diagnosis) -> list[str]:
    """Write the free-run errors of baseline and extended model; in one line if the extended model is the
    baseline, because no cause is confirmed.
    """
    reductions = result.error_reductions
    if all(reduction.before_deg == reduction.after_deg for reduction in reductions.values()):
        errors = ", ".join(f"{axis} {reduction.after_deg:.3g}" for axis, reduction in reductions.items())
        return [f"{metric(result)}, of the model without causes: {errors}"]
    lines = [f"{metric(result)}, before and after, and their ratio:"]
    for axis, reduction in reductions.items():
        low, high = reduction.interval95
        lines.append(
            f"  {axis:9}  {reduction.before_deg:<7.3g} {reduction.after_deg:<7.3g} {reduction.ratio:.2f} "
            f"({low:.2f} to {high:.2f})"
        )
    return lines


def lines(result: Diagnosis | InsufficientExcitation, shares: ErrorShares | None = None) -> list[str]:
    """List the numbers behind the summary, one line each; `shares` are the parts of the forecast error."""
    if isinstance(result, InsufficientExcitation):
        return [
            f"undetectable effects: {', '.join(result.undetectable)}",
            f"unidentifiable parameters: {', '.join(result.unidentifiable)}",
            f"next flight: {result.next_flight.why}",
        ]
    lines = []
    for cause in cause_entries(result):
        others = ", ".join(cause.ambiguous_with)
        unclear = f"; not distinguished from {others}" if others else ""
        lines.append(
            f"{cause.effect} (confidence {cause.confidence:.2f}{unclear}{_confirmation_text(cause)})"
        )
    lines += small_effect_lines(result)
    lines += _free_run_lines(result)
    if shares is not None:
        lines.append(f"{share_heading(shares)}:")
        lines += [f"  {line}" for line in table_lines([SHARE_HEADS, *error_share_rows(shares)])]
        lines += error_share_sentences(shares, result.label)
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
    if cause_entries(result):
        lines.append("\N{PLUS-MINUS SIGN} is one standard error")
    lines.append(f"what to do next: {next_step(result)}")
    shown_first = slow_log_cautions(result)
    return lines + [caution for caution in cautions(result) if caution not in shown_first]


def small_effect_lines(result: Diagnosis) -> list[str]:
    """List significant effects and dependences that are too small to matter, one line each."""
    entries = [
        (f"{effect['effect']}, {effect['sentence']}", effect["change_counts"])
        for effect in too_small_effects(result)
    ]
    entries += [
        (f"{entry['sentence']}, which no effect of the catalogue explains", entry["change_counts"])
        for entry in small_remainder(result)
    ]
    return [
        f"too small to matter: {text}; it changes the 2 s open-loop prediction by {counts:.2f} encoder "
        f"counts rms, less than {MATTERS_COUNTS:g}"
        for text, counts in entries
    ]


def _confirmation_text(cause: CauseEntry) -> str:
    """Return the end of a remark: whether a cause is confirmed; empty if that was not tested."""
    if cause.replication is None:
        return ""
    return "; confirmed" if cause.replication.confirmed else f"; not confirmed: {cause.replication.why_not}"


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
    fitted_text = f"{evidence_in_words(discovery.train_nats)} on the fitted flights"
    if discovery.held_out_nats is None:
        return f"{fitted_text}, no other flight confirms it"
    return f"{fitted_text}, {evidence_in_words(discovery.held_out_nats)} on held-out flights"


def _error_reduction_text(reductions: Mapping[str, ErrorReduction]) -> list[str]:
    """Describe the errors that became smaller: those whose 95 % interval of the ratio is below 1."""
    return [
        f"  with it {axis} has an error of {reduction.after_deg:.3g} deg, ratio {reduction.ratio:.2f}"
        for axis, reduction in reductions.items()
        if reduction.interval95[1] < 1.0
    ]
