"""Tests whether an effect of the catalogue explains the structure that remains after a search.

The search adds a cause only if the fitted flights show it. The residual analysis also tests the held-out
flights, and may find structure that only these show. Before the verdict is ``unexplained``, all effects are
therefore tested on fitted and held-out flights together.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from heli_sim.model.effects.spec import EffectSpec

from heli_lab.explain import thresholds
from heli_lab.explain.evaluate.assessment import Assessment, assess
from heli_lab.explain.search.acceptance import Acceptance, min_margin
from heli_lab.explain.search.candidate import ScoredCandidate, may_join
from heli_lab.explain.search.hypothesis import Alternative, Cause
from heli_lab.explain.search.model_comparison import ModelComparison
from heli_lab.explain.search.replication import held_out_screening
from heli_lab.explain.search.score_test import score_of
from heli_lab.explain.search.screening import Screening, coefficient_std
from heli_lab.explain.search.stepwise import Search


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
    """Add one more listed effect to a search if it explains what would otherwise be `unexplained`."""
    if assessment.verdict.label == "unexplained" and not assessment.verdict.unlisted:
        wider = with_remainder(comparison, search, tried)
        if wider is not None:
            explained = assess(comparison, wider, kinds)
            if explained.verdict.label != "unexplained":
                return wider, explained
    return search, assessment


def with_remainder(
    comparison: ModelComparison, search: Search, kinds: Mapping[str, EffectSpec]
) -> Search | None:
    """Add the listed effect that explains best what remains on all flights."""
    if not comparison.can_test_held_out:
        return None
    final, acceptance = search.final, Acceptance(comparison, kinds)
    screenings = [search.screening, held_out_screening(comparison, final)]
    ranked = _on_all_flights(screenings, acceptance, final.ids)
    for screening in screenings:
        screening.release()
    best = ranked[0] if ranked else None
    if best is None or best.margin <= min_margin(best.scored.candidate.id, final.ids):
        return None
    candidate = best.scored.candidate
    start = candidate.start_values(best.scored.coefficients)
    refit = comparison.refit([*final.candidates, candidate], start, final)
    held_out = (
        comparison.held_out_estimate(refit).log_likelihood
        - comparison.held_out_estimate(final).log_likelihood
    )
    cause = Cause(
        next(other for other in refit.candidates if other.id == candidate.id),
        train=refit.log_likelihood - final.log_likelihood,
        held_out=held_out,
        penalty=acceptance.penalty(candidate),
        alternatives=tuple(
            Alternative(other.scored.candidate.id, best.margin - other.margin)
            for other in ranked[1 : 1 + thresholds.ALTERNATIVES]
        ),
    )
    return replace(search, final=refit, causes=(*search.causes, cause), screening=Screening(refit.estimate))


def _on_all_flights(
    screenings: Sequence[Screening], acceptance: Acceptance, present_ids: Sequence[str]
) -> list[_JointScore]:
    """Score listed effects that may join the causes with one coefficient for all flights, the best first.

    An effect at a moment is left out, because its moment belongs to one flight.
    """
    kinds = acceptance.kinds
    compatible = [kind for kind in kinds.values() if may_join(kind.id, present_ids, kinds)]
    scored = [
        candidate
        for candidate in screenings[0].effects(compatible)
        if candidate.candidate.id not in present_ids and not candidate.candidate.effect.moment
    ]
    candidates = [candidate.candidate for candidate in scored]
    statistics = [screening.statistics(candidates) for screening in screenings]
    ranked = []
    for candidate, *by_screening in zip(scored, *statistics, strict=True):
        information = np.sum([of_set.information for of_set in by_screening], axis=0)
        score = np.sum([of_set.score for of_set in by_screening], axis=0)
        joint = score_of(information, score, coefficient_std(candidate.candidate))
        margin = joint.log_likelihood_gain - acceptance.penalty(candidate.candidate, candidate.tried)
        ranked.append(_JointScore(replace(candidate, coefficients=joint.coefficients), margin))
    return sorted(ranked, key=lambda joint: -joint.margin)
