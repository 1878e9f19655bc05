"""Whether the thrust varies at random: a wandering supply, or the wash of the rotors."""

from __future__ import annotations

import math

from heli_lab.explain.evaluate.assessment import Assessment, without_splines
from heli_lab.explain.search.hypothesis import Hypothesis
from heli_lab.explain.search.model_comparison import ModelComparison
from heli_lab.explain.search.stepwise import Search
from heli_lab.explain.thresholds import MIN_MARGIN
from heli_lab.fit.flight_model import GAINS

_NUMBERS = 2 * len(GAINS)
"""Numbers of a thrust that varies: standard deviation and correlation time of each gain."""


def justified_thrust_noise(
    comparison: ModelComparison, search: Search, assessment: Assessment
) -> ModelComparison | None:
    """Return the comparison with a thrust that varies at random, if that is needed and justified.

    It is needed if the verdict is ``unexplained``. It is justified if it adds more to the log-likelihood of
    all flights than its BIC penalty, and more than the predictors and splines that it is to replace.
    """
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


def _log_likelihood(comparison: ModelComparison, hypothesis: Hypothesis) -> float:
    """Return the log-likelihood of the fitted and the held-out flights, nats."""
    total = hypothesis.log_likelihood
    if comparison.held_out:
        total += comparison.held_out_estimate(hypothesis).log_likelihood
    return total
