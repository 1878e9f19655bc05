"""Moments of effects in held-out flights: what happened in a fitted flight need not happen in another, and
not at the same time.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

from heli_lab.diagnose.search.candidate import Candidate
from heli_lab.diagnose.search.hypothesis import Hypothesis
from heli_lab.diagnose.search.model_comparison import ModelComparison, event_is_inside
from heli_lab.diagnose.thresholds import EVENT_STD_ERRORS, MIN_MARGIN
from heli_lab.estimation import BLOCK_s, Estimate, auxiliary_residuals
from heli_lab.identify import Record

_STEP_s: Final = 0.03
"""Distance of the moments through which a parabola is drawn: the effects' step takes about 20 ms, an interval
of the filter 40 ms."""


def with_held_out_moments(comparison: ModelComparison, hypothesis: Hypothesis) -> Hypothesis:
    """Find out when the effects of a model that have a moment happen in the held-out flights, if they do.

    Parameters
    ----------
    comparison : ModelComparison
        The flights.
    hypothesis : Hypothesis
        The model; its fitted flights keep their estimate.
    """
    for place, candidate in enumerate(hypothesis.candidates):
        if not candidate.effect.flight:
            continue
        for record in comparison.held_out:
            if record.label not in candidate.effect.other_moments_s:
                hypothesis = _Moment(comparison, record, place).sought(hypothesis)
    return hypothesis


class _Moment:
    """Moment of the candidate number `place` of a model in the held-out flight `record`."""

    def __init__(self, comparison: ModelComparison, record: Record, place: int) -> None:
        self.comparison, self.record, self.place = comparison, record, place

    def sought(self, hypothesis: Hypothesis) -> Hypothesis:
        """The model with the moment, if the flight shows it."""
        quiet = self.comparison.held_out_estimate(hypothesis)
        effect = hypothesis.candidates[self.place].effect
        moments_s = [hypothesis.values[effect.moment], *self._suggested_s(quiet)]
        moments_s = [moment_s for moment_s in moments_s if event_is_inside(self.record, moment_s)]
        tried = [self._at(hypothesis, moment_s) for moment_s in moments_s]
        if not tried:
            return hypothesis
        value, moment_s = max(tried, key=lambda pair: pair[0])
        # BIC for one parameter, and one test per instant.
        penalty = 1.5 * math.log(self.record.used_s / BLOCK_s)
        if value - quiet.log_likelihood <= penalty + MIN_MARGIN:
            return hypothesis
        return self._with(hypothesis, self._refined(hypothesis, value, moment_s))

    def _suggested_s(self, quiet: Estimate) -> list[float]:
        """The instant at which the model without the event shows the largest level."""
        number = self.comparison.held_out.index(self.record)
        residuals = auxiliary_residuals(quiet.filtered(), quiet.disturbances)[number]
        level_s, statistic = residuals.largest_level()
        return [level_s] if statistic > EVENT_STD_ERRORS else []

    def _refined(self, hypothesis: Hypothesis, value: float, moment_s: float) -> float:
        """The vertex of a parabola through the log-likelihoods about a moment, at most a step away."""
        before, after = (self._at(hypothesis, moment_s + step_s)[0] for step_s in (-_STEP_s, _STEP_s))
        curvature = before - 2.0 * value + after
        if curvature >= 0.0:
            return moment_s
        vertex = 0.5 * (before - after) / curvature
        return moment_s + _STEP_s * max(-1.0, min(1.0, vertex))

    def _at(self, hypothesis: Hypothesis, moment_s: float) -> tuple[float, float]:
        """Log-likelihood of the held-out flights if it happens at a moment, and that moment."""
        other = self._with(hypothesis, moment_s)
        return self.comparison.held_out_estimate(other).log_likelihood, moment_s

    def _with(self, hypothesis: Hypothesis, moment_s: float) -> Hypothesis:
        """The hypothesis with another moment of the event in this flight."""
        candidates: list[Candidate] = list(hypothesis.candidates)
        candidate = candidates[self.place]
        moments_s = {**candidate.effect.other_moments_s, self.record.label: moment_s}
        effect = replace(candidate.effect, other_moments_s=moments_s)
        candidates[self.place] = replace(candidate, effect=effect)
        return self.comparison.with_effects(hypothesis, candidates)
