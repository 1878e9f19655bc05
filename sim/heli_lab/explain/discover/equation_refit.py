"""Refits of equations: penalties of their parameters, and simplification after a refit."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from heli_lab.explain.discover.equation import Equation, EquationTerm, TermGroup, equation_effect
from heli_lab.explain.discover.scoring import ScoredTermGroup, TermSignals, term_coefficient_std
from heli_lab.explain.search.candidate import Candidate
from heli_lab.explain.search.hypothesis import Hypothesis
from heli_lab.explain.search.model_comparison import ModelComparison
from heli_lab.explain.thresholds import MIN_MARGIN, MIN_STD_SHARE, NEAR_REST_NATS, SIGNIFICANT_STD_ERRORS


@dataclass(frozen=True)
class RefittedEquation:
    """An equation as a term of the model, refitted."""

    equation: Equation  # Its terms
    hypothesis: Hypothesis  # The model with the equation as its last candidate
    penalty: float  # Complexity penalty of all its terms, nats
    group: TermGroup  # The terms that were added last
    held: frozenset[str] = frozenset()
    """Inner parameters at fixed values, by name without the effect's prefix."""

    @property
    def margin(self) -> float:
        """Log-likelihood less the penalty, nats."""
        return self.hypothesis.log_likelihood - self.penalty

    @property
    def values(self) -> dict[str, float]:
        """Values of all parameters of the equation, by name without prefix."""
        effect = self.hypothesis.candidates[-1].effect
        all_values = {**effect.values, **self.hypothesis.values}
        return {q.name.removeprefix(f"{effect.prefix}_"): all_values[q.name] for q in effect.parameters}

    @property
    def estimates(self) -> dict[str, tuple[float, float]]:
        """Value and standard error of the estimated parameters, by name without prefix."""
        prefix, std = f"{self.hypothesis.candidates[-1].effect.prefix}_", self.hypothesis.std
        return {
            name.removeprefix(prefix): (value, std[name])
            for name, value in self.hypothesis.values.items()
            if name.startswith(prefix)
        }


@dataclass
class EquationRefits:
    """Refits equations together with the causes that were named."""

    comparison: ModelComparison
    base: Hypothesis  # The model with the named causes
    name: str  # Name of the effect that an equation becomes
    tried: dict[int, int] = field(default_factory=dict)
    """Number of groups of terms of each size or smaller, for the penalty of multiple testing."""

    def penalty(self, group: TermGroup, equation: Equation, held: frozenset[str]) -> float:
        """Return the complexity penalty, in nats, of the terms of a `group` in an `equation`.

        It is the sum of three penalties: BIC for the parameters that are not `held`, the logarithm of the
        number of groups tried (multiple testing), and `NEAR_REST_NATS` for each sign of an axis' own rate.
        """
        inner_count = sum(
            inner.name not in held and not inner.is_sign_width and equation.terms[inner.term] in group.terms
            for inner in equation.inner_parameters()
        )
        free_count = len(group.terms) + inner_count  # each term has a coefficient
        near_rest_nats = sum(NEAR_REST_NATS for term in group.terms if _has_sign_of_own_rate(term))
        bic_nats = 0.5 * free_count * math.log(self.comparison.rows)
        return bic_nats + math.log(self.tried[group.complexity]) + near_rest_nats

    def refit(
        self,
        equation: Equation,
        signals: TermSignals,
        start: Mapping[str, float],
        warm_start: Hypothesis,
        held: frozenset[str] = frozenset(),
    ) -> Hypothesis:
        """Estimate the model with an equation."""
        effect = equation_effect(equation, self.prior_std(equation, signals), held, self.name)
        values = {f"{effect.prefix}_{name}": value for name, value in start.items()}
        # Parameters without a prior are not estimated.
        fixed_values = {
            name: value
            for name, value in values.items()
            if name in effect.values and name not in effect.priors
        }
        effect = replace(effect, values={**effect.values, **fixed_values})
        linear_names = tuple(f"{effect.prefix}_{name}" for name in equation.coefficients)
        held_text = "".join(f" [{name}={start[name]:g}]" for name in sorted(held))
        key = f"equation:{equation.key}{held_text}"
        candidate = Candidate(key, effect, linear_names)
        return self.comparison.refit([*self.base.candidates, candidate], values, warm_start)

    def refit_extended(
        self,
        scored: ScoredTermGroup,
        equation: Equation,
        current: RefittedEquation | None,
        signals: TermSignals,
    ) -> RefittedEquation:
        """Refit an equation that has one more group of terms."""
        start = current.values if current else {}
        first_new = len(equation.terms) - len(scored.group.terms)
        for i, value in enumerate(scored.coefficients):
            start[equation.coefficient(first_new + i)] = float(value)
        # Disturbances of the base would explain the torque of the current terms: start from those that remain
        # with these terms.
        warm_start = current.hypothesis if current else self.base
        held = current.held if current else frozenset()
        hypothesis = self.refit(equation, signals, start, warm_start, held)
        penalty = self.penalty(scored.group, equation, held) + (current.penalty if current else 0.0)
        return RefittedEquation(equation, hypothesis, penalty, scored.group, held)

    def prior_std(self, equation: Equation, signals: TermSignals) -> dict[str, float]:
        """Return the prior standard deviations of an equation's coefficients, by name without prefix.

        They follow from the root mean square of its terms in `signals`.
        """
        prior_std = {}
        for name, term in zip(equation.coefficients, equation.terms, strict=True):
            values = np.concatenate([signals.values(i, term) for i in range(len(signals.linearised_flights))])
            prior_std[name] = term_coefficient_std(term, max(float(np.sqrt(np.mean(values**2))), 1e-9))
        return prior_std

    def simplified(self, best: RefittedEquation, signals: TermSignals) -> RefittedEquation:
        """Simplify the equation `best` as far as the likelihood allows.

        Periods per turn become whole numbers. Then the term with the least significant coefficient is
        removed, until all coefficients are significant or the margin would fall. `signals` has the terms of
        the equation along the flights.
        """
        best = self.with_whole_periods(best, signals)
        while len(best.equation.terms) > 1:
            coefficients = [best.estimates[name] for name in best.equation.coefficients]
            t_ratios = [abs(value) / std for value, std in coefficients]
            weakest = t_ratios.index(min(t_ratios))
            value, std = coefficients[weakest]
            if abs(value) > SIGNIFICANT_STD_ERRORS * std:
                break
            shorter = self._refit_without_term(best, weakest, signals)
            if shorter.margin <= best.margin:
                break
            best = self.with_whole_periods(shorter, signals)
        return best

    def _refit_without_term(
        self, refitted: RefittedEquation, number: int, signals: TermSignals
    ) -> RefittedEquation:
        """Refit an equation without its term `number`, from 0."""
        shorter = _equation_without_term(refitted, number)
        removed_term, group = refitted.equation.terms[number], refitted.group
        if removed_term in group.terms:
            remaining_terms = tuple(term for term in group.terms if term != removed_term)
            group = TermGroup(remaining_terms, group.complexity)
        # BIC of the coefficient that is saved.
        penalty = refitted.penalty - 0.5 * math.log(self.comparison.rows)
        hypothesis = self.refit(shorter.equation, signals, shorter.start, self.base, shorter.held)
        return RefittedEquation(shorter.equation, hypothesis, penalty, group, shorter.held)

    def with_whole_periods(self, refitted: RefittedEquation, signals: TermSignals) -> RefittedEquation:
        """Hold periods per turn at whole numbers, if the equation is then about as likely as before.

        Effects that repeat with each turn, such as the error of an encoder, have a whole number of periods
        per turn.
        """
        whole_periods = self._nearly_whole_periods(refitted)
        if not whole_periods:
            return refitted
        held = refitted.held | frozenset(whole_periods)
        start = {**refitted.values, **whole_periods}
        hypothesis = self.refit(refitted.equation, signals, start, self.base, held)
        penalty = refitted.penalty - 0.5 * len(whole_periods) * math.log(self.comparison.rows)
        restricted = RefittedEquation(refitted.equation, hypothesis, penalty, refitted.group, held)
        return restricted if restricted.margin > refitted.margin - MIN_MARGIN else refitted

    @staticmethod
    def _nearly_whole_periods(refitted: RefittedEquation) -> dict[str, float]:
        """Return whole numbers of periods per turn, by name, where the estimates allow them.

        A number is allowed if it is within the standard errors of the estimated number of periods.
        """
        estimates = refitted.estimates
        # A sine and a cosine of the same channel and quantity are one wave, and share the number of periods.
        waves: dict[tuple[str, str, float], list[str]] = {}
        for inner in refitted.equation.inner_parameters():
            if inner.name_in_factor == "k" and inner.name not in refitted.held:
                term = refitted.equation.terms[inner.term]
                quantity = term.term.factors[inner.factor].quantity
                waves.setdefault((term.channel, quantity, inner.value), []).append(inner.name)
        whole_periods: dict[str, float] = {}
        for names in waves.values():
            # Mean of the estimates, weighted by their inverse variances, and its standard error.
            values, errors = np.array([estimates[name] for name in names]).T
            weight = errors**-2.0
            value, std = float(values @ weight / weight.sum()), float(weight.sum() ** -0.5)
            max_difference = SIGNIFICANT_STD_ERRORS * max(std, MIN_STD_SHARE * value)
            if round(value) >= 1 and abs(value - round(value)) < max_difference:
                whole_periods |= dict.fromkeys(names, float(round(value)))
        return whole_periods


class _EquationStart(NamedTuple):
    """An equation with start values and held parameters, by name without the effect's prefix."""

    equation: Equation
    start: dict[str, float]
    held: frozenset[str]


def _equation_without_term(refitted: RefittedEquation, number: int) -> _EquationStart:
    """Remove term `number`, from 0, of an equation, and keep the estimates of all other terms.

    The names of parameters contain the number of their term, so those of later terms change.
    """
    longer, old_values = refitted.equation, refitted.values
    equation = Equation(tuple(term for i, term in enumerate(longer.terms) if i != number))
    start, held = dict[str, float](), set[str]()
    for i, term in enumerate(equation.terms):
        i_before = i if i < number else i + 1
        start[equation.coefficient(i)] = old_values[longer.coefficient(i_before)]
        for j in range(len(term.term.factors)):
            new_names = equation.inner_names(i, j)
            for inner_name, old_name in longer.inner_names(i_before, j).items():
                start[new_names[inner_name]] = old_values[old_name]
                if old_name in refitted.held:
                    held.add(new_names[inner_name])
    return _EquationStart(equation, start, frozenset(held))


def _has_sign_of_own_rate(term: EquationTerm) -> bool:
    """Whether a term about an axis contains the sign of the axis' own rate, as dry friction does."""
    axis = term.channel.partition(".")[2]
    return f"tanh({axis}_rate" in term.term.key
