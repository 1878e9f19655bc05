"""Finds when an event of the fitted flights, such as a slipping counterweight, happens in held-out flights.

An event of one flight may be absent from another flight, or happen there at another time.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

from heli_lab.explain.search.candidate import Candidate
from heli_lab.explain.search.hypothesis import Hypothesis
from heli_lab.explain.search.model_comparison import ModelComparison, event_is_inside
from heli_lab.explain.thresholds import EVENT_STD_ERRORS, MIN_MARGIN
from heli_lab.fit.estimator import Estimate
from heli_lab.fit.innovations import auxiliary_residuals
from heli_lab.fit.linearised_flight import BLOCK_s
from heli_lab.fit.records import Record

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
        moments_s = [hypothesis.values[effect.moment], *self._suggested_s(without_event)]
        moments_s = [moment_s for moment_s in moments_s if event_is_inside(self.record, moment_s)]
        if not moments_s:
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
        """Return the instant at which a torque most significantly changes for good [s]; empty without one.

        The significance is the auxiliary residual of a level.
        """
        flight = self.comparison.held_out.index(self.record)
        residuals = auxiliary_residuals(without_event.filtered(), without_event.disturbances)[flight]
        level_s, statistic = residuals.largest_level()
        return [level_s] if statistic > EVENT_STD_ERRORS else []

    def _refined_s(self, hypothesis: Hypothesis, log_likelihood: float, moment_s: float) -> float:
        """Return a more likely moment close to `moment_s`, which has the given `log_likelihood` [s].

        This is the vertex of a parabola through the log-likelihoods at three moments, at most `_STEP_s` away.
        """
        before = self._log_likelihood(hypothesis, moment_s - _STEP_s)
        after = self._log_likelihood(hypothesis, moment_s + _STEP_s)
        curvature = before - 2.0 * log_likelihood + after
        if curvature >= 0.0:
            return moment_s
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
