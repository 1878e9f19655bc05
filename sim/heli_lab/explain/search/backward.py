"""Backward elimination: drop causes that are no longer needed, and measure the evidence of the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from heli_lab.explain import thresholds
from heli_lab.explain.search.acceptance import Acceptance, min_margin
from heli_lab.explain.search.candidate import Candidate, may_join, typical_candidate
from heli_lab.explain.search.hypothesis import Alternative, Cause, Hypothesis, Refit, Round
from heli_lab.explain.search.model_comparison import ModelComparison
from heli_lab.explain.search.moments import with_held_out_moments
from heli_lab.explain.search.progress import Progress
from heli_lab.threads import parallel_map

Compared = tuple[Alternative, Hypothesis]
"""Another effect in the place of a cause, and the model with it."""


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
                train=final.log_likelihood - reduced_by_id[candidate.id].log_likelihood,
                held_out=held_out_ratios.get(candidate.id),
                penalty=self.acceptance.penalty(candidate),
                alternatives=tuple(alternative for alternative, _ in compared_by_id[candidate.id]),
            )
            for candidate in final.candidates
        ]
        return final, sorted(causes, key=lambda cause: -cause.train)

    def _more_probable(
        self, compared_by_id: Mapping[str, Sequence[Compared]], reduced_by_id: Mapping[str, Hypothesis]
    ) -> Hypothesis | None:
        """Return the most probable model with another effect in the place of a cause, if it is more probable
        than the model with the cause, would be accepted, and held-out flights do not contradict it.

        The selection adds one cause after the other, so a later cause may change which of two similar effects
        fits better. An effect that was replaced does not return.
        """
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

        A spline may have followed a peculiarity of one flight. Then the causes before its round are restored,
        and the best accepted effect of its round.
        """
        round_ = self._round_of(cause_id)
        cause = next(candidate for candidate in final.candidates if candidate.id == cause_id)
        if not cause.is_spline or round_ is None:
            return reduced
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
            return reduced
        start = {**round_.base.values, **reduced.values}
        return self.comparison.refit([*reduced.candidates, *restored], start, reduced)

    def _round_of(self, cause_id: str) -> Round | None:
        """Return the last round of the forward selection that accepted a cause, or the one that it
        replaced.
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
            return {}
        estimates = parallel_map(self.comparison.held_out_estimate, [final, *reduced_by_id.values()])
        final_estimate, *reduced_estimates = estimates
        return {
            id_: final_estimate.log_likelihood - reduced.log_likelihood
            for id_, reduced in zip(reduced_by_id, reduced_estimates, strict=True)
        }

    def _compared(self, final: Hypothesis, candidate: Candidate, reduced: Hypothesis) -> list[Compared]:
        """Refit other effects in the place of a cause: those of its round, and those of its family, which a
        low score or the limit of refits may have kept out. Return them with their models, the closest first.

        `reduced` is the model without the cause.
        """
        if candidate.is_spline:
            return []
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
                replaced = self.comparison.refit(candidates, replaced.values if replaced else None, reduced)
            if self.comparison.in_flight(replaced) and not self._adds_unresolved(candidate, other, replaced):
                ratio = final.log_likelihood - replaced.log_likelihood
                ratio = ratio + self.acceptance.penalty(other) - self.acceptance.penalty(candidate)
                compared.append((Alternative(other.id, ratio), replaced))

        for refit in self._likely_alternatives(final, other_causes, round_refits):
            is_exhausted = bool(other_causes) and not self.progress.refits_left()
            if len(compared) >= thresholds.ALTERNATIVES or is_exhausted:
                break
            compare(refit.candidate, refit.hypothesis)
        tried = {refit.candidate.id: refit for refit in round_refits}
        compared_ids = {alternative.id for alternative, _ in compared}
        for member in self._family(candidate, other_causes):
            if member.id in tried and member.id not in compared_ids:
                compare(tried[member.id].candidate, tried[member.id].hypothesis)
            elif member.id not in compared_ids:
                compare(member, None)
        return sorted(compared, key=lambda pair: pair[0].log_likelihood_ratio)

    def _adds_unresolved(self, cause: Candidate, other: Candidate, replaced: Hypothesis) -> bool:
        """Whether another effect is the cause with more sizes, of which the flights do not resolve each."""
        kind = self.acceptance.kinds.get(other.id)
        if kind is None or cause.id not in kind.contains:
            return False
        return not self.acceptance.resolves(replaced, kind)

    def _family(self, candidate: Candidate, other_causes: Sequence[Candidate]) -> list[Candidate]:
        """Return the other effects of a cause's family that may join the other causes, with typical sizes.

        Effects that contain the cause, or are contained in it, are left out: `exchange` chooses among them.
        """
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
