"""Whether the thrust varies at random: a wandering supply, or the wash of the rotors."""

from __future__ import annotations

import math

from heli_lab.diagnose.evaluate.assessment import Assessment, without_splines
from heli_lab.diagnose.search import Hypothesis, ModelComparison, Search
from heli_lab.diagnose.thresholds import MIN_MARGIN
from heli_lab.identify.rotor_gains import GAINS

_NUMBERS = 2 * len(GAINS)
"""Numbers of a thrust that varies: standard deviation and correlation time of each gain."""


def justified_thrust_noise(
    comparison: ModelComparison, search: Search, assessment: Assessment
) -> ModelComparison | None:
    """Return the comparison with a thrust that varies at random, if that is needed and justified.

    It is needed if the verdict is ``unexplained``. It is justified if it adds more to the log-likelihood of
    all flights than its BIC penalty, and more than the predictors and splines that it is to replace.

    Parameters
    ----------
    comparison : ModelComparison
        The flights, with torques as the only disturbances.
    search, assessment : Search, Assessment
        Result with these disturbances.
    """
    if assessment.verdict.label != "unexplained":
        return None
    named = without_splines(comparison, search)
    noisy = comparison.with_thrust_noise()
    gained = _log_likelihood(noisy, noisy.refit_with_thrust_noise(named)) - _log_likelihood(comparison, named)
    penalty = 0.5 * _NUMBERS * math.log(comparison.rows) + MIN_MARGIN
    replaced = 0.0
    if search.final is not named:
        replaced = _log_likelihood(comparison, search.final) - _log_likelihood(comparison, named)
    dependences = assessment.residual_analysis.dependences
    replaced += max((dependence.log_likelihood_gain for dependence in dependences), default=0.0)
    return noisy if gained > max(penalty, replaced) else None


def _log_likelihood(comparison: ModelComparison, hypothesis: Hypothesis) -> float:
    """Log-likelihood of the fitted and the held-out flights, nats."""
    total = hypothesis.log_likelihood
    if comparison.held_out:
        total += comparison.held_out_estimate(hypothesis).log_likelihood
    return total
