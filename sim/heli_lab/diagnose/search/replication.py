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
    comparison: ModelComparison, final: Hypothesis, fitted_start: Estimate, held_out_start: Estimate
) -> Direction:
    """Fit a model and the models without each of its causes on the fitted flights of a `comparison`, and
    compare them on its held-out flights.

    Nothing is searched: the fits start from estimates that exist.

    Parameters
    ----------
    final : Hypothesis
        The model, perhaps estimated on other flights.
    fitted_start, held_out_start : Estimate
        Estimates of the fitted and of the held-out flights, whose constants and disturbances to start from.
    """
    candidates = with_fixed_moments(final)
    baseline = comparison.filtering_baseline
    whole = _refit(comparison, candidates, final.estimate, fitted_start)
    likelihood = comparison.held_out_estimate(whole, held_out_start).log_likelihood

    def ratio(candidate: Candidate) -> float:
        other_causes = tuple(other for other in candidates if other is not candidate)
        reduced = baseline
        if other_causes:
            reduced = _refit(comparison, other_causes, whole.estimate, whole.estimate)
        return likelihood - comparison.held_out_estimate(reduced, held_out_start).log_likelihood

    ratios = parallel_map(ratio, candidates)
    ids = (candidate.id for candidate in candidates)
    return Direction(comparison, baseline, whole, dict(zip(ids, ratios, strict=True)))


def _refit(
    comparison: ModelComparison, candidates: tuple[Candidate, ...], shared: Estimate, fitted_start: Estimate
) -> Hypothesis:
    """Refit a model with some candidates on the fitted flights.

    The start has the parameters that all flights share from `shared`, the others from `fitted_start`.
    """
    start = fitted_start.parameter_vector.by_name(fitted_start.theta)
    start |= shared.parameter_vector.shared_by_name(shared.theta)
    return comparison.refit_from(candidates, start, fitted_start.disturbances)


def with_fixed_moments(hypothesis: Hypothesis) -> tuple[Candidate, ...]:
    """Return the candidates of a model with the moment of each event fixed, so that no other flight
    estimates it.
    """

    def fixed(candidate: Candidate) -> Candidate:
        effect = candidate.effect
        if not effect.flight:
            return candidate
        moments_s = {**effect.other_moments_s, effect.flight: hypothesis.values[effect.moment]}
        return replace(candidate, effect=replace(effect, flight=_NO_FLIGHT, other_moments_s=moments_s))

    return tuple(map(fixed, hypothesis.candidates))
