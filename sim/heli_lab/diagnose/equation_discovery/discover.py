"""Symbolic regression of what a model lacks: forward selection of terms, refits, confirmation elsewhere.

Terms are scored as regressors of the innovations, the best are refitted in innovations form, weather and
all, and one is taken while its log-likelihood ratio exceeds what it pays: BIC for its numbers and the
logarithm of how many terms of its size and smaller were tried. Then the search starts over beside it. The
flights held out have no part in that; they confirm the law or there is none.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from heli_sim.model.effects import EffectKind

from heli_lab.diagnose.candidate import Candidate
from heli_lab.diagnose.equation_discovery.catalogue import Catalogue
from heli_lab.diagnose.equation_discovery.discovery import Discovery, Rival
from heli_lab.diagnose.equation_discovery.equation import NAME, Equation, equation_effect
from heli_lab.diagnose.equation_discovery.grammar import Group, groups, tried_up_to
from heli_lab.diagnose.equation_discovery.scoring import Courses, ScoredGroup, coefficient_std, score
from heli_lab.diagnose.model_comparison import Hypothesis, ModelComparison
from heli_lab.diagnose.screening import Screening
from heli_lab.diagnose.thresholds import (
    AMBIGUOUS,
    EQUATION_FINALISTS,
    EQUATION_NEAR_REST,
    EXPECTED_REFIT_GAIN,
    LAW_ALIKE,
    LAW_CONFIRMED,
    LAW_CURVE_SHARE,
    LAW_KEPT_SHARE,
    LAW_TERMS,
    MIN_MARGIN,
    NOTHING_STD_ERRORS,
)
from heli_lab.estimation import DisturbanceModel

_NO_DRIFT_Nm: Final = 2e-5
"""As good as none, while covariances stay regular."""
_WHOLE: Final = 2.0
"""Standard errors within which a multiplicity is taken for the whole number beside it."""


@dataclass(frozen=True)
class _Tried:
    equation: Equation
    hypothesis: Hypothesis
    penalty: float
    group: Group
    held: frozenset[str] = frozenset()

    @property
    def margin(self) -> float:
        return self.hypothesis.log_likelihood - self.penalty


class _Discoverer:
    def __init__(self, comparison: ModelComparison, base: Hypothesis, say: Callable[[str], None]) -> None:
        self.comparison, self.base, self.say = comparison, base, say
        # A law that was proposed before may be in the rig or among the causes, from its own effect file.
        self.name = free_name({*base.ids, *(effect.name for effect in comparison.model.effects)})
        self.tried: dict[int, int] = {}
        self.rivals: dict[str, float] = {}

    def penalty(self, group: Group, equation: Equation, held: frozenset[str]) -> float:
        """What a group pays: BIC for its numbers, and for the size of the search."""
        free = len(group.terms) + sum(
            1
            for i, j, inner_name, name, _, _ in equation.inner()
            if name not in held
            and equation.terms[i] in group.terms
            and not (inner_name == "width" and equation.terms[i].term.factors[j].form == "sign")
        )
        rest = sum(EQUATION_NEAR_REST for term in group.terms if _on_own_rate(term.channel, term.term.key))
        return 0.5 * free * math.log(self.comparison.rows) + math.log(self.tried[group.size]) + rest

    def refit(
        self,
        equation: Equation,
        reported_std: Mapping[str, float],
        start: Mapping[str, float],
        warm_start: Hypothesis,
        held: frozenset[str] = frozenset(),
    ) -> Hypothesis:
        """Estimate the model with an equation in addition to the causes that were named."""
        effect = equation_effect(equation, reported_std, dict.fromkeys(held), self.name)
        values = {f"{effect.prefix}_{name}": value for name, value in start.items()}
        fixed = {n: v for n, v in values.items() if n in effect.values and n not in effect.priors}
        effect = replace(effect, values={**effect.values, **fixed})
        linear = tuple(f"{effect.prefix}_{name}" for name in equation.coefficients)
        text = f"law:{equation.key}" + "".join(f" [{n}={start[n]:g}]" for n in sorted(held))
        candidate = Candidate(text, effect, linear)
        return self.comparison.refit([*self.base.candidates, candidate], values, warm_start)

    def round(self, known: _Tried | None, disturbances: DisturbanceModel) -> _Tried | None:
        """One more group of terms beside those known; None where none is worth what it pays."""
        warm_start = known.hypothesis if known else self.base
        screening = Screening(replace(warm_start.estimate, disturbances=disturbances))
        references = Courses(screening)
        every = groups(references.spans)
        self.tried = tried_up_to(every)
        best: _Tried | None = None
        rivals = dict[str, float]()
        kept = 0
        scored: dict[str, ScoredGroup] = {}
        for scored_group in (
            *self.slow(warm_start, disturbances, references, every),
            *self.finalists(score(screening, references, every)),
        ):
            scored.setdefault(scored_group.group.key, scored_group)
        for scored_group in scored.values():
            equation = self.law_of(scored_group, known)
            if equation is None:
                continue
            if kept >= EQUATION_FINALISTS:
                break
            self.say(f"trying {scored_group.group.key}")
            made = self.tried_one(scored_group, equation, known, references)
            gain = made.hypothesis.log_likelihood - warm_start.log_likelihood
            kept += gain >= LAW_KEPT_SHARE * scored_group.log_likelihood_gain
            rivals[scored_group.group.key] = gain - (made.penalty - (known.penalty if known else 0.0))
            if best is None or made.margin > best.margin:
                best = made
        before = warm_start.log_likelihood - (known.penalty if known else 0.0)
        if best is None or best.margin - before <= MIN_MARGIN:
            return None
        chosen = rivals.pop(best.group.key)
        self.rivals |= {key: chosen - margin for key, margin in rivals.items()}
        return self.tidied(best, known, references)

    def slow(
        self,
        warm_start: Hypothesis,
        disturbances: DisturbanceModel,
        references: Courses,
        every: Sequence[Group],
    ) -> list[ScoredGroup]:
        """The best where drift stands for what is missing: a law of slow quantities, such as travel, is worth
        next to nothing beside a drift as large as itself. They are those of a weather without that drift.
        """
        drifts = disturbances.slow_std > disturbances.fast_std
        if not drifts.any():
            return []
        still = replace(
            disturbances, slow_std=np.where(drifts, _NO_DRIFT_Nm, disturbances.slow_std), curvature=None
        )
        acting = [group for group in every if not group.terms[0].channel.startswith("measurement")]
        scored = score(Screening(replace(warm_start.estimate, disturbances=still)), references, acting)
        return self.finalists(scored)[:LAW_ALIKE]

    def finalists(self, scored: Sequence[ScoredGroup]) -> list[ScoredGroup]:
        """The best by what they promise less what they pay, twice as many as are wanted."""

        def worth(scored_group: ScoredGroup) -> float:
            return scored_group.log_likelihood_gain - self.penalty(
                scored_group.group, Equation(scored_group.group.terms), frozenset()
            )

        chosen: list[ScoredGroup] = []
        for scored_group in sorted(scored, key=worth, reverse=True):
            gain = scored_group.log_likelihood_gain
            paid = gain - worth(scored_group)
            if EXPECTED_REFIT_GAIN * gain <= paid + MIN_MARGIN or len(chosen) >= 2 * EQUATION_FINALISTS:
                continue
            like = [other for other in chosen if _place(other.group) == _place(scored_group.group)]
            if len(like) < LAW_ALIKE:
                chosen.append(scored_group)
        return chosen

    @staticmethod
    def law_of(scored_group: ScoredGroup, known: _Tried | None) -> Equation | None:
        """The law with one more group of terms; None where it has one twice."""
        terms = (*(known.equation.terms if known else ()), *scored_group.group.terms)
        return Equation(terms) if len(set(terms)) == len(terms) else None

    def tried_one(
        self, scored_group: ScoredGroup, equation: Equation, known: _Tried | None, references: Courses
    ) -> _Tried:
        """Refit an equation, starting from the score of its last group of terms."""
        start = _values(known) if known else {}
        first = len(equation.terms) - len(scored_group.group.terms)
        for i, value in enumerate(scored_group.coefficients):
            start[equation.coefficient(first + i)] = float(value)
        held = known.held if known else frozenset()
        # From the weather that the known terms leave: beside them that of the base stands for them once more.
        warm_start = known.hypothesis if known else self.base
        hypothesis = self.refit(equation, self.reported_std(equation, references), start, warm_start, held)
        penalty = self.penalty(scored_group.group, equation, held) + (known.penalty if known else 0.0)
        return _Tried(equation, hypothesis, penalty, scored_group.group, held)

    def reported_std(self, equation: Equation, references: Courses) -> dict[str, float]:
        """Prior standard deviations of a law's coefficients."""
        errors = {}
        for name, term in zip(equation.coefficients, equation.terms, strict=True):
            values = np.concatenate(
                [references.values(i, term) for i in range(len(references.linearised_flights))]
            )
            errors[name] = coefficient_std(term, max(float(np.sqrt(np.mean(values**2))), 1e-9))
        return errors

    def tidied(self, best: _Tried, known: _Tried | None, references: Courses) -> _Tried:
        """Without coefficients that are not told from nothing, and with whole multiplicities."""
        best = self.whole(best, references)
        while len(best.equation.terms) > 1:
            numbers = _numbers(best.hypothesis)
            worst = min(
                range(len(best.equation.terms)),
                key=lambda i: (
                    abs(numbers[best.equation.coefficient(i)][0]) / numbers[best.equation.coefficient(i)][1]
                ),
            )
            value, std = numbers[best.equation.coefficient(worst)]
            if abs(value) > NOTHING_STD_ERRORS * std:
                break
            less = self.without(best, worst, references)
            if less.margin <= best.margin:
                break
            best = self.whole(less, references)
        return best

    def without(self, of: _Tried, number: int, references: Courses) -> _Tried:
        """The law without one of its terms, its other numbers renamed to their new places."""
        gone = of.equation.terms[number]
        equation = Equation(tuple(term for i, term in enumerate(of.equation.terms) if i != number))
        values, held = _values(of), set[str]()
        renamed = dict[str, float]()
        for i in range(len(equation.terms)):
            old = i + (i >= number)
            renamed[equation.coefficient(i)] = values[of.equation.coefficient(old)]
            for j in range(len(equation.terms[i].term.factors)):
                for inner_name, name in of.equation.numbers_of(old, j).items():
                    new = equation.numbers_of(i, j)[inner_name]
                    renamed[new] = values[name]
                    held |= {new} if name in of.held else set()
        group = of.group
        penalty = of.penalty - 0.5 * math.log(self.comparison.rows)
        if gone in group.terms:
            group = Group(tuple(term for term in group.terms if term != gone), group.size)
        hypothesis = self.refit(
            equation, self.reported_std(equation, references), renamed, self.base, frozenset(held)
        )
        return _Tried(equation, hypothesis, penalty, group, frozenset(held))

    def whole(self, of: _Tried, references: Courses) -> _Tried:
        """Multiplicities at whole numbers where these are as likely; sine and cosine share theirs."""
        numbers = _numbers(of.hypothesis)
        waves = dict[tuple[str, str, float], list[str]]()
        for i, j, inner_name, name, begun, _ in of.equation.inner():
            if inner_name == "k" and name not in of.held:
                term = of.equation.terms[i]
                waves.setdefault((term.channel, term.term.factors[j].quantity, begun), []).append(name)
        fixed = dict[str, float]()
        for names in waves.values():
            values, reported_std = np.array([numbers[name] for name in names]).T
            weight = reported_std**-2.0
            value, std = float(values @ weight / weight.sum()), float(weight.sum() ** -0.5)
            if round(value) >= 1 and abs(value - round(value)) < max(_WHOLE * std, 0.02):
                fixed |= dict.fromkeys(names, float(round(value)))
        if not fixed:
            return of
        held = of.held | frozenset(fixed)
        start = {**_values(of), **fixed}
        hypothesis = self.refit(
            of.equation, self.reported_std(of.equation, references), start, self.base, held
        )
        penalty = of.penalty - 0.5 * len(fixed) * math.log(self.comparison.rows)
        made = _Tried(of.equation, hypothesis, penalty, of.group, held)
        return made if made.margin > of.margin - AMBIGUOUS else of


def free_name(used: Collection[str]) -> str:
    """Choose the name of a law beside effects of the names `used`."""
    names = itertools.chain((NAME,), (f"{NAME}_{number}" for number in itertools.count(2)))
    return next(name for name in names if name not in used)


def discover(
    comparison: ModelComparison,
    base: Hypothesis,
    *,
    curve: Hypothesis | None = None,
    kinds: Mapping[str, EffectKind] | None = None,
    refits: float = math.inf,
    say: Callable[[str], None] | None = None,
) -> Discovery | None:
    """Look for the law of what a model lacks.

    Parameters
    ----------
    comparison : ModelComparison
        The flights; those held out confirm the law.
    base : Hypothesis
        The model with the causes that were named.
    curve : Hypothesis, optional
        The same with curves in the place of what is missing: its weather is what remains, and its likelihood
        what a law should come near to.
    kinds : Mapping[str, EffectKind], optional
        The catalogue: a law that one of its effects does as well as is none.
    refits : float
        Refits after which no further term is looked for.
    say : callable, optional
        Called with what is being done.

    Returns
    -------
    Discovery or None
        None where no law pays for itself, explains most of what a curve does, is confirmed, and does better
        than what is on the list.
    """
    work = _Discoverer(comparison, base, say or (lambda _what: None))
    disturbances = (curve or base).estimate.disturbances
    known: _Tried | None = None
    confirmed: tuple[_Tried, float | None, dict[str, float]] | None = None
    without = comparison.held_out_estimate(base) if comparison.held_out else None
    before = 0.0
    while comparison.fits < refits and (known is None or len(known.equation.terms) < LAW_TERMS):
        result = work.round(known, disturbances if known is None else known.hypothesis.estimate.disturbances)
        if result is None or (known is not None and len(result.equation.terms) <= len(known.equation.terms)):
            break
        held_out = None
        if without is not None:
            beside = comparison.held_out_estimate(result.hypothesis)
            held_out = beside.log_likelihood - without.log_likelihood
            # Each term has to stand on the flights that had no part in its choice.
            if held_out - before < LAW_CONFIRMED:
                break
            before = held_out
        known, confirmed = result, (result, held_out, dict(work.rivals))
    if confirmed is None:
        return None
    equation, held_out, others = confirmed
    gained = equation.hypothesis.log_likelihood - base.log_likelihood
    by_curve = curve.log_likelihood - base.log_likelihood if curve is not None and curve is not base else None
    if by_curve is not None and gained < LAW_CURVE_SHARE * by_curve:
        return None
    listed = Catalogue(comparison, base, kinds or {}, work.say)
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
        max(work.tried.values()),
        superfluous,
        None if without is None else (without, comparison.held_out_estimate(hypothesis)),
    )


def _on_own_rate(channel: str, key: str) -> bool:
    """Whether a term about an axis has a sign of the axis' own rate."""
    return f"tanh({channel.partition('.')[2]}_rate" in key


def _place(group: Group) -> tuple[str, frozenset[str]]:
    """Where a group acts, and by what; encoders are one place: what the filter's course makes of a stretched
    one it makes of all.
    """
    channel = group.terms[0].channel
    if channel.startswith("measurement"):
        return "measurement", frozenset()
    return channel, frozenset(q for term in group.terms for q in term.term.quantities)


def _numbers(hypothesis: Hypothesis) -> dict[str, tuple[float, float]]:
    """Value and standard error of the law's numbers that are estimated, by name without prefix."""
    estimate = hypothesis.estimate
    std = np.sqrt(np.diag(estimate.covariance))
    prefix = f"{hypothesis.candidates[-1].effect.prefix}_"
    return {
        name.removeprefix(prefix): (float(value), float(error))
        for name, value, error in zip(estimate.parameter_vector.names, estimate.theta, std, strict=True)
        if name.startswith(prefix)
    }


def _values(of: _Tried) -> dict[str, float]:
    """Values of all numbers of a law, by name without prefix."""
    effect = of.hypothesis.candidates[-1].effect
    known = {**effect.values, **of.hypothesis.values}
    return {q.name.removeprefix(f"{effect.prefix}_"): known[q.name] for q in effect.parameters}
