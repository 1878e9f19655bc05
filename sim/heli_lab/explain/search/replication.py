"""Tests whether causes also hold on other flights: parameters are fitted on some flights, and the causes are
compared on others.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from heli_lab.explain.search.candidate import Candidate
from heli_lab.explain.search.hypothesis import Hypothesis
from heli_lab.explain.search.model_comparison import ModelComparison
from heli_lab.explain.search.screening import NormalDistribution, Screening
from heli_lab.fit.estimator import Estimate
from heli_lab.fit.flight_model import RigParameters
from heli_lab.threads import parallel_map

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
    """Compare a model with the models that lack one of its causes each.

    All of them are fitted on the fitted flights of a comparison, and compared on its held-out flights. No
    cause is searched for, and the fits start from existing estimates.
    """
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
    """Score candidates about a `hypothesis` on the held-out flights of a comparison.

    All parameters are free. The prior of those that all flights share is their estimate on the fitted flights
    with its covariance, so that an error which their uncertainty explains is no missing effect.
    """
    fitted, held_out = hypothesis.estimate, comparison.held_out_estimate(hypothesis)
    vector = RigParameters(fitted.parameter_vector.model, comparison.rig, comparison.held_out)
    constants = held_out.parameter_vector.by_name(held_out.theta)
    theta = vector.started_from({**fitted.parameter_vector.shared_by_name(fitted.theta), **constants})
    # Shared parameters come first in both vectors.
    shared = slice(sum(parameter.record is None for parameter in vector.free))
    precision = np.diag(vector.std**-2.0)
    precision[shared, shared] = np.linalg.inv(fitted.covariance[shared, shared])
    mean = vector.mean.copy()
    mean[shared] = theta[shared]
    estimate = replace(held_out, parameter_vector=vector, theta=theta, functions=fitted.functions)
    return Screening(estimate, NormalDistribution(mean, precision))


def _refit(
    comparison: ModelComparison, candidates: tuple[Candidate, ...], shared: Estimate, fitted_start: Estimate
) -> Hypothesis:
    """Refit a model with some candidates on the fitted flights.

    Parameters that all flights share start from the estimate `shared`, all others from `fitted_start`.
    """
    start = fitted_start.parameter_vector.by_name(fitted_start.theta)
    start |= shared.parameter_vector.shared_by_name(shared.theta)
    return comparison.refit_from(candidates, start, fitted_start.disturbances)


def with_fixed_moments(hypothesis: Hypothesis) -> tuple[Candidate, ...]:
    """Return the candidates of a model with the moment of each event fixed at its estimate.

    A fit on other flights could not estimate the moment, because these flights do not contain it.
    """

    def with_fixed_moment(candidate: Candidate) -> Candidate:
        """Return an event that happens at known moments only; other candidates are unchanged."""
        effect = candidate.effect
        if not effect.flight:
            return candidate
        moments_s = {**effect.other_moments_s, effect.flight: hypothesis.values[effect.moment]}
        return replace(candidate, effect=replace(effect, flight=_NO_FLIGHT, other_moments_s=moments_s))

    return tuple(map(with_fixed_moment, hypothesis.candidates))
