"""Refits of equations: what their parameters cost, and which terms and digits a refit justifies."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from heli_lab.diagnose.discover.equation import Equation, Group, equation_effect
from heli_lab.diagnose.discover.scoring import ScoredGroup, TermSignals, term_coefficient_std
from heli_lab.diagnose.search import Candidate, Hypothesis, ModelComparison
from heli_lab.diagnose.thresholds import MIN_MARGIN, NEAR_REST_NATS, SIGNIFICANT_STD_ERRORS


@dataclass(frozen=True)
class RefittedEquation:
    """An equation as a term of the model, refitted.

    Parameters
    ----------
    equation : Equation
        Its terms.
    hypothesis : Hypothesis
        The model with the equation as its last candidate.
    penalty : float
        Complexity penalty of all its terms, nats.
    group : Group
        The terms that were added last.
    held : frozenset of str
        Inner parameters at fixed values, by name without the effect's prefix.
    """

    equation: Equation
    hypothesis: Hypothesis
    penalty: float
    group: Group
    held: frozenset[str] = frozenset()

    @property
    def margin(self) -> float:
        """Log-likelihood less the penalty, nats."""
        return self.hypothesis.log_likelihood - self.penalty

    @property
    def values(self) -> dict[str, float]:
        """Values of all parameters of the equation, by name without prefix."""
        effect = self.hypothesis.candidates[-1].effect
        known = {**effect.values, **self.hypothesis.values}
        return {q.name.removeprefix(f"{effect.prefix}_"): known[q.name] for q in effect.parameters}

    @property
    def estimates(self) -> dict[str, tuple[float, float]]:
        """Value and standard error of the estimated parameters, by name without prefix."""
        estimate = self.hypothesis.estimate
        std = np.sqrt(np.diag(estimate.covariance))
        prefix = f"{self.hypothesis.candidates[-1].effect.prefix}_"
        return {
            name.removeprefix(prefix): (float(value), float(error))
            for name, value, error in zip(estimate.parameter_vector.names, estimate.theta, std, strict=True)
            if name.startswith(prefix)
        }


@dataclass
class EquationRefits:
    """Refits equations together with the causes that were named.

    Parameters
    ----------
    base : Hypothesis
        The model with the named causes.
    name : str
        Name of the effect that an equation becomes.
    tried : dict of int to int
        Number of groups of terms of each size or smaller, for the penalty of multiple testing.
    """

    comparison: ModelComparison
    base: Hypothesis
    name: str
    tried: dict[int, int] = field(default_factory=dict)

    def penalty(self, group: Group, equation: Equation, held: frozenset[str]) -> float:
        """Complexity penalty, in nats, of the terms of a `group` in an `equation`: BIC for its parameters
        that are not `held`, and the logarithm of the number of groups tried.
        """
        free = len(group.terms) + sum(
            1
            for i, j, inner_name, name, _, _ in equation.inner()
            if name not in held
            and equation.terms[i] in group.terms
            and not (inner_name == "width" and equation.terms[i].term.factors[j].form == "sign")
        )
        at_rest_nats = sum(
            NEAR_REST_NATS for term in group.terms if _on_own_rate(term.channel, term.term.key)
        )
        return 0.5 * free * math.log(self.comparison.rows) + math.log(self.tried[group.size]) + at_rest_nats

    def refit(
        self,
        equation: Equation,
        signals: TermSignals,
        start: Mapping[str, float],
        warm_start: Hypothesis,
        held: frozenset[str] = frozenset(),
    ) -> Hypothesis:
        """Estimate the model with an equation.

        Parameters
        ----------
        equation : Equation
            Its terms.
        signals : TermSignals
            Terms along the flights, from which the priors of the coefficients follow.
        start : Mapping[str, float]
            Values of the equation's parameters to start from, by name without prefix.
        warm_start : Hypothesis
            Model whose parameters and disturbances to start from.
        held : frozenset of str
            Inner parameters to hold at their start values.
        """
        effect = equation_effect(equation, self.prior_std(equation, signals), dict.fromkeys(held), self.name)
        values = {f"{effect.prefix}_{name}": value for name, value in start.items()}
        fixed = {n: v for n, v in values.items() if n in effect.values and n not in effect.priors}
        effect = replace(effect, values={**effect.values, **fixed})
        linear = tuple(f"{effect.prefix}_{name}" for name in equation.coefficients)
        text = f"equation:{equation.key}" + "".join(f" [{n}={start[n]:g}]" for n in sorted(held))
        candidate = Candidate(text, effect, linear)
        return self.comparison.refit([*self.base.candidates, candidate], values, warm_start)

    def refit_extended(
        self, scored: ScoredGroup, equation: Equation, known: RefittedEquation | None, signals: TermSignals
    ) -> RefittedEquation:
        """Refit an equation that has one more group of terms.

        Parameters
        ----------
        scored : ScoredGroup
            The group, with its score test.
        equation : Equation
            The equation with the group's terms at its end.
        known : RefittedEquation or None
            The equation without them; None if it has no other terms.
        signals : TermSignals
            Terms along the flights.
        """
        start = known.values if known else {}
        first = len(equation.terms) - len(scored.group.terms)
        for i, value in enumerate(scored.coefficients):
            start[equation.coefficient(first + i)] = float(value)
        # Disturbances of the base would replace the known terms once more: start from those that remain with
        # these terms.
        warm_start = known.hypothesis if known else self.base
        held = known.held if known else frozenset()
        hypothesis = self.refit(equation, signals, start, warm_start, held)
        penalty = self.penalty(scored.group, equation, held) + (known.penalty if known else 0.0)
        return RefittedEquation(equation, hypothesis, penalty, scored.group, held)

    def prior_std(self, equation: Equation, signals: TermSignals) -> dict[str, float]:
        """Prior standard deviations of the coefficients of an `equation`, by name without prefix, from the
        size of its terms in `signals`.
        """
        errors = {}
        for name, term in zip(equation.coefficients, equation.terms, strict=True):
            values = np.concatenate([signals.values(i, term) for i in range(len(signals.linearised_flights))])
            errors[name] = term_coefficient_std(term, max(float(np.sqrt(np.mean(values**2))), 1e-9))
        return errors

    def simplified(self, best: RefittedEquation, signals: TermSignals) -> RefittedEquation:
        """Simplify the equation `best` as far as the likelihood allows, with its terms in `signals`: whole
        numbers of periods per turn, and no coefficient that does not differ from zero.
        """
        best = self.with_whole_periods(best, signals)
        while len(best.equation.terms) > 1:
            estimates = best.estimates
            names = best.equation.coefficients
            z = [abs(estimates[name][0]) / estimates[name][1] for name in names]
            weakest = min(range(len(names)), key=lambda i: z[i])
            value, std = estimates[names[weakest]]
            if abs(value) > SIGNIFICANT_STD_ERRORS * std:
                break
            less = self._without(best, weakest, signals)
            if less.margin <= best.margin:
                break
            best = self.with_whole_periods(less, signals)
        return best

    def _without(self, refitted: RefittedEquation, number: int, signals: TermSignals) -> RefittedEquation:
        """The equation without one of its terms; the parameters of later terms get new names."""
        gone = refitted.equation.terms[number]
        equation = Equation(tuple(term for i, term in enumerate(refitted.equation.terms) if i != number))
        values, held = refitted.values, set[str]()
        renamed = dict[str, float]()
        for i in range(len(equation.terms)):
            old = i + (i >= number)
            renamed[equation.coefficient(i)] = values[refitted.equation.coefficient(old)]
            for j in range(len(equation.terms[i].term.factors)):
                for inner_name, name in refitted.equation.numbers_of(old, j).items():
                    new = equation.numbers_of(i, j)[inner_name]
                    renamed[new] = values[name]
                    held |= {new} if name in refitted.held else set()
        group = refitted.group
        penalty = refitted.penalty - 0.5 * math.log(self.comparison.rows)
        if gone in group.terms:
            group = Group(tuple(term for term in group.terms if term != gone), group.size)
        hypothesis = self.refit(equation, signals, renamed, self.base, frozenset(held))
        return RefittedEquation(equation, hypothesis, penalty, group, frozenset(held))

    def with_whole_periods(self, refitted: RefittedEquation, signals: TermSignals) -> RefittedEquation:
        """Hold periods per turn at whole numbers if an equation is as likely then; a sine and a cosine share
        theirs. `signals` has its terms along the flights.
        """
        estimates = refitted.estimates
        waves = dict[tuple[str, str, float], list[str]]()
        for i, j, inner_name, name, begun, _ in refitted.equation.inner():
            if inner_name == "k" and name not in refitted.held:
                term = refitted.equation.terms[i]
                waves.setdefault((term.channel, term.term.factors[j].quantity, begun), []).append(name)
        fixed = dict[str, float]()
        for names in waves.values():
            values, errors = np.array([estimates[name] for name in names]).T
            weight = errors**-2.0
            value, std = float(values @ weight / weight.sum()), float(weight.sum() ** -0.5)
            if round(value) >= 1 and abs(value - round(value)) < max(SIGNIFICANT_STD_ERRORS * std, 0.02):
                fixed |= dict.fromkeys(names, float(round(value)))
        if not fixed:
            return refitted
        held = refitted.held | frozenset(fixed)
        start = {**refitted.values, **fixed}
        hypothesis = self.refit(refitted.equation, signals, start, self.base, held)
        penalty = refitted.penalty - 0.5 * len(fixed) * math.log(self.comparison.rows)
        with_fixed = RefittedEquation(refitted.equation, hypothesis, penalty, refitted.group, held)
        return with_fixed if with_fixed.margin > refitted.margin - MIN_MARGIN else refitted


def _on_own_rate(channel: str, key: str) -> bool:
    """Whether a term about an axis has a sign of the axis' own rate."""
    return f"tanh({channel.partition('.')[2]}_rate" in key
