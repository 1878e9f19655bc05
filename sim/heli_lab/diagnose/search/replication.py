"""Replication of causes: fitted on one side's flights and judged on the other's, in both directions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

from heli_lab.diagnose.search.candidate import Candidate
from heli_lab.diagnose.search.hypothesis import Hypothesis
from heli_lab.diagnose.search.model_comparison import ModelComparison
from heli_lab.estimation import Estimate
from heli_lab.threads import parallel_map

_NO_FLIGHT: Final = "\0"
"""A label that no flight has."""


@dataclass(frozen=True)
class Direction:
    """Causes in one direction: fitted on some flights, judged on others.

    Parameters
    ----------
    comparison : ModelComparison
        Its fitted flights estimate the parameters, its held-out flights judge.
    baseline : Hypothesis
        The model without causes on the fitted flights.
    whole : Hypothesis
        The model with all causes on the fitted flights.
    log_likelihood_ratio : Mapping[str, float]
        Log-likelihood ratio of each cause on the judging flights, nats, by id.
    """

    comparison: ModelComparison
    baseline: Hypothesis
    whole: Hypothesis
    log_likelihood_ratio: Mapping[str, float]


def direction(
    comparison: ModelComparison, final: Hypothesis, near: Estimate, judged_near: Estimate
) -> Direction:
    """Fit a model and the models without each of its causes on the fitted flights of a `comparison`, and
    compare them on its held-out flights.

    Nothing is searched: the fits start from estimates that exist.

    Parameters
    ----------
    final : Hypothesis
        The model, perhaps estimated on other flights.
    near, judged_near : Estimate
        Estimates of constants and disturbances of the fitted and of the held-out flights.
    """
    candidates = with_fixed_moments(final)
    baseline = comparison.filtering_baseline
    with_all = _fitted(comparison, candidates, final.estimate, near)
    likelihood = comparison.held_out_estimate(with_all, judged_near).log_likelihood

    def ratio(candidate: Candidate) -> float:
        rest = tuple(other for other in candidates if other is not candidate)
        less = _fitted(comparison, rest, with_all.estimate, with_all.estimate) if rest else baseline
        return likelihood - comparison.held_out_estimate(less, judged_near).log_likelihood

    ratios = parallel_map(ratio, candidates)
    ids = (candidate.id for candidate in candidates)
    return Direction(comparison, baseline, with_all, dict(zip(ids, ratios, strict=True)))


def _fitted(
    comparison: ModelComparison, candidates: tuple[Candidate, ...], shared: Estimate, near: Estimate
) -> Hypothesis:
    """Fit from what all flights of the estimate `shared` share, and the other numbers of `near`."""
    start = near.parameter_vector.by_name(near.theta)
    start |= shared.parameter_vector.shared_by_name(shared.theta)
    return comparison.refit_from(candidates, start, near.disturbances)


def with_fixed_moments(hypothesis: Hypothesis) -> tuple[Candidate, ...]:
    """Candidates of a model whose moments are fixed in every flight: no other flight estimates when an event
    happened.
    """

    def fixed(candidate: Candidate) -> Candidate:
        effect = candidate.effect
        if not effect.flight:
            return candidate
        moments_s = {**effect.other_moments_s, effect.flight: hypothesis.values[effect.moment]}
        return replace(candidate, effect=replace(effect, flight=_NO_FLIGHT, other_moments_s=moments_s))

    return tuple(map(fixed, hypothesis.candidates))
