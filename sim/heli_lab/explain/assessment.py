"""Assessment of a search: what the model with the causes leaves and predicts, and the verdict.

Without disturbances, a flight shows effects far below an encoder count, as small as numerical errors of the
method. A cause is named only if it is significant and matters.

The search adds a cause only if the fitted flights show it. The residual analysis also tests the held-out
flights, and may find structure that only these show. Before the verdict is ``unexplained``, all effects are
therefore tested on fitted and held-out flights together.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.model.effects.spec import EffectSpec
from heli_sim.rig import Rig

from heli_lab.explain import thresholds
from heli_lab.explain.candidates import CandidateSignals, ScoredCandidate, may_join
from heli_lab.explain.comparison import Alternative, Cause, Hypothesis, ModelComparison, Refit
from heli_lab.explain.forward import Acceptance
from heli_lab.explain.prediction import Prediction, normalised_samples, predict
from heli_lab.explain.residuals import ResidualAnalysis, residual_analysis
from heli_lab.explain.screening import Screening, coefficient_std, score_of
from heli_lab.explain.stepwise import Search, held_out_screening
from heli_lab.explain.thresholds import DISTURBED_STD, MATTERS_COUNTS, MATTERS_NATS_PER_ROW, MIN_MARGIN
from heli_lab.explain.verdict import (
    PriorConflict,
    Verdict,
    describe_negligible_effects,
    judge,
    prior_conflicts,
)
from heli_lab.fit.flight_model import GAINS
from heli_lab.fit.parameters import ValueAndStd
from heli_lab.fit.problem import Fit
from heli_lab.fit.records import Record
from heli_lab.fit.voltage_timing import (
    AdvanceEstimate,
    advance_rates,
    may_be_slower,
    most_likely_advance,
    sampled_advance,
)


@dataclass(frozen=True)
class AbsentTerm:
    """A term of the baseline that the rig does not have."""

    id: str  # Id in the catalogue, such as ``removed.friction.travel``
    share: float  # share, std: Share of the term that is absent, 0 to 1, and its standard error
    std: float
    confidence: float  # Posterior probability that the term is absent, see `absence_probability`
    z_from_zero: float
    """Distance of its parameter from 0 in standard errors; the largest if it has several parameters."""
    z_from_rig: float
    """Distance of its parameter from the rig file's value in standard errors; the smallest of several."""


def absent_terms(
    fit: Fit,
    rig: Rig,
    kinds: Mapping[str, EffectSpec],
    on_all_flights: Mapping[str, ValueAndStd] | None = None,
) -> tuple[AbsentTerm, ...]:
    """Find terms whose parameters are zero within their standard errors."""
    # `on_all_flights`: Estimates with their standard errors that held-out flights have made more precise.
    joint = on_all_flights or {}
    values = fit.params | {name: estimate.value for name, estimate in joint.items()}
    reported_std = fit.std | {name: estimate.std for name, estimate in joint.items()}
    terms = []
    for id_, kind in kinds.items():
        names = [name for name in kind.override if name in values and rig[name].value > 0.0]
        if not kind.baseline or not names:
            continue  # no term of the baseline, or none that the fit estimates
        # Estimates and standard errors in units of the rig file's values, one per parameter of the term.
        nominal = np.array([rig[name].value for name in names])
        # A joint estimate has left the bound of the fit.
        is_zero = [name in fit.at_bound and name not in joint for name in names]
        relative = np.where(is_zero, 0.0, np.maximum([values[name] for name in names], 0.0)) / nominal
        relative_std = np.array([reported_std[name] for name in names]) / nominal
        # A tolerance in a rig file is two standard deviations.
        rig_std = [0.5 * rig[name].tolerance / rig[name].value for name in names]
        confidence = math.prod(map(absence_probability, relative.tolist(), relative_std.tolist(), rig_std))
        if confidence < thresholds.ABSENT_MIN_CONFIDENCE:
            continue
        std = np.maximum(relative_std, thresholds.ABSENT_MIN_STD)
        first_relative, first_std = float(relative[0]), float(std[0])
        terms.append(
            AbsentTerm(
                id_,
                share=min(max(1.0 - first_relative, 0.0), 1.0),
                std=first_std,
                confidence=confidence,
                z_from_zero=float(np.max(np.abs(relative) / std)),
                z_from_rig=float(np.min((1.0 - relative) / std)),
            )
        )
    return tuple(sorted(terms, key=lambda term: -term.confidence))


def absence_probability(value: float, std: float, rig_std: float) -> float:
    """Return the posterior probability that a parameter is zero, by Bayes' rule."""
    # All arguments are shares of the rig file's value; `rig_std` is the standard deviation that it states.
    # The alternative hypothesis is the prior of the fit: a parameter that is positive, and normal about the
    # rig file's value. If a tolerance includes zero, it includes small values too, and an estimate near zero
    # shows an absent term only if it is precise enough to exclude most of them. Terms are as rarely absent as
    # effects are present.
    std, present_std = max(std, thresholds.ABSENT_MIN_STD), max(rig_std, thresholds.PRESENT_MIN_STD)
    total_std = math.hypot(std, present_std)
    # The density of the estimate is integrated over positive values. This gives a normal density, times the
    # probability that the parameter is positive, given the estimate.
    mean = (value * present_std**2 + std**2) / total_std**2
    positive = _normal_cdf(mean * total_std / (std * present_std)) / _normal_cdf(1.0 / present_std)
    present_nats = math.log(positive / total_std) - 0.5 * ((value - 1.0) / total_std) ** 2
    absent_nats = -math.log(std) - 0.5 * (value / std) ** 2
    lead_nats = absent_nats - present_nats - math.log(thresholds.CANDIDATES_TRIED)
    return min(thresholds.MAX_CONFIDENCE, 1.0 / (1.0 + math.exp(min(-lead_nats, _MAX_NATS))))


_MAX_NATS: Final = 700.0
"""Largest log-likelihood ratio whose exponential is finite in double precision."""


def _normal_cdf(value: float) -> float:
    return 0.5 * math.erfc(-value / math.sqrt(2.0))


class Influence(NamedTuple):
    """The change if a cause is left out of the model, and everything else is refitted."""

    change_counts: float  # Root mean square change of the 2 s open-loop prediction, encoder counts
    conflicts: tuple[PriorConflict, ...]
    """Parameters of the rig that then leave their priors, because they stand in for the cause."""

    @property
    def matters(self) -> bool:
        """Whether the prediction or the rig's own parameters need the cause."""
        return self.change_counts >= MATTERS_COUNTS or bool(self.conflicts)


def influences(
    comparison: ModelComparison, search: Search, extended: Hypothesis, before: Prediction, after: Prediction
) -> Mapping[str, Influence]:
    """Compute what changes without each cause."""
    # The model with all causes is compared with the refitted model without the cause, on the axis where they
    # differ most. The change is the root mean square difference of their predictions on the fitted flights.
    # If the model without the cause adds a larger error on the held-out flights, the change is that error.
    # A cause without an entry counts as one that matters: all of them if the residual exceeds
    # `DISTURBED_STD`, and each with much evidence.
    if not extended.candidates or after.train.total > DISTURBED_STD:
        return {}
    samples_with_all = normalised_samples(after.fit)
    present_conflicts = {conflict.name for conflict in prior_conflicts(after.fit)}
    result = {}
    evidence_nats = {cause.effect: cause.train_nats for cause in search.causes}
    for candidate in extended.candidates:
        other_causes = [other for other in extended.candidates if other is not candidate]
        if other_causes and evidence_nats[candidate.id] > MATTERS_NATS_PER_ROW * comparison.rows:
            continue  # saves free runs; a single cause needs none, because `before` has them
        # The elimination has estimated this model: it is in the cache.
        reduced = (
            predict(
                comparison.refit(other_causes, None, extended).estimate, comparison.train, comparison.held_out
            )
            if other_causes
            else before
        )
        difference = samples_with_all - normalised_samples(reduced.fit)
        added_error = np.maximum(reduced.held_out.axes**2 - after.held_out.axes**2, 0.0)
        change_counts = max(map(_largest_counts, (np.mean(difference**2, axis=0), added_error)))
        conflicts = tuple(
            conflict for conflict in prior_conflicts(reduced.fit) if conflict.name not in present_conflicts
        )
        result[candidate.id] = Influence(change_counts, conflicts)
    return result


def spline_change(
    comparison: ModelComparison, search: Search, extended: Hypothesis, after: Prediction
) -> float:
    """Compute by how much the spline terms of a search change the 2 s open-loop prediction, encoder
    counts.
    """
    # The final model is compared with the `extended` model, which lacks only them, as `influences` does;
    # `after` is the prediction of the latter. Infinite without spline terms.
    if extended is search.final or after.train.total > DISTURBED_STD:
        return math.inf
    final = predict(search.final.estimate, comparison.train, comparison.held_out)
    difference = normalised_samples(final.fit) - normalised_samples(after.fit)
    reduced_error = np.maximum(after.held_out.axes**2 - final.held_out.axes**2, 0.0)
    return max(map(_largest_counts, (np.mean(difference**2, axis=0), reduced_error)))


def _largest_counts(mean_squares: Floats) -> float:
    """Return the largest root mean square of the axes, in encoder counts."""
    # `mean_squares` (3,) are in units of the quantisation's variance, which is a twelfth of a squared count.
    return float(np.sqrt(mean_squares / 12.0).max())


@dataclass(frozen=True)
class Assessment:
    """Remaining errors and predictions of the model with the causes, and the verdict."""

    residual_analysis: ResidualAnalysis  # Analysis of the residuals of the final model
    extended: Hypothesis
    """The model with the named causes of the catalogue, without spline terms and without effects that are too
    small to matter: the one that a simulator can fly."""
    before: Prediction
    """before, after: Free runs of the refitted baseline and of the extended model over all flights."""
    after: Prediction
    absent_terms: tuple[AbsentTerm, ...]  # Terms of the baseline whose parameters the fit estimated as zero
    verdict: Verdict  # The verdict and its causes
    instead: Mapping[str, tuple[PriorConflict, ...]] = field(default_factory=dict)
    """By cause: parameters of the rig that predict the flights as well without it, at values that conflict
    with the rig file. Such a cause is as certain as the rig file."""
    held_out_screenings: tuple[Screening, ...] = field(default=(), repr=False, compare=False)
    """Scores of candidates about the final model on the held-out flights; empty if they cannot be tested."""


def assess(comparison: ModelComparison, search: Search, kinds: Mapping[str, EffectSpec]) -> Assessment:
    """Assess the result of a search: residuals, predictions, effects too small to matter, and the verdict."""
    train, held_out = comparison.train, comparison.held_out
    held_out_screenings: list[Screening] = []
    if comparison.can_test_held_out:
        held_out_screenings = [held_out_screening(comparison, search.final)]
    residual = residual_analysis([search.screening, *held_out_screenings])
    extended = without_splines(comparison, search)
    before = predict(search.baseline.estimate, train, held_out)
    after = before if extended is search.baseline else predict(extended.estimate, train, held_out)
    # A term is absent in each flight, so held-out flights count too.
    joint = held_out_screenings[0].estimates() if held_out_screenings else None
    absent = absent_terms(after.fit, comparison.rig, kinds, joint)
    influence = influences(comparison, search, extended, before, after)
    spline_counts = spline_change(comparison, search, extended, after)
    negligible_changes = {
        id_: without_it.change_counts for id_, without_it in influence.items() if not without_it.matters
    }
    instead = {
        id_: without_it.conflicts
        for id_, without_it in influence.items()
        if without_it.conflicts and without_it.change_counts < MATTERS_COUNTS
    }
    negligible = describe_negligible_effects(search, negligible_changes, kinds, after.fit)
    if negligible:
        # The extended model has only the effects that matter.
        extended = without(comparison, search, extended, negligible_changes)
        after = before if extended is search.baseline else predict(extended.estimate, train, held_out)
        absent = absent_terms(after.fit, comparison.rig, kinds, joint)
    verdict = judge(search, residual, after, kinds, bool(absent), negligible, spline_counts)
    for screening in held_out_screenings:
        screening.release()
    return Assessment(
        residual,
        extended,
        before=before,
        after=after,
        absent_terms=absent,
        verdict=verdict,
        instead=instead,
        held_out_screenings=tuple(held_out_screenings),
    )


def without_splines(comparison: ModelComparison, search: Search) -> Hypothesis:
    """Refit the final model of a `search` without its spline terms, which no simulator flies."""
    effects = [candidate for candidate in search.final.candidates if not candidate.is_spline]
    if len(effects) == len(search.final.candidates):
        return search.final
    if not effects:
        return search.baseline
    return comparison.refit(effects, None, search.final)


def without(
    comparison: ModelComparison, search: Search, extended: Hypothesis, ids: Collection[str]
) -> Hypothesis:
    """Refit an `extended` model without the effects `ids`."""
    other_effects = [candidate for candidate in extended.candidates if candidate.id not in ids]
    return comparison.refit(other_effects, None, extended) if other_effects else search.baseline


_NUMBERS = 2 * len(GAINS)
"""Numbers of a thrust that varies: standard deviation and correlation time of each gain."""


def justified_thrust_noise(
    comparison: ModelComparison, search: Search, assessment: Assessment
) -> ModelComparison | None:
    """Return the comparison with a thrust that varies at random, if that is needed and justified."""
    # It is needed if the verdict is ``unexplained``. It is justified if it adds more to the log-likelihood of
    # all flights than its BIC penalty, and more than the predictors and splines that it is to replace.
    if assessment.verdict.label != "unexplained":
        return None
    without_spline_terms = without_splines(comparison, search)
    with_noise = comparison.with_thrust_noise()
    gain = _log_likelihood(
        with_noise, with_noise.refit_with_thrust_noise(without_spline_terms)
    ) - _log_likelihood(comparison, without_spline_terms)
    penalty = 0.5 * _NUMBERS * math.log(comparison.rows) + MIN_MARGIN
    replaced_gain = 0.0
    if search.final is not without_spline_terms:
        replaced_gain = _log_likelihood(comparison, search.final) - _log_likelihood(
            comparison, without_spline_terms
        )
    dependences = assessment.residual_analysis.dependences
    replaced_gain += max((dependence.log_likelihood_gain for dependence in dependences), default=0.0)
    return with_noise if gain > max(penalty, replaced_gain) else None


def with_likelier_advance(
    comparison: ModelComparison, screenings: Sequence[Screening], loop_Hz: float | None
) -> ModelComparison | None:
    """Return the comparison in which voltages act earlier or later within the rows of their log, if the
    flights are much more likely so with the final model of a search.
    """
    # `screenings`: Those of the final model, on the fitted flights first. `loop_Hz` is as in `diagnose`.
    # None if they are not, if no log can be slower than the control loop, or if the model has a delay, which
    # is a negative advance.
    is_slow = any(may_be_slower(record, loop_Hz) for record in comparison.train)
    if not is_slow or screenings[0].estimate.functions.model.source.delay:
        return None
    best = estimated_advance(screenings, loop_Hz)
    for screening in screenings:
        screening.release()
    if not best.is_significant:
        return None
    return comparison.with_advance(lambda record: best.rows if may_be_slower(record, loop_Hz) else 0.0)


def estimated_advance(screenings: Sequence[Screening], loop_Hz: float | None) -> AdvanceEstimate:
    """Estimate when the voltages of logs act that may be slower than the control loop, given models of their
    flights. The logs are of one logger, and one of them may be slower.
    """
    score = information = 0.0
    slow_records: list[Record] = []
    for screening in screenings:
        signals = []
        for flight in screening.filtered.linearised_flights:
            record = flight.reference.record
            assert isinstance(record, Record)
            is_slow = may_be_slower(record, loop_Hz)
            slow_records += [record] * is_slow  # none if it is not slow
            signals.append(CandidateSignals(advance_rates(flight) * is_slow, measured_rad=None))
        (statistics,) = screening.information(signals, [1])
        score, information = score + float(statistics.score[0]), information + statistics.information.item()
    first = slow_records[0]
    candidates_rows = () if loop_Hz is None else (0.0, sampled_advance(first, loop_Hz), 1.0)
    return most_likely_advance(first.advance_rows, score, information, candidates_rows)


def _log_likelihood(comparison: ModelComparison, hypothesis: Hypothesis) -> float:
    """Return the log-likelihood of the fitted and the held-out flights, nats."""
    total = hypothesis.log_likelihood
    if comparison.held_out:
        total += comparison.held_out_estimate(hypothesis).log_likelihood
    return total


class _JointScore(NamedTuple):
    """A candidate scored on all flights together; `margin` is the score less the penalty, nats."""

    scored: ScoredCandidate
    margin: float


def with_listed_remainder(
    comparison: ModelComparison,
    search: Search,
    assessment: Assessment,
    tried: Mapping[str, EffectSpec],
    kinds: Mapping[str, EffectSpec],
) -> tuple[Search, Assessment]:
    """Add one more listed effect to a search if all flights together show it."""
    # A flight alone may show an effect too weakly: a drag of travel of 4.6 standard errors in the fitted
    # flight and 6.7 in the held-out one was not named (seed 9193 of `tests.field.slow_logs`, 2026-11).
    # An effect that the fitted flights do not show at all is tried only if something stays unexplained.
    min_nats = 0.0 if assessment.verdict.label == "unexplained" else thresholds.JOINT_MIN_NATS
    if not assessment.verdict.unlisted:
        wider = with_remainder(comparison, search, tried, assessment.held_out_screenings, min_nats)
        if wider is not None:
            explained = assess(comparison, wider, kinds)
            if explained.verdict.label != "unexplained":
                return wider, explained
    return search, assessment


def with_remainder(
    comparison: ModelComparison,
    search: Search,
    kinds: Mapping[str, EffectSpec],
    held_out_screenings: Sequence[Screening],
    min_nats: float,
) -> Search | None:
    """Add the listed effect that explains best what remains on all flights."""
    # `min_nats`: Smallest score on the fitted flights of an effect that is tried.
    if not held_out_screenings:
        return None
    final, acceptance = search.final, Acceptance(comparison, kinds)
    screenings = [search.screening, *held_out_screenings]
    ranked = _on_all_flights(screenings, acceptance, search, min_nats)
    for screening in screenings:
        screening.release()
    if not ranked or not acceptance.worth_a_refit([ranked[0].scored]):
        return None  # no refit can be accepted
    best = ranked[0]
    candidate = best.scored.candidate
    start = candidate.start_values(best.scored.coefficients)
    refit = comparison.refit([*final.candidates, candidate], start, final)
    train_nats = refit.log_likelihood - final.log_likelihood
    held_out_nats = (
        comparison.held_out_estimate(refit).log_likelihood
        - comparison.held_out_estimate(final).log_likelihood
    )
    penalty = acceptance.penalty(candidate)
    # Each set of flights must agree, because this choice has used both.
    on_all_flights = Refit(refit, train_nats + held_out_nats, penalty, best.scored.log_likelihood_gain)
    if min(train_nats, held_out_nats) <= 0.0 or not acceptance.accepts(on_all_flights):
        return None
    cause = Cause(
        next(other for other in refit.candidates if other.id == candidate.id),
        train_nats=train_nats,
        held_out_nats=held_out_nats,
        penalty=penalty,
        alternatives=tuple(
            Alternative(other.scored.candidate.id, best.margin - other.margin)
            for other in ranked[1 : 1 + thresholds.ALTERNATIVES]
        ),
    )
    return replace(search, final=refit, causes=(*search.causes, cause), screening=Screening(refit.estimate))


_MAX_CURVES_TRIED: Final = 2
"""Curves that are refitted in the place of what no effect explains. More: time, for the weaker ones."""


def with_curves(
    comparison: ModelComparison, search: Search, assessment: Assessment, kinds: Mapping[str, EffectSpec]
) -> Hypothesis | None:
    """Return the model with curves in the place of what no effect explains; None if no curve also makes the
    held-out flights more likely.
    """
    if assessment.verdict.label != "unexplained" or not comparison.held_out:
        return None
    if assessment.verdict.unlisted:
        return search.final  # it has the curves already
    final, acceptance = search.final, Acceptance(comparison, kinds)
    held_out = comparison.held_out_estimate(final)
    for scored in search.screening.splines()[:_MAX_CURVES_TRIED]:
        candidate = scored.candidate
        if scored.log_likelihood_gain <= acceptance.penalty(candidate):
            return None  # later curves have lower scores
        refit = comparison.refit(
            [*final.candidates, candidate], candidate.start_values(scored.coefficients), final
        )
        if comparison.held_out_estimate(refit, held_out).log_likelihood > held_out.log_likelihood:
            return refit
    return None


def _on_all_flights(
    screenings: Sequence[Screening], acceptance: Acceptance, search: Search, min_nats: float
) -> list[_JointScore]:
    """Score listed effects that may join the causes with one coefficient for all flights, the best first."""
    kinds, present_ids = acceptance.kinds, search.final.ids
    if search.rounds and search.rounds[-1].base is search.final:
        # The last round added nothing, so its scores are about the final model.
        all_scored = list(search.rounds[-1].screened)
    else:
        compatible = [kind for kind in kinds.values() if may_join(kind.id, present_ids, kinds)]
        all_scored = screenings[0].effects(compatible)
    # An effect at a moment is left out, because its moment belongs to one flight.
    eligible = [
        scored
        for scored in all_scored
        if scored.candidate.id not in present_ids
        and not scored.candidate.effect.moment
        and scored.log_likelihood_gain >= min_nats
    ]
    candidates = [scored.candidate for scored in eligible]
    statistics = [screening.statistics(candidates) for screening in screenings]
    ranked = []
    for scored, *by_screening in zip(eligible, *statistics, strict=True):
        information = np.sum([of_flights.information for of_flights in by_screening], axis=0)
        score = np.sum([of_flights.score for of_flights in by_screening], axis=0)
        joint = score_of(information, score, coefficient_std(scored.candidate))
        margin = joint.log_likelihood_gain - acceptance.penalty(scored.candidate, scored.grid_points)
        joint_scored = replace(
            scored, coefficients=joint.coefficients, log_likelihood_gain=joint.log_likelihood_gain
        )
        ranked.append(_JointScore(joint_scored, margin))
    return sorted(ranked, key=lambda joint: -joint.margin)
