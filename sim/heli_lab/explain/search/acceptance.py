"""Statistics of a search: what a candidate must gain, and when its size is significant."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from heli_sim.model.effects.spec import EffectSpec

from heli_lab.explain import thresholds
from heli_lab.explain.search.candidate import Candidate, ScoredCandidate
from heli_lab.explain.search.hypothesis import Hypothesis, Refit
from heli_lab.explain.search.model_comparison import ModelComparison
from heli_lab.explain.search.resolution import limited_std
from heli_lab.fit.records import Record

_NEUTRAL_SHARE: Final = 0.01
"""Share of its typical size below which an effect counts as absent: sizes at their bounds are ten times
smaller. Higher: small causes are lost. Lower: a better estimate of the other parameters is taken for a cause,
such as a play of 0.000 degrees that gained 289 nats (2026-11)."""


@dataclass(frozen=True)
class Acceptance:
    """Decides whether a refitted candidate belongs into the model.

    A candidate is accepted if its log-likelihood ratio exceeds its penalty by `min_margin`, its size is
    significant, and the moment at which it acts, if it has one, is within the free flight.
    """

    comparison: ModelComparison
    kinds: Mapping[str, EffectSpec]

    def penalty(self, candidate: Candidate, grid_points: int = 0) -> float:
        """Return the complexity penalty of a `candidate`, nats: BIC for its parameters, and the logarithm of
        the number of tests.

        The tests are one per candidate of the catalogue, and `grid_points` of the candidate's grid.
        """
        free_count = len(set(candidate.effect.priors) | set(candidate.grid))
        coefficient_weight = thresholds.SPLINE_COEFFICIENT_WEIGHT if candidate.is_spline else 1.0
        tests = thresholds.CANDIDATES_TRIED + grid_points
        return 0.5 * coefficient_weight * free_count * math.log(self.comparison.rows) + math.log(tests)

    def accepts(self, refit: Refit) -> bool:
        """Whether a refitted candidate may be added to the model."""
        if refit.margin <= min_margin(refit.candidate.id, refit.hypothesis.ids):
            return False
        if refit.candidate.is_spline:
            return True
        return self.comparison.in_flight(refit.hypothesis) and self.is_significant(refit, refit.candidate)

    def is_significant(self, refit: Refit, candidate: Candidate) -> bool:
        """Whether the size of a candidate of `refit` differs from zero: by its standard error (Wald test),
        or, where a likelihood is one-sided and the Wald test fails, by the log-likelihood ratio.
        """
        if candidate.is_spline:
            return True
        if refit.margin > thresholds.WALD_OVERRIDE_NATS:
            return not is_neutral(refit.hypothesis, candidate, self.kinds)
        return is_significant(refit.hypothesis, candidate, self.kinds, self.comparison.train[0])

    def resolves(self, hypothesis: Hypothesis, kind: EffectSpec) -> bool:
        """Whether the flights resolve each size of an effect of a model, `is_resolved`."""
        return is_resolved(hypothesis, kind, self.comparison.train[0])

    def worth_a_refit(self, screened: Sequence[ScoredCandidate]) -> list[ScoredCandidate]:
        """Candidates whose score leaves a chance that a refit is accepted, in their order."""
        return [
            scored
            for scored in screened
            if thresholds.EXPECTED_REFIT_GAIN * scored.log_likelihood_gain
            > self.penalty(scored.candidate, scored.tried) + thresholds.MIN_MARGIN
        ]


def min_margin(id_: str, present: Collection[str]) -> float:
    """Return the log-likelihood ratio by which an effect must exceed its penalty, nats."""
    family, _, axis = id_.partition(".")
    if family == "backlash" and f"coulomb_friction.{axis}" in present:
        return thresholds.PLAY_NEXT_TO_FRICTION_NATS
    return thresholds.MIN_MARGIN


def is_significant(
    hypothesis: Hypothesis, candidate: Candidate, kinds: Mapping[str, EffectSpec], record: Record
) -> bool:
    """Whether a size of an effect differs from its neutral value by two standard errors (Wald test)."""
    kind = kinds.get(candidate.id)
    if kind is None:
        return True
    are_significant = _significant_sizes(hypothesis, kind, record)
    return not are_significant or any(are_significant)


def is_resolved(hypothesis: Hypothesis, kind: EffectSpec, record: Record) -> bool:
    """Whether each size of an effect differs from its neutral value by two standard errors."""
    return all(_significant_sizes(hypothesis, kind, record))


def _significant_sizes(hypothesis: Hypothesis, kind: EffectSpec, record: Record) -> list[bool]:
    """Return for each free size of an effect whether it differs from its neutral value by two of its
    `limited_std`.
    """
    values, neutral = hypothesis.values, kind.neutral
    std = limited_std(kind, values, hypothesis.std, record)
    return [
        abs(values[size] - neutral[size]) > thresholds.SIGNIFICANT_STD_ERRORS * std[size]
        for size in kind.size
        if size in values
    ]


def is_neutral(hypothesis: Hypothesis, candidate: Candidate, kinds: Mapping[str, EffectSpec]) -> bool:
    """Whether all sizes of an effect ended at their neutral values.

    A gain of such a refit comes from better estimates of the other parameters.
    """
    kind = kinds.get(candidate.id)
    if kind is None:
        return False
    values, neutral, typical = hypothesis.values, kind.neutral, kind.typical
    free_sizes = [size for size in kind.size if size in values]
    return bool(free_sizes) and all(
        abs(values[size] - neutral[size]) < _NEUTRAL_SHARE * abs(typical[size]) for size in free_sizes
    )
