"""Symbolic regression of what a model lacks: forward selection of terms, refits, confirmation on other
flights.

Terms are scored as regressors of the innovations, and the best are refitted in innovations form together
with the disturbances. A term is accepted if its log-likelihood ratio exceeds its penalty: BIC for its
parameters, and the logarithm of the number of terms of its size and smaller that were tried. Then the next
round begins. Held-out flights do not choose terms; an equation that they do not confirm is dropped.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

import numpy as np
from heli_sim.model.effects import EffectSpec

from heli_lab.explain.discover.discovery import Discovery, Rival
from heli_lab.explain.discover.equation import NAME, Equation, TermGroup
from heli_lab.explain.discover.equation_refit import EquationRefits, RefittedEquation
from heli_lab.explain.discover.grammar import count_by_complexity, groups
from heli_lab.explain.discover.listed_effects import ListedEffects
from heli_lab.explain.discover.scoring import ScoredTermGroup, TermSignals, score
from heli_lab.explain.search.hypothesis import Hypothesis
from heli_lab.explain.search.model_comparison import ModelComparison
from heli_lab.explain.search.screening import Screening
from heli_lab.explain.thresholds import (
    ALTERNATIVES,
    EQUATION_FINALISTS,
    EQUATION_MAX_TERMS,
    EQUATION_MIN_SPLINE_SHARE,
    EXPECTED_REFIT_GAIN,
    MIN_MARGIN,
    SHORTLIST_SHARE,
)
from heli_lab.fit.estimator import Estimate
from heli_lab.fit.grey_box import DisturbanceModel

_NO_DRIFT_Nm: Final = 2e-5
"""Practically zero; covariances stay regular."""


@dataclass
class EquationSearch:
    """Forward selection of the terms of an equation: each round adds the group of terms of largest margin."""

    refits: EquationRefits  # Refits equations, and knows their penalties
    say: Callable[[str], None]  # Called with the present step in words
    rivals: dict[str, float] = field(default_factory=dict)
    """Terms that were not accepted: log-likelihood ratio of the accepted term over each, penalties included,
    nats."""

    def round(
        self, current: RefittedEquation | None, disturbances: DisturbanceModel
    ) -> RefittedEquation | None:
        """Add one more group of terms."""
        warm_start = current.hypothesis if current else self.refits.base
        screening = Screening(replace(warm_start.estimate, disturbances=disturbances))
        signals = TermSignals(screening)
        all_groups = groups(signals.spans)
        self.refits.tried = count_by_complexity(all_groups)
        finalists: dict[str, ScoredTermGroup] = {}
        for scored_group in (
            *self.slow_finalists(warm_start, disturbances, signals, all_groups),
            *self.finalists(score(screening, signals, all_groups)),
        ):
            finalists.setdefault(scored_group.group.key, scored_group)
        best = self._best_refit(list(finalists.values()), current, warm_start, signals)
        return None if best is None else self.refits.simplified(best, signals)

    def _best_refit(
        self,
        finalists: Sequence[ScoredTermGroup],
        current: RefittedEquation | None,
        warm_start: Hypothesis,
        signals: TermSignals,
    ) -> RefittedEquation | None:
        """Refit the current equation with each finalist; return the refit of the largest margin.

        The result is None if its margin does not exceed that of the current equation by `MIN_MARGIN`. The
        lead over each other finalist is stored in `rivals`.
        """
        best: RefittedEquation | None = None
        margin_by_group = dict[str, float]()
        confirmed_scores = 0
        current_penalty = current.penalty if current else 0.0
        for scored_group in finalists:
            equation = extended_equation(scored_group, current)
            if equation is None:
                continue
            if confirmed_scores >= EQUATION_FINALISTS:
                break
            self.say(f"trying {scored_group.group.key}")
            refit = self.refits.refit_extended(scored_group, equation, current, signals)
            gain = refit.hypothesis.log_likelihood - warm_start.log_likelihood
            if gain >= SHORTLIST_SHARE * scored_group.log_likelihood_gain:
                confirmed_scores += 1
            margin_by_group[scored_group.group.key] = gain - (refit.penalty - current_penalty)
            if best is None or refit.margin > best.margin:
                best = refit
        if best is None or best.margin - (warm_start.log_likelihood - current_penalty) <= MIN_MARGIN:
            return None
        best_margin = margin_by_group.pop(best.group.key)
        self.rivals |= {key: best_margin - margin for key, margin in margin_by_group.items()}
        return best

    def slow_finalists(
        self,
        warm_start: Hypothesis,
        disturbances: DisturbanceModel,
        signals: TermSignals,
        all_groups: Sequence[TermGroup],
    ) -> list[ScoredTermGroup]:
        """Score terms without slow disturbances, and choose the best.

        A slow disturbance of its size explains a term of slow quantities such as travel, so that the term has
        hardly any score.
        """
        is_slow = disturbances.slow_std > disturbances.fast_std
        if not is_slow.any():
            return []
        disturbances_without_drift = replace(
            disturbances, slow_std=np.where(is_slow, _NO_DRIFT_Nm, disturbances.slow_std), curvature=None
        )
        dynamic_groups = [
            group for group in all_groups if not group.terms[0].channel.startswith("measurement")
        ]
        scores = score(
            Screening(replace(warm_start.estimate, disturbances=disturbances_without_drift)),
            signals,
            dynamic_groups,
        )
        return self.finalists(scores)[:ALTERNATIVES]

    def finalists(self, scored: Sequence[ScoredTermGroup]) -> list[ScoredTermGroup]:
        """Choose the groups of terms with the largest score less penalty, which are refitted.

        The number is twice `EQUATION_FINALISTS`, because not every score is confirmed. At most `ALTERNATIVES`
        groups have the same channel and quantities.
        """

        def penalty(scored_group: ScoredTermGroup) -> float:
            """Return the penalty of a group as an equation of its own, nats."""
            return self.refits.penalty(scored_group.group, Equation(scored_group.group.terms), frozenset())

        def net_gain(scored_group: ScoredTermGroup) -> float:
            """Return the score less the penalty, nats."""
            return scored_group.log_likelihood_gain - penalty(scored_group)

        finalists: list[ScoredTermGroup] = []
        for scored_group in sorted(scored, key=net_gain, reverse=True):
            expected_gain = EXPECTED_REFIT_GAIN * scored_group.log_likelihood_gain
            if (
                expected_gain <= penalty(scored_group) + MIN_MARGIN
                or len(finalists) >= 2 * EQUATION_FINALISTS
            ):
                continue
            family = _channel_and_quantities(scored_group.group)
            if sum(_channel_and_quantities(other.group) == family for other in finalists) < ALTERNATIVES:
                finalists.append(scored_group)
        return finalists


def extended_equation(scored: ScoredTermGroup, current: RefittedEquation | None) -> Equation | None:
    """Append the terms of the group `scored` to the `current` equation; None if a term would occur twice."""
    terms = (*(current.equation.terms if current else ()), *scored.group.terms)
    return Equation(terms) if len(set(terms)) == len(terms) else None


def free_name(used: Collection[str]) -> str:
    """Choose a name for the effect that an equation becomes; the names `used` belong to other effects."""
    names = itertools.chain((NAME,), (f"{NAME}_{number}" for number in itertools.count(2)))
    return next(name for name in names if name not in used)


class _ConfirmedEquation(NamedTuple):
    """An equation whose last term the held-out flights confirmed.

    `held_out` is its log-likelihood ratio there, nats, None without such flights. `rivals` are the leads over
    other terms, nats, by key.
    """

    refitted: RefittedEquation
    held_out: float | None
    rivals: dict[str, float]


def _select_terms(
    search: EquationSearch, disturbances: DisturbanceModel, without: Estimate | None, max_refits: float
) -> _ConfirmedEquation | None:
    """Add groups of terms until none exceeds its penalty or is confirmed by the held-out flights."""
    comparison = search.refits.comparison
    confirmed: _ConfirmedEquation | None = None
    previous_held_out = 0.0
    while comparison.fits < max_refits:
        current = confirmed.refitted if confirmed is not None else None
        term_count = len(current.equation.terms) if current is not None else 0
        if term_count >= EQUATION_MAX_TERMS:
            break
        if current is not None:
            disturbances = current.hypothesis.estimate.disturbances
        result = search.round(current, disturbances)
        if result is None or len(result.equation.terms) <= term_count:
            break
        held_out = None
        if without is not None:
            with_equation = comparison.held_out_estimate(result.hypothesis)
            held_out = with_equation.log_likelihood - without.log_likelihood
            # Flights that had no part in its choice must confirm each term.
            if held_out - previous_held_out < MIN_MARGIN:
                break
            previous_held_out = held_out
        confirmed = _ConfirmedEquation(result, held_out, dict(search.rivals))
    return confirmed


def discover(
    comparison: ModelComparison,
    base: Hypothesis,
    *,
    curve: Hypothesis | None = None,
    kinds: Mapping[str, EffectSpec] | None = None,
    refits: float = math.inf,
    say: Callable[[str], None] | None = None,
) -> Discovery | None:
    """Search for an equation of what a model lacks."""
    # An equation that was proposed earlier may be in the rig or among the causes, from its effect file.
    name = free_name({*base.ids, *(effect.name for effect in comparison.model.effects)})
    search = EquationSearch(EquationRefits(comparison, base, name), say or (lambda _step: None))
    held_out_base = comparison.held_out_estimate(base) if comparison.held_out else None
    confirmed = _select_terms(search, (curve or base).estimate.disturbances, held_out_base, refits)
    if confirmed is None:
        return None
    refitted = confirmed.refitted
    equation_gain = refitted.hypothesis.log_likelihood - base.log_likelihood
    spline_gain = None
    if curve is not None and curve is not base:
        spline_gain = curve.log_likelihood - base.log_likelihood
        if equation_gain < EQUATION_MIN_SPLINE_SHARE * spline_gain:
            return None
    catalogue = ListedEffects(comparison, base, kinds or {}, search.say)
    if catalogue.equivalent_effect(refitted.equation, refitted.hypothesis, refitted.penalty) is not None:
        return None
    hypothesis, superfluous = catalogue.without_superfluous(refitted.hypothesis)
    rivals = [Rival(key, ratio) for key, ratio in confirmed.rivals.items()]
    return Discovery(
        equation=refitted.equation,
        base=base,
        hypothesis=hypothesis,
        penalty=refitted.penalty,
        held_out=confirmed.held_out,
        curve=spline_gain,
        rivals=tuple(sorted(rivals, key=lambda rival: rival.log_likelihood_ratio)),
        tried=max(search.refits.tried.values()),
        superfluous=superfluous,
        elsewhere=None
        if held_out_base is None
        else (held_out_base, comparison.held_out_estimate(hypothesis)),
    )


def _channel_and_quantities(group: TermGroup) -> tuple[str, frozenset[str]]:
    """Return channel and quantities of a group; groups of one family compete with each other.

    All encoders count as one, because a scale error of one of them shifts the filtered states of all.
    """
    channel = group.terms[0].channel
    if channel.startswith("measurement"):
        return "measurement", frozenset()
    return channel, frozenset(q for term in group.terms for q in term.term.quantities)
