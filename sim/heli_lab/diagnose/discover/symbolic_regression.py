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
from typing import Final

import numpy as np
from heli_sim.model.effects import EffectSpec

from heli_lab.diagnose.discover.discovery import Discovery, Rival
from heli_lab.diagnose.discover.equation import NAME, Equation, Group
from heli_lab.diagnose.discover.equation_refit import EquationRefits, RefittedEquation
from heli_lab.diagnose.discover.grammar import groups, tried_up_to
from heli_lab.diagnose.discover.listed_effects import ListedEffects
from heli_lab.diagnose.discover.scoring import ScoredGroup, TermSignals, score
from heli_lab.diagnose.search import Hypothesis, ModelComparison, Screening
from heli_lab.diagnose.thresholds import (
    ALTERNATIVES,
    EQUATION_FINALISTS,
    EQUATION_MAX_TERMS,
    EQUATION_MIN_SPLINE_SHARE,
    EXPECTED_REFIT_GAIN,
    MIN_MARGIN,
    SHORTLIST_SHARE,
)
from heli_lab.estimation import DisturbanceModel

_NO_DRIFT_Nm: Final = 2e-5
"""Practically zero; covariances stay regular."""


@dataclass
class EquationSearch:
    """Forward selection of the terms of an equation: each round adds the group of terms of largest margin.

    Parameters
    ----------
    refits : EquationRefits
        Refits equations, and knows their penalties.
    say : callable
        Called with the present step in words.
    rivals : dict of str to float
        Terms that were not accepted: log-likelihood ratio of the accepted term over each, penalties included,
        nats.
    """

    refits: EquationRefits
    say: Callable[[str], None]
    rivals: dict[str, float] = field(default_factory=dict)

    def round(
        self, known: RefittedEquation | None, disturbances: DisturbanceModel
    ) -> RefittedEquation | None:
        """Add one more group of terms.

        Parameters
        ----------
        known : RefittedEquation or None
            The equation so far; None for the first group.
        disturbances : DisturbanceModel
            Disturbances for the score tests.

        Returns
        -------
        RefittedEquation or None
            The extended equation; None if no group exceeds its penalty.
        """
        warm_start = known.hypothesis if known else self.refits.base
        screening = Screening(replace(warm_start.estimate, disturbances=disturbances))
        signals = TermSignals(screening)
        all_groups = groups(signals.spans)
        self.refits.tried = tried_up_to(all_groups)
        scored: dict[str, ScoredGroup] = {}
        for scored_group in (
            *self.slow_finalists(warm_start, disturbances, signals, all_groups),
            *self.finalists(score(screening, signals, all_groups)),
        ):
            scored.setdefault(scored_group.group.key, scored_group)
        likely = [
            (scored_group, equation)
            for scored_group in scored.values()
            if (equation := extended_equation(scored_group, known)) is not None
        ]
        best = self._best(likely, known, warm_start, signals)
        return None if best is None else self.refits.simplified(best, signals)

    def _best(
        self,
        likely: Sequence[tuple[ScoredGroup, Equation]],
        known: RefittedEquation | None,
        warm_start: Hypothesis,
        signals: TermSignals,
    ) -> RefittedEquation | None:
        """Refit the `likely` groups in turn, and choose the refit of the largest margin.

        Parameters
        ----------
        likely : sequence of (ScoredGroup, Equation)
            Groups in the order of their scores, each with the equation that it extends.
        known, warm_start
            The equation so far, and the model with it.
        signals : TermSignals
            Values of all terms along the flights.

        Returns
        -------
        RefittedEquation or None
            None if no margin exceeds that of the equation so far by `MIN_MARGIN`.
        """
        best: RefittedEquation | None = None
        rivals = dict[str, float]()
        # Refits that gain about what their score has promised.
        promising = 0
        known_penalty = known.penalty if known else 0.0
        for scored_group, equation in likely:
            if promising >= EQUATION_FINALISTS:
                break
            self.say(f"trying {scored_group.group.key}")
            refitted = self.refits.refit_extended(scored_group, equation, known, signals)
            gain = refitted.hypothesis.log_likelihood - warm_start.log_likelihood
            promising += gain >= SHORTLIST_SHARE * scored_group.log_likelihood_gain
            rivals[scored_group.group.key] = gain - (refitted.penalty - known_penalty)
            if best is None or refitted.margin > best.margin:
                best = refitted
        if best is None or best.margin - (warm_start.log_likelihood - known_penalty) <= MIN_MARGIN:
            return None
        chosen = rivals.pop(best.group.key)
        self.rivals |= {key: chosen - margin for key, margin in rivals.items()}
        return best

    def slow_finalists(
        self,
        warm_start: Hypothesis,
        disturbances: DisturbanceModel,
        signals: TermSignals,
        every: Sequence[Group],
    ) -> list[ScoredGroup]:
        """Score terms without slow disturbances: next to a slow disturbance of its own size, a term of slow
        quantities such as travel has hardly any score.

        Parameters
        ----------
        warm_start : Hypothesis
            The model so far.
        disturbances : DisturbanceModel
            Its disturbances; if about no axis the slow part is larger than the fast one, nothing is scored.
        signals : TermSignals
            Values of all terms along the flights.
        every : sequence of Group
            All groups; those on encoders are not scored.
        """
        drifts = disturbances.slow_std > disturbances.fast_std
        if not drifts.any():
            return []
        without_drift = replace(
            disturbances, slow_std=np.where(drifts, _NO_DRIFT_Nm, disturbances.slow_std), curvature=None
        )
        acting = [group for group in every if not group.terms[0].channel.startswith("measurement")]
        scored = score(Screening(replace(warm_start.estimate, disturbances=without_drift)), signals, acting)
        return self.finalists(scored)[:ALTERNATIVES]

    def finalists(self, scored: Sequence[ScoredGroup]) -> list[ScoredGroup]:
        """Choose the groups of the largest score less penalty: twice `EQUATION_FINALISTS`, because not every
        score is confirmed, and at most `ALTERNATIVES` of the same channel and quantities.
        """

        def penalty(scored_group: ScoredGroup) -> float:
            return self.refits.penalty(scored_group.group, Equation(scored_group.group.terms), frozenset())

        def worth(scored_group: ScoredGroup) -> float:
            return scored_group.log_likelihood_gain - penalty(scored_group)

        chosen: list[ScoredGroup] = []
        for scored_group in sorted(scored, key=worth, reverse=True):
            gain = scored_group.log_likelihood_gain
            paid = gain - worth(scored_group)
            if EXPECTED_REFIT_GAIN * gain <= paid + MIN_MARGIN or len(chosen) >= 2 * EQUATION_FINALISTS:
                continue
            like = [other for other in chosen if _place(other.group) == _place(scored_group.group)]
            if len(like) < ALTERNATIVES:
                chosen.append(scored_group)
        return chosen


def extended_equation(scored: ScoredGroup, known: RefittedEquation | None) -> Equation | None:
    """Append the terms of the group `scored` to the equation `known` so far; None if a term would occur
    twice.
    """
    terms = (*(known.equation.terms if known else ()), *scored.group.terms)
    return Equation(terms) if len(set(terms)) == len(terms) else None


def free_name(used: Collection[str]) -> str:
    """Choose a name for the effect that an equation becomes; the names `used` belong to other effects."""
    names = itertools.chain((NAME,), (f"{NAME}_{number}" for number in itertools.count(2)))
    return next(name for name in names if name not in used)


def discover(
    comparison: ModelComparison,
    base: Hypothesis,
    *,
    curve: Hypothesis | None = None,
    kinds: Mapping[str, EffectSpec] | None = None,
    refits: float = math.inf,
    say: Callable[[str], None] | None = None,
) -> Discovery | None:
    """Search for an equation of what a model lacks.

    Parameters
    ----------
    comparison : ModelComparison
        The flights; those held out confirm the equation.
    base : Hypothesis
        The model with the causes that were named.
    curve : Hypothesis, optional
        The same model with spline terms in the place of what is missing: the score tests use its
        disturbances, and its log-likelihood shows how much there is to explain.
    kinds : Mapping[str, EffectSpec], optional
        Catalogue by effect id: an equation that one of its effects fits equally well is dropped.
    refits : float
        Refits after which no further term is tried.
    say : callable, optional
        Called with the present step in words.

    Returns
    -------
    Discovery or None
        None if no equation exceeds its penalty, explains most of what spline terms do, is confirmed by the
        held-out flights, and fits better than the effects of the catalogue.
    """
    # An equation that was proposed earlier may be in the rig or among the causes, from its effect file.
    name = free_name({*base.ids, *(effect.name for effect in comparison.model.effects)})
    search = EquationSearch(EquationRefits(comparison, base, name), say or (lambda _step: None))
    disturbances = (curve or base).estimate.disturbances
    known: RefittedEquation | None = None
    confirmed: tuple[RefittedEquation, float | None, dict[str, float]] | None = None
    without = comparison.held_out_estimate(base) if comparison.held_out else None
    before = 0.0
    while comparison.fits < refits and (known is None or len(known.equation.terms) < EQUATION_MAX_TERMS):
        result = search.round(
            known, disturbances if known is None else known.hypothesis.estimate.disturbances
        )
        if result is None or (known is not None and len(result.equation.terms) <= len(known.equation.terms)):
            break
        held_out = None
        if without is not None:
            with_equation = comparison.held_out_estimate(result.hypothesis)
            held_out = with_equation.log_likelihood - without.log_likelihood
            # Flights that had no part in its choice must confirm each term.
            if held_out - before < MIN_MARGIN:
                break
            before = held_out
        known, confirmed = result, (result, held_out, dict(search.rivals))
    if confirmed is None:
        return None
    equation, held_out, others = confirmed
    gained = equation.hypothesis.log_likelihood - base.log_likelihood
    by_curve = curve.log_likelihood - base.log_likelihood if curve is not None and curve is not base else None
    if by_curve is not None and gained < EQUATION_MIN_SPLINE_SHARE * by_curve:
        return None
    listed = ListedEffects(comparison, base, kinds or {}, search.say)
    if listed.equivalent_effect(equation.equation, equation.hypothesis, equation.penalty) is not None:
        return None
    hypothesis, superfluous = listed.without_superfluous(equation.hypothesis)
    rivals = sorted((Rival(*item) for item in others.items()), key=lambda item: item.log_likelihood_ratio)
    return Discovery(
        equation.equation,
        base,
        hypothesis,
        equation.penalty,
        held_out,
        by_curve,
        tuple(rivals),
        max(search.refits.tried.values()),
        superfluous,
        None if without is None else (without, comparison.held_out_estimate(hypothesis)),
    )


def _place(group: Group) -> tuple[str, frozenset[str]]:
    """Channel and quantities of a group. All encoders count as one: an error of scale of one of them shifts
    the filtered states of all.
    """
    channel = group.terms[0].channel
    if channel.startswith("measurement"):
        return "measurement", frozenset()
    return channel, frozenset(q for term in group.terms for q in term.term.quantities)
