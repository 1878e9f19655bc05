"""Stepwise search for causes: forward selection, exchange and elimination.

Each round scores all candidates about the current estimate, refits the best, and accepts one whose
log-likelihood ratio exceeds its BIC penalty. A spline term competes in every round. If it beats every effect
refitted over its grid, the cause is not in the catalogue: the spline stays in its place, and the search goes
on. Held-out flights have a part in one choice only, between play and friction of an axis
(`forward.better_rival`). Otherwise they only remove what they contradict.

Exchange puts a wider effect in the place of one that it contains as a special case, or the other way round.
Elimination drops causes that are no longer needed, and measures the evidence of the others.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

import numpy as np
from heli_sim.model.effects.spec import EffectSpec

from heli_lab.explain import thresholds
from heli_lab.explain.candidates import Candidate, may_join, typical_candidate
from heli_lab.explain.comparison import (
    Alternative,
    Cause,
    Hypothesis,
    ModelComparison,
    Refit,
    Round,
    event_is_inside,
)
from heli_lab.explain.forward import Acceptance, ForwardSelection, Progress, min_margin
from heli_lab.explain.screening import NormalDistribution, Screening
from heli_lab.explain.thresholds import EVENT_STD_ERRORS, MIN_MARGIN
from heli_lab.fit.estimator import Estimate
from heli_lab.fit.flight_model import RigParameters
from heli_lab.fit.innovations import auxiliary_residuals
from heli_lab.fit.linearised_flight import BLOCK_s
from heli_lab.fit.records import Record
from heli_lab.threads import parallel_map

_STEP_s: Final = 0.03
"""Distance of the moments through which a parabola is drawn: the effects' step takes about 20 ms, an interval
of the filter 40 ms."""


def with_held_out_moments(comparison: ModelComparison, hypothesis: Hypothesis) -> Hypothesis:
    """Return a model in which events have their moments in the held-out flights too, if these show them."""
    for index, candidate in enumerate(hypothesis.candidates):
        if not candidate.effect.flight:
            continue
        for record in comparison.held_out:
            if record.label not in candidate.effect.other_moments_s:
                hypothesis = _HeldOutMoment(comparison, record, index).estimate(hypothesis)
    return hypothesis


class _HeldOutMoment:
    """Search for the moment of one event in one held-out flight."""

    def __init__(self, comparison: ModelComparison, record: Record, index: int) -> None:
        self.comparison, self.record, self.index = comparison, record, index

    def estimate(self, hypothesis: Hypothesis) -> Hypothesis:
        """Return the model with the moment in the held-out flight, or unchanged if that shows no event."""
        without_event = self.comparison.held_out_estimate(hypothesis)
        effect = hypothesis.candidates[self.index].effect
        moments_s = [hypothesis.params[effect.moment], *self._suggested_s(without_event)]
        moments_s = [moment_s for moment_s in moments_s if event_is_inside(self.record, moment_s)]
        if not moments_s:  # no moment is in the free flight
            return hypothesis
        log_likelihoods = [self._log_likelihood(hypothesis, moment_s) for moment_s in moments_s]
        max_log_likelihood = max(log_likelihoods)
        best_s = moments_s[log_likelihoods.index(max_log_likelihood)]
        # BIC for one parameter, and one test per instant.
        penalty = 1.5 * math.log(self.record.used_s / BLOCK_s)
        if max_log_likelihood - without_event.log_likelihood <= penalty + MIN_MARGIN:
            return hypothesis
        return self._with_moment(hypothesis, self._refined_s(hypothesis, max_log_likelihood, best_s))

    def _suggested_s(self, without_event: Estimate) -> list[float]:
        """Return the instant at which a torque most significantly changes for good [s]; empty without one."""
        flight = self.comparison.held_out.index(self.record)
        residuals = auxiliary_residuals(without_event.filtered(), without_event.disturbances)[flight]
        level_s, statistic = residuals.largest_level()
        return [level_s] if statistic > EVENT_STD_ERRORS else []

    def _refined_s(self, hypothesis: Hypothesis, log_likelihood: float, moment_s: float) -> float:
        """Return a more likely moment close to `moment_s`, which has the given `log_likelihood` [s]."""
        before = self._log_likelihood(hypothesis, moment_s - _STEP_s)
        after = self._log_likelihood(hypothesis, moment_s + _STEP_s)
        curvature = before - 2.0 * log_likelihood + after
        if curvature >= 0.0:
            return moment_s  # the parabola has no maximum
        # The vertex of the parabola through the three points, not beyond them.
        vertex = 0.5 * (before - after) / curvature
        return moment_s + _STEP_s * max(-1.0, min(1.0, vertex))

    def _log_likelihood(self, hypothesis: Hypothesis, moment_s: float) -> float:
        """Return the log-likelihood of the held-out flights if the event happens at a moment, nats."""
        return self.comparison.held_out_estimate(self._with_moment(hypothesis, moment_s)).log_likelihood

    def _with_moment(self, hypothesis: Hypothesis, moment_s: float) -> Hypothesis:
        """Return the model in which the event of the held-out flight happens at a moment."""
        candidates: list[Candidate] = list(hypothesis.candidates)
        candidate = candidates[self.index]
        moments_s = {**candidate.effect.other_moments_s, self.record.label: moment_s}
        effect = replace(candidate.effect, other_moments_s=moments_s)
        candidates[self.index] = replace(candidate, effect=effect)
        return self.comparison.with_effects(hypothesis, candidates)


_NO_FLIGHT: Final = "\0"
"""A label that no flight has."""


@dataclass(frozen=True)
class Direction:
    """Result of fitting causes on some flights and comparing them on other flights."""

    comparison: ModelComparison
    """Parameters are estimated on its fitted flights, and causes are compared on its held-out flights."""
    baseline: Hypothesis  # The model without causes on the fitted flights
    whole: Hypothesis  # The model with all causes on the fitted flights
    log_likelihood_ratio: Mapping[str, float]
    """Log-likelihood ratio of each cause on the held-out flights of the comparison, nats, by id."""


def direction(
    comparison: ModelComparison, final: Hypothesis, fitted_start: Estimate, held_out_start: Estimate
) -> Direction:
    """Compare a model with the models that lack one of its causes each."""
    candidates = with_fixed_moments(final)
    baseline = comparison.filtering_baseline
    whole = _refit(comparison, candidates, final.estimate, fitted_start)
    log_likelihood = comparison.held_out_estimate(whole, held_out_start).log_likelihood

    def log_likelihood_ratio(candidate: Candidate) -> float:
        """Return the ratio of the model over the same model without a cause, on the held-out flights."""
        other_causes = tuple(other for other in candidates if other is not candidate)
        reduced = baseline
        if other_causes:
            reduced = _refit(comparison, other_causes, whole.estimate, whole.estimate)
        return log_likelihood - comparison.held_out_estimate(reduced, held_out_start).log_likelihood

    ratios = parallel_map(log_likelihood_ratio, candidates)
    ids = (candidate.id for candidate in candidates)
    return Direction(comparison, baseline, whole, dict(zip(ids, ratios, strict=True)))


def held_out_screening(comparison: ModelComparison, hypothesis: Hypothesis) -> Screening:
    """Score candidates about a `hypothesis` on the held-out flights of a comparison."""
    # All parameters are free. The prior of those that all flights share is their estimate on the fitted
    # flights with its covariance, so that an error which their uncertainty explains is no missing effect.
    fitted, held_out = hypothesis.estimate, comparison.held_out_estimate(hypothesis)
    vector = RigParameters(fitted.parameter_vector.model, comparison.rig, comparison.held_out)
    constants = held_out.parameter_vector.by_name(held_out.theta)
    theta = vector.started_from({**fitted.parameter_vector.shared_by_name(fitted.theta), **constants})
    # Shared parameters come first in both vectors.
    shared = slice(sum(parameter.is_shared for parameter in vector.free))
    precision = np.diag(vector.std**-2.0)
    precision[shared, shared] = np.linalg.inv(fitted.covariance[shared, shared])
    mean = vector.mean.copy()
    mean[shared] = theta[shared]
    estimate = replace(held_out, parameter_vector=vector, theta=theta, functions=fitted.functions)
    return Screening(estimate, NormalDistribution(mean, precision))


def _refit(
    comparison: ModelComparison, candidates: tuple[Candidate, ...], shared: Estimate, fitted_start: Estimate
) -> Hypothesis:
    """Refit a model with some candidates on the fitted flights."""
    start = fitted_start.parameter_vector.by_name(fitted_start.theta)
    start |= shared.parameter_vector.shared_by_name(shared.theta)
    return comparison.refit_from(candidates, start, fitted_start.disturbances)


def with_fixed_moments(hypothesis: Hypothesis) -> tuple[Candidate, ...]:
    """Return the candidates of a model with the moment of each event fixed at its estimate."""
    # A fit on other flights could not estimate the moment, because these flights do not contain it.

    def with_fixed_moment(candidate: Candidate) -> Candidate:
        """Return an event that happens at known moments only; other candidates are unchanged."""
        effect = candidate.effect
        if not effect.flight:  # no event
            return candidate
        moments_s = {**effect.other_moments_s, effect.flight: hypothesis.params[effect.moment]}
        return replace(candidate, effect=replace(effect, flight=_NO_FLIGHT, other_moments_s=moments_s))

    return tuple(map(with_fixed_moment, hypothesis.candidates))


def exchange(
    comparison: ModelComparison, acceptance: Acceptance, progress: Progress, final: Hypothesis
) -> Hypothesis:
    """Replace effects by wider ones of which the flights resolve each size, and those of which they do not by
    narrower ones, until nothing changes.
    """
    final = _without_unresolved_sizes(comparison, acceptance, progress, final)
    kinds = acceptance.kinds
    for candidate in final.candidates:
        for kind in kinds.values():
            if candidate.id not in kind.contains or kind.id in final.ids or not progress.refits_left():
                continue
            other_causes = [other for other in final.candidates if other is not candidate]
            if not may_join(kind.id, [other.id for other in other_causes], kinds):
                continue
            wider = Candidate(kind.id, kind.make(kind.from_contained(final.params)), (), {})
            refit = comparison.refit([*other_causes, wider], wider.start_values(np.zeros(0)), final)
            gain = refit.log_likelihood - final.log_likelihood
            margin = gain - acceptance.penalty(wider) + acceptance.penalty(candidate)
            if margin > thresholds.MIN_MARGIN and acceptance.resolves(refit, kind):
                return exchange(comparison, acceptance, progress, refit)
    return final


def _without_unresolved_sizes(
    comparison: ModelComparison, acceptance: Acceptance, progress: Progress, final: Hypothesis
) -> Hypothesis:
    """Replace each effect of which the flights do not resolve all sizes by the likeliest of those that it
    contains.
    """
    # A delay of 29 ms without disturbances came out as one of 28 ms with a lag of 0.8 ms, because voltages
    # are held over a step of 1 ms.
    kinds = acceptance.kinds
    for candidate in final.candidates:
        kind = kinds.get(candidate.id)
        if kind is None or not kind.contains or acceptance.resolves(final, kind):
            continue
        other_causes = [other for other in final.candidates if other is not candidate]
        narrower = [
            comparison.refit([*other_causes, contained], contained.effect.values, final)
            for contained in _contained(kind, kinds, final.params)
            if progress.refits_left()
        ]
        if narrower:
            final = max(narrower, key=lambda hypothesis: hypothesis.log_likelihood)
    return final


def _contained(
    kind: EffectSpec, kinds: Mapping[str, EffectSpec], values: Mapping[str, float]
) -> Iterator[Candidate]:
    """Yield the effects that an effect contains, at its values."""
    for id_, parameters in kind.contains.items():
        if id_ in kinds:
            contained = kinds[id_]
            own_values = {contained.full(name): values[kind.full(of)] for name, of in parameters.items()}
            yield Candidate(id_, contained.make(own_values), contained.size)


class Compared(NamedTuple):
    """Another effect in the place of a cause, and the model with it."""

    alternative: Alternative
    hypothesis: Hypothesis


@dataclass
class BackwardElimination:
    """Removes causes from the model that forward selection ended with."""

    comparison: ModelComparison
    acceptance: Acceptance
    progress: Progress
    baseline: Hypothesis  # The model without any cause
    rounds: Sequence[Round]  # The rounds of the forward selection
    contradicted_ids: set[str] = field(default_factory=set)
    """Ids of the causes so far that held-out flights contradict."""
    replaced_ids: set[str] = field(default_factory=set)
    """Ids of the causes so far in whose place another effect is more probable."""
    _round_ids: dict[str, str] = field(default_factory=dict, init=False)
    """The cause that was accepted in a round, by the id of the cause that took its place."""

    def eliminate(self, final: Hypothesis) -> tuple[Hypothesis, list[Cause]]:
        """Remove causes from the model `final` that are not significant or that held-out flights
        contradict.
        """
        final, reduced_by_id = self._remove_superfluous(with_held_out_moments(self.comparison, final))
        held_out_ratios = self._held_out_ratios(final, reduced_by_id)
        contradicted = {id_ for id_, ratio in held_out_ratios.items() if ratio < _required_ratio(id_)}
        weakest = min(contradicted, key=lambda id_: held_out_ratios[id_], default=None)
        if weakest is not None:
            # Without this cause, others may be significant or contradicted, so the elimination begins again.
            self.contradicted_ids.add(weakest)
            return self.eliminate(self.restore_displaced(final, weakest, reduced_by_id[weakest]))
        compared_by_id = {
            candidate.id: self._compared(final, candidate, reduced_by_id[candidate.id])
            for candidate in final.candidates
        }
        more_probable = self._more_probable(compared_by_id, reduced_by_id)
        if more_probable is not None:
            return self.eliminate(more_probable)
        causes = [
            Cause(
                candidate,
                train_nats=final.log_likelihood - reduced_by_id[candidate.id].log_likelihood,
                held_out_nats=held_out_ratios.get(candidate.id),
                penalty=self.acceptance.penalty(candidate),
                alternatives=tuple(compared.alternative for compared in compared_by_id[candidate.id]),
            )
            for candidate in final.candidates
        ]
        return final, sorted(causes, key=lambda cause: -cause.train_nats)

    def _more_probable(
        self, compared_by_id: Mapping[str, Sequence[Compared]], reduced_by_id: Mapping[str, Hypothesis]
    ) -> Hypothesis | None:
        """Return the most probable model with another effect in the place of a cause, if it is more probable
        than the model with the cause, would be accepted, and held-out flights do not contradict it.
        """
        # The selection adds one cause after the other, so a later cause may change which of two similar
        # effects fits better. An effect that was replaced does not return.
        better = sorted(
            (alternative.log_likelihood_ratio, id_, alternative.id, hypothesis)
            for id_, compared in compared_by_id.items()
            for alternative, hypothesis in compared
            if alternative.log_likelihood_ratio < 0.0 and alternative.id not in self.replaced_ids
        )
        for _, id_, other_id, hypothesis in better:
            reduced = reduced_by_id[id_]
            gain = hypothesis.log_likelihood - reduced.log_likelihood
            other = next(candidate for candidate in hypothesis.candidates if candidate.id == other_id)
            # The effect was refitted without a score test.
            refit = Refit(hypothesis, gain, self.acceptance.penalty(other), score=0.0, added_id=other_id)
            if not self.acceptance.accepts(refit):
                continue
            held_out = self._held_out_ratios(hypothesis, {other_id: reduced})
            if held_out.get(other_id, 0.0) < _required_ratio(other_id):
                continue
            self.replaced_ids.add(id_)
            self._round_ids[other_id] = self._round_ids.get(id_, id_)
            return hypothesis
        return None

    def restore_displaced(self, final: Hypothesis, cause_id: str, reduced: Hypothesis) -> Hypothesis:
        """Return the model without a cause that held-out flights contradict, and with the causes that it had
        displaced.
        """
        # A spline may have followed a peculiarity of one flight. Then the causes before its round are
        # restored, and the best accepted effect of its round.
        round_ = self._round_of(cause_id)
        cause = next(candidate for candidate in final.candidates if candidate.id == cause_id)
        if not cause.is_spline or round_ is None:
            return reduced  # only splines displace other causes
        displaced = list(round_.base.candidates)
        displaced += [refit.candidate for refit in round_.refits if self.acceptance.accepts(refit)][:1]
        present_ids, restored = list(reduced.ids), list[Candidate]()
        for candidate in displaced:
            # A cause that was accepted after the spline may exclude an effect from before.
            if (
                not candidate.is_spline
                and candidate.id not in present_ids
                and may_join(candidate.id, present_ids, self.acceptance.kinds)
            ):
                restored.append(candidate)
                present_ids.append(candidate.id)
        if not restored:
            return reduced  # nothing was displaced, or nothing is compatible
        start = {**round_.base.params, **reduced.params}
        return self.comparison.refit([*reduced.candidates, *restored], start, reduced)

    def _round_of(self, cause_id: str) -> Round | None:
        """Return the last round of the forward selection that accepted a cause, or the one that it replaced;
        None without one.
        """
        accepted_id = self._round_ids.get(cause_id, cause_id)
        return next((round_ for round_ in reversed(self.rounds) if round_.accepted_id == accepted_id), None)

    def _remove_superfluous(self, final: Hypothesis) -> tuple[Hypothesis, dict[str, Hypothesis]]:
        """Remove causes one by one until all are significant."""
        while True:
            causes = final.candidates
            reduced_by_id: dict[str, Hypothesis] = {}
            reduced = final
            for number, candidate in enumerate(causes):
                self.progress.check(candidate.id, number, len(causes))
                other_causes = [other for other in causes if other is not candidate]
                reduced = self.comparison.refit(other_causes, None, final) if other_causes else self.baseline
                gain = final.log_likelihood - reduced.log_likelihood
                refit = Refit(final, gain, penalty=self.acceptance.penalty(candidate), score=0.0)
                exceeds_penalty = refit.margin > min_margin(candidate.id, final.ids)
                if not exceeds_penalty or not self.acceptance.is_significant(refit, candidate):
                    break
                reduced_by_id[candidate.id] = reduced
            if len(reduced_by_id) == len(causes):
                return final, reduced_by_id
            # The last refit is the model without the cause that is not significant.
            final = reduced

    def _held_out_ratios(
        self, final: Hypothesis, reduced_by_id: Mapping[str, Hypothesis]
    ) -> dict[str, float]:
        """Return the log-likelihood ratio of each cause on the held-out flights, nats, by id."""
        if not self.comparison.held_out or not reduced_by_id:
            return {}  # nothing contradicts a cause then
        estimates = parallel_map(self.comparison.held_out_estimate, [final, *reduced_by_id.values()])
        final_estimate, *reduced_estimates = estimates
        return {
            id_: final_estimate.log_likelihood - reduced.log_likelihood
            for id_, reduced in zip(reduced_by_id, reduced_estimates, strict=True)
        }

    def _compared(self, final: Hypothesis, candidate: Candidate, reduced: Hypothesis) -> list[Compared]:
        """Refit other effects in the place of a cause: those of its round, and those of its family, which a
        low score or the limit of refits may have kept out.
        """
        # Return them with their models, the closest first. `reduced` is the model without the cause.
        if candidate.is_spline:
            return []  # effects in its place were refitted before it was accepted
        round_ = self._round_of(candidate.id)
        round_refits = round_.refits if round_ else ()
        other_causes = [other for other in final.candidates if other is not candidate]
        compared: list[Compared] = []

        def compare(other: Candidate, refit: Hypothesis | None) -> None:
            """Compare an effect with the cause; `refit` is its refit in the round."""
            candidates = [*other_causes, other]
            replaced = refit
            # The round may have begun with causes that were removed since, or without those of later rounds.
            if replaced is None or {*replaced.ids} != {present.id for present in candidates}:
                replaced = self.comparison.refit(candidates, replaced.params if replaced else None, reduced)
            if self.comparison.in_flight(replaced) and not self._adds_unresolved(candidate, other, replaced):
                nats = final.log_likelihood - replaced.log_likelihood
                ratio = nats + self.acceptance.penalty(other) - self.acceptance.penalty(candidate)
                compared.append(Compared(Alternative(other.id, ratio), replaced))

        for refit in self._likely_alternatives(final, other_causes, round_refits):
            is_exhausted = bool(other_causes) and not self.progress.refits_left()
            if len(compared) >= thresholds.ALTERNATIVES or is_exhausted:
                break
            compare(refit.candidate, refit.hypothesis)
        tried = {refit.candidate.id: refit for refit in round_refits}
        compared_ids = {each.alternative.id for each in compared}
        for member in self._family(candidate, other_causes):
            if member.id in tried and member.id not in compared_ids:
                compare(tried[member.id].candidate, tried[member.id].hypothesis)
            elif member.id not in compared_ids:
                compare(member, None)
        return sorted(compared, key=lambda each: each.alternative.log_likelihood_ratio)

    def _adds_unresolved(self, cause: Candidate, other: Candidate, replaced: Hypothesis) -> bool:
        """Whether another effect is the cause with more sizes, of which the flights do not resolve each."""
        kind = self.acceptance.kinds.get(other.id)
        if kind is None or cause.id not in kind.contains:
            return False
        return not self.acceptance.resolves(replaced, kind)

    def _family(self, candidate: Candidate, other_causes: Sequence[Candidate]) -> list[Candidate]:
        """Return the other effects of a cause's family that may join the other causes, with typical sizes."""
        # Effects that contain the cause, or are contained in it, are left out: `exchange` chooses among them.
        kinds, present_ids = self.acceptance.kinds, [other.id for other in other_causes]
        if candidate.id not in kinds or kinds[candidate.id].family is None:
            return []
        cause = kinds[candidate.id]
        return [
            typical_candidate(kind)
            for kind in kinds.values()
            if kind.family == cause.family
            and kind.id not in {cause.id, *cause.contains, *present_ids}
            and cause.id not in kind.contains
            and may_join(kind.id, present_ids, kinds)
        ]

    def _likely_alternatives(
        self, final: Hypothesis, other_causes: Sequence[Candidate], round_refits: Sequence[Refit]
    ) -> list[Refit]:
        """Return refits of a round that may join the other causes, the best score first."""
        kinds = self.acceptance.kinds
        best_score = max((refit.score for refit in round_refits), default=0.0)

        def may_join_other_causes(refit: Refit) -> bool:
            if refit.score < thresholds.ALTERNATIVE_SHARE * best_score:
                return False
            return may_join(refit.candidate.id, [other.id for other in other_causes], kinds)

        return [
            refit
            for refit in sorted(round_refits, key=lambda refit: -refit.score)
            if refit.candidate.id not in final.ids
            and not refit.candidate.is_spline
            and (not other_causes or may_join_other_causes(refit))
        ]


def _required_ratio(id_: str) -> float:
    """Return the log-likelihood ratio on held-out flights below which they contradict a cause, nats."""
    return thresholds.SPLINE_HELD_OUT_NATS if id_.startswith("spline:") else thresholds.HELD_OUT_AGAINST


_MAX_TURNS: Final = 2
"""Turns of selection and elimination. Fewer: causes are missed that a false one hid until it was removed.
More: time."""


@dataclass(frozen=True)
class Search:
    """Result of a search."""

    baseline: Hypothesis  # The refitted model without causes
    final: Hypothesis  # The model with all causes, spline terms included
    causes: tuple[Cause, ...]
    """Effects and spline terms of the final model with their evidence, the strongest first."""
    rounds: tuple[Round, ...]  # Rounds of the forward selection
    screening: Screening  # Scores of candidates about the final model
    complete: bool  # False if the limit of refits ended the search


def search(
    comparison: ModelComparison,
    kinds: Mapping[str, EffectSpec],
    *,
    removable: Sequence[EffectSpec] = (),
    say: Callable[[str, float], None] | None = None,
    refits: float = math.inf,
) -> Search:
    """Search for the causes of what a model lacks."""
    progress = Progress(comparison, say or (lambda _step, _share: None), refits)
    acceptance = Acceptance(comparison, kinds)
    progress.baseline()
    baseline = comparison.refit([])
    forward = ForwardSelection(comparison, acceptance, progress, removable)
    backward = BackwardElimination(comparison, acceptance, progress, baseline, forward.rounds)
    forward.excluded_ids = backward.contradicted_ids
    final, causes = baseline, list[Cause]()
    for _ in range(_MAX_TURNS):
        progress.accepted = len(final.candidates)
        selection = forward.select(final)
        if selection.hypothesis is final:  # no cause was added
            break
        exchanged = exchange(comparison, acceptance, progress, selection.hypothesis)
        final, causes = backward.eliminate(exchanged)
        # Another turn is worth its time only if a cause was removed, because it may have hidden another one.
        if set(exchanged.ids) <= {*final.ids, *backward.replaced_ids}:
            break
    screening = selection.screening if final is selection.hypothesis else Screening(final.estimate)
    return Search(
        baseline, final, tuple(causes), tuple(forward.rounds), screening, complete=selection.complete
    )
