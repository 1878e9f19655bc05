"""Symbolic regression of what a model lacks.

Terms are scored as regressors of the innovations, and the best are refitted in innovations form together
with the disturbances. A term is accepted if its log-likelihood ratio exceeds its penalty: BIC for its
parameters, and the logarithm of the number of terms of its size and smaller that were tried. Then the next
round begins. Held-out flights do not choose terms; an equation that they do not confirm is dropped.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from heli_sim.model.effects import EffectSpec

from heli_lab.explain.candidates import Candidate, channel_place, may_join, typical_candidate
from heli_lab.explain.comparison import Hypothesis, ModelComparison
from heli_lab.explain.screening import Screening
from heli_lab.explain.term_scores import (
    ScoredTermGroup,
    TermSignals,
    count_by_complexity,
    groups,
    score_groups,
    term_coefficient_std,
)
from heli_lab.explain.terms import (
    NAME,
    Equation,
    EquationEffect,
    EquationTerm,
    Term,
    TermGroup,
    equation_effect,
)
from heli_lab.explain.thresholds import (
    ALTERNATIVES,
    CANDIDATES_TRIED,
    EQUATION_FINALISTS,
    EQUATION_MAX_TERMS,
    EQUATION_MIN_SPLINE_SHARE,
    EXPECTED_REFIT_GAIN,
    MIN_MARGIN,
    MIN_STD_SHARE,
    NEAR_REST_NATS,
    SHORTLIST,
    SHORTLIST_SHARE,
    SIGNIFICANT_STD_ERRORS,
    SPLINE_MARGIN,
)
from heli_lab.fit.estimator import Estimate
from heli_lab.fit.grey_box import DisturbanceModel
from heli_lab.fit.parameters import ValueAndStd


class EquationParameter(NamedTuple):
    """Estimate and standard error of a parameter in its unit; the error is 0 if the parameter is fixed."""

    value: float
    std: float
    unit: str


@dataclass(frozen=True)
class Rival:
    """A term that was not accepted."""

    key: str  # The term as text, such as ``torque.pitch: elevation``
    log_likelihood_ratio: float
    """Log-likelihood ratio of the proposed equation over the one with this term, penalties included, nats."""


@dataclass(frozen=True, eq=False)
class Discovery:
    """An equation that explains what a model lacks; compared by identity."""

    equation: Equation  # The terms
    base: Hypothesis
    """base, hypothesis: The model without and with the equation, each with its own estimate of the
    disturbances."""
    hypothesis: Hypothesis
    penalty: float  # Complexity penalty for the parameters and for multiple testing, nats
    held_out_nats: float | None
    """Log-likelihood ratio on the held-out flights, nats; None without such flights."""
    curve_nats: float | None
    """Gain of spline terms in the place of the equation on the fitted flights, nats; None if there were none.
    """
    rivals: tuple[Rival, ...]  # Terms that were not accepted, the closest first
    tried: int  # Number of groups of terms that were scored
    superfluous: tuple[str, ...] = ()
    """Ids of causes that are not significant any more in the model with the equation."""
    elsewhere: tuple[Estimate, Estimate] | None = None
    """(Estimate, Estimate): Estimates of the held-out flights, without and with the equation; None without
    such flights."""

    @property
    def effect(self) -> EquationEffect:
        """The equation as an effect of the model."""
        effect = self.hypothesis.candidates[-1].effect
        assert isinstance(effect, EquationEffect)
        return effect

    @property
    def train_nats(self) -> float:
        """Log-likelihood ratio over the model without the equation on the fitted flights, nats."""
        return self.hypothesis.log_likelihood - self.base.log_likelihood

    @property
    def values(self) -> dict[str, EquationParameter]:
        """Parameters of the equation by name, without the effect's prefix."""
        values, std = {**self.effect.values, **self.hypothesis.params}, self.hypothesis.std
        return {
            q.name.removeprefix(f"{self.effect.prefix}_"): EquationParameter(
                values[q.name], std.get(q.name, 0.0), q.unit
            )
            for q in self.effect.parameters
        }

    def with_estimated_parameters(self, number: int) -> EquationTerm:
        """Return term `number`, from 0, with the estimates of its inner parameters."""
        term, values = self.equation.terms[number], self.values
        factors = tuple(
            replace(
                factor,
                parameters=tuple(
                    (inner_name, values[name].value)
                    for inner_name, name in self.equation.inner_names(number, j).items()
                ),
            )
            for j, factor in enumerate(term.term.factors)
        )
        return EquationTerm(term.channel, Term(factors))


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
    def penalised_nats(self) -> float:
        """Log-likelihood less the penalty, nats."""
        return self.hypothesis.log_likelihood - self.penalty

    @property
    def values(self) -> dict[str, float]:
        """Values of all parameters of the equation, by name without prefix."""
        effect = self.hypothesis.candidates[-1].effect
        all_values = {**effect.values, **self.hypothesis.params}
        return {q.name.removeprefix(f"{effect.prefix}_"): all_values[q.name] for q in effect.parameters}

    @property
    def estimates(self) -> dict[str, ValueAndStd]:
        """Value and standard error of the estimated parameters, by name without prefix."""
        prefix, std = f"{self.hypothesis.candidates[-1].effect.prefix}_", self.hypothesis.std
        return {
            name.removeprefix(prefix): ValueAndStd(value, std[name])
            for name, value in self.hypothesis.params.items()
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
        """Return the complexity penalty, in nats, of the terms of a `group` in an `equation`."""
        # It is the sum of three penalties: BIC for the parameters that are not `held`, the logarithm of the
        # number of groups tried (multiple testing), and `NEAR_REST_NATS` for each sign of an axis' own rate.
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
        linear_names = tuple(f"{effect.prefix}_{name}" for name in equation.coefficient_names)
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
            start[equation.coefficient_name(first_new + i)] = float(value)
        # Disturbances of the base would explain the torque of the current terms: start from those that remain
        # with these terms.
        warm_start = current.hypothesis if current else self.base
        held = current.held if current else frozenset()
        hypothesis = self.refit(equation, signals, start, warm_start, held)
        penalty = self.penalty(scored.group, equation, held) + (current.penalty if current else 0.0)
        return RefittedEquation(equation, hypothesis, penalty, scored.group, held)

    def prior_std(self, equation: Equation, signals: TermSignals) -> dict[str, float]:
        """Return the prior standard deviations of an equation's coefficients, by name without prefix."""
        prior_std = {}
        for name, term in zip(equation.coefficient_names, equation.terms, strict=True):
            values = np.concatenate([signals.values(i, term) for i in range(len(signals.linearised_flights))])
            prior_std[name] = term_coefficient_std(term, max(float(np.sqrt(np.mean(values**2))), 1e-9))
        return prior_std

    def simplified(self, best: RefittedEquation, signals: TermSignals) -> RefittedEquation:
        """Simplify the equation `best` as far as the likelihood allows."""
        # Periods per turn become whole numbers. Then the term with the least significant coefficient is
        # removed, until all coefficients are significant or the likelihood less the penalty would fall.
        # `signals` has the terms of the equation along the flights.
        best = self.with_whole_periods(best, signals)
        while len(best.equation.terms) > 1:
            coefficients = [best.estimates[name] for name in best.equation.coefficient_names]
            t_ratios = [abs(value) / std for value, std in coefficients]
            weakest = t_ratios.index(min(t_ratios))
            value, std = coefficients[weakest]
            if abs(value) > SIGNIFICANT_STD_ERRORS * std:
                break  # all coefficients are significant
            shorter = self._refit_without_term(best, weakest, signals)
            if shorter.penalised_nats <= best.penalised_nats:
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
        """Hold periods per turn at whole numbers, if the equation is then about as likely as before."""
        # Effects that repeat with each turn, such as the error of an encoder, have a whole number of periods
        # per turn.
        whole_periods = self._nearly_whole_periods(refitted)
        if not whole_periods:
            return refitted
        held = refitted.held | frozenset(whole_periods)
        start = {**refitted.values, **whole_periods}
        hypothesis = self.refit(refitted.equation, signals, start, self.base, held)
        penalty = refitted.penalty - 0.5 * len(whole_periods) * math.log(self.comparison.rows)
        restricted = RefittedEquation(refitted.equation, hypothesis, penalty, refitted.group, held)
        return restricted if restricted.penalised_nats > refitted.penalised_nats - MIN_MARGIN else refitted

    @staticmethod
    def _nearly_whole_periods(refitted: RefittedEquation) -> dict[str, float]:
        """Return whole numbers of periods per turn, by name, where the estimates allow them."""
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
    """Remove term `number`, from 0, of an equation, and keep the estimates of all other terms."""
    # The names of parameters contain the number of their term, so those of later terms change.
    longer, old_values = refitted.equation, refitted.values
    equation = Equation(tuple(term for i, term in enumerate(longer.terms) if i != number))
    start, held = dict[str, float](), set[str]()
    for i, term in enumerate(equation.terms):
        i_before = i if i < number else i + 1
        start[equation.coefficient_name(i)] = old_values[longer.coefficient_name(i_before)]
        for j in range(len(term.term.factors)):
            new_names = equation.inner_names(i, j)
            for inner_name, old_name in longer.inner_names(i_before, j).items():
                start[new_names[inner_name]] = old_values[old_name]
                if old_name in refitted.held:
                    held.add(new_names[inner_name])
    return _EquationStart(equation, start, frozenset(held))


def _has_sign_of_own_rate(term: EquationTerm) -> bool:
    """Whether a term about an axis contains the sign of the axis' own rate, as dry friction does."""
    return f"tanh({channel_place(term.channel)}_rate" in term.term.key


class _PossibleEffect(NamedTuple):
    """An effect that may be equivalent to an equation."""

    candidate: Candidate
    start: Mapping[str, float]  # Start values of its parameters
    score_nats: float | None  # Predicted gain of log-likelihood; None if the effect has no derivative


@dataclass
class ListedEffects:
    """Search for an effect of the catalogue that explains the flights as well as an equation does."""

    comparison: ModelComparison  # Estimates models on the flights
    base: Hypothesis  # The model with the named causes, without the equation
    kinds: Mapping[str, EffectSpec]  # Catalogue by effect id
    say: Callable[[str], None]  # Called with the present step in words

    def equivalent_effect(self, equation: Equation, warm_start: Hypothesis, penalty: float) -> str | None:
        """Find an effect of the catalogue that explains all flights as well as an equation does."""
        # The search may have missed this effect, because disturbances explained its torque. An effect does
        # not count if the equation encompasses it, see `encompasses`. Log-likelihoods are of all flights.
        equation_nats = warm_start.log_likelihood - penalty + self.held_out_nats(warm_start)
        # Like a spline, an equation must exceed an effect by a share of its own lead over the base.
        lead = SPLINE_MARGIN * (equation_nats - self.base.log_likelihood)
        required_nats = equation_nats - max(MIN_MARGIN, lead)
        confirmed_scores = 0
        for effect, start, score_nats in self._possible_effects(equation, warm_start):
            complexity_penalty = self.complexity_penalty(effect)
            # Scores fall: no later effect can be good enough, or enough refits have confirmed their score,
            # that is, gained a share of it. Effects without a score come first and are always refitted.
            if score_nats is not None and (
                confirmed_scores >= SHORTLIST
                or EXPECTED_REFIT_GAIN * score_nats <= complexity_penalty + MIN_MARGIN
            ):
                break
            rival = self.refit(effect, start, warm_start)
            penalised_nats = self.penalised_nats(rival, effect) + self.held_out_nats(rival)
            if (
                penalised_nats > required_nats
                and self.comparison.in_flight(rival)
                and not self.encompasses(warm_start, rival, effect, penalty)
            ):
                return effect.id
            # A score has no penalty either.
            gain = penalised_nats + complexity_penalty - self.base.log_likelihood
            confirmed_scores += score_nats is not None and gain >= SHORTLIST_SHARE * score_nats
        return None

    def _possible_effects(self, equation: Equation, warm_start: Hypothesis) -> Iterator[_PossibleEffect]:
        """Yield effects that may be equivalent, the best first."""
        # Friction that holds an axis has no derivative, and thus no score. It comes first, at its typical
        # size.
        screening = Screening(replace(self.base.estimate, disturbances=warm_start.estimate.disturbances))
        dry_friction = {f"coulomb_friction.{axis}" for axis in _axes_of_equation(equation)}
        for kind in self.eligible_effects:
            if kind.id in dry_friction:
                yield _PossibleEffect(typical_candidate(kind), kind.typical, None)
        for scored in screening.effects(self.eligible_effects)[: 2 * SHORTLIST]:
            start = scored.candidate.start_values(scored.coefficients)
            yield _PossibleEffect(scored.candidate, start, scored.log_likelihood_gain)

    @property
    def eligible_effects(self) -> list[EffectSpec]:
        """Effects of the catalogue that may be added to the base."""
        return [
            kind
            for kind in self.kinds.values()
            if not kind.baseline and not kind.noise_inputs and may_join(kind.id, self.base.ids, self.kinds)
        ]

    def refit(self, effect: Candidate, start: Mapping[str, float], warm_start: Hypothesis) -> Hypothesis:
        """Estimate the base with one more `effect`."""
        self.say(f"trying {effect.id} in its place")
        return self.comparison.refit([*self.base.candidates, effect], start, warm_start)

    def penalised_nats(self, model: Hypothesis, effect: Candidate) -> float:
        """Return the log-likelihood, in nats, of a `model` with an `effect`, less the effect's penalty."""
        # The priors of the effect's parameters do not count, because an equation's coefficients may have any
        # size, too.
        parameters = [
            (model.params[name], prior)
            for name, prior in effect.effect.priors.items()
            if name in model.params
        ]
        prior_nats = sum(0.5 * ((value - prior.mean) / prior.std) ** 2 for value, prior in parameters)
        return model.log_likelihood + prior_nats - self.complexity_penalty(effect)

    def held_out_nats(self, model: Hypothesis) -> float:
        """Return the log-likelihood ratio of a `model` over the base on the held-out flights, nats."""
        if not self.comparison.held_out:
            return 0.0
        return self.comparison.held_out_estimate(model).log_likelihood - self._held_out_nats_of_base

    @cached_property
    def _held_out_nats_of_base(self) -> float:
        """Log-likelihood of the base on the held-out flights, nats."""
        return self.comparison.held_out_estimate(self.base).log_likelihood

    def encompasses(
        self, warm_start: Hypothesis, rival: Hypothesis, effect: Candidate, penalty: float
    ) -> bool:
        """Whether an equation encompasses an effect that fits equally well in its place."""
        # It does if, in a model with both, the equation exceeds its penalty and the effect adds less. This is
        # the J test (Davidson and MacKinnon, Econometrica 49 (1981) 781) by likelihoods.
        equation = warm_start.candidates[-1]
        start = {name: rival.params[name] for name in effect.effect.priors if name in rival.params}
        with_both_terms = self.comparison.refit([*self.base.candidates, effect, equation], start, warm_start)

        def gain_over(model: Hypothesis) -> float:
            """Return the gain of the model with both over another model on all flights, nats."""
            fitted = with_both_terms.log_likelihood - model.log_likelihood
            return fitted + self.held_out_nats(with_both_terms) - self.held_out_nats(model)

        equation_gain, effect_gain = gain_over(rival), gain_over(warm_start)
        return equation_gain - penalty > max(MIN_MARGIN, effect_gain - self.complexity_penalty(effect))

    def complexity_penalty(self, effect: Candidate) -> float:
        """Return the complexity penalty of an `effect`, nats."""
        return 0.5 * len(effect.effect.priors) * math.log(self.comparison.rows) + math.log(CANDIDATES_TRIED)

    def without_superfluous(self, with_equation: Hypothesis) -> tuple[Hypothesis, tuple[str, ...]]:
        """Remove causes that are not significant in the model `with_equation`."""
        final, removed_ids = with_equation, list[str]()
        for candidate in self.base.candidates:
            other_causes = [other for other in final.candidates[:-1] if other.id != candidate.id]
            reduced = self.comparison.refit([*other_causes, final.candidates[-1]], None, final)
            ratio_nats = final.log_likelihood - reduced.log_likelihood
            if ratio_nats - self.complexity_penalty(candidate) <= MIN_MARGIN:
                final = reduced
                removed_ids.append(candidate.id)
        return final, tuple(removed_ids)


def _axes_of_equation(equation: Equation) -> set[str]:
    """Return the axes about which an equation acts directly."""
    axis_of_rotors = {"both": "elevation", "difference": "pitch", "front": "pitch", "back": "pitch"}
    places = map(channel_place, equation.channels)
    return {axis_of_rotors.get(place, place) for place in places}


_NO_DRIFT_Nm: Final = 2e-5
"""Practically zero; covariances stay regular."""


@dataclass
class EquationSearch:
    """Forward selection of the terms of an equation: each round adds the group of terms of largest margin."""

    refits: EquationRefits  # Refits equations, and knows their penalties
    say: Callable[[str], None]  # Called with the present step in words
    lead_over_rival: dict[str, float] = field(default_factory=dict)
    """Log-likelihood ratio of the accepted term over each that was not, penalties included, nats."""

    def round(
        self, current: RefittedEquation | None, disturbances: DisturbanceModel
    ) -> RefittedEquation | None:
        """Add one more group of terms to the `current` equation, None at first; return None if none is
        accepted.
        """
        warm_start = current.hypothesis if current else self.refits.base
        screening = Screening(replace(warm_start.estimate, disturbances=disturbances))
        signals = TermSignals(screening)
        all_groups = groups(signals.spans)
        self.refits.tried = count_by_complexity(all_groups)
        finalists: dict[str, ScoredTermGroup] = {}
        for scored_group in (
            *self.slow_finalists(warm_start, disturbances, signals, all_groups),
            *self.finalists(score_groups(screening, signals, all_groups)),
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
        """Refit the current equation with each finalist; return the refit of the largest margin."""
        # The result is None if its margin does not exceed that of the current equation by `MIN_MARGIN`. The
        # lead over each other finalist is stored in `lead_over_rival`. A score is confirmed if the refit
        # gains a share of it; the search stops after `EQUATION_FINALISTS` confirmed ones to save time.
        best: RefittedEquation | None = None
        margin_by_group = dict[str, float]()
        confirmed_scores = 0
        current_penalty = current.penalty if current else 0.0
        for scored_group in finalists:
            equation = extended_equation(scored_group, current)
            if equation is None:
                continue  # a term would occur twice
            if confirmed_scores >= EQUATION_FINALISTS:
                break
            self.say(f"trying {scored_group.group.key}")
            refit = self.refits.refit_extended(scored_group, equation, current, signals)
            gain = refit.hypothesis.log_likelihood - warm_start.log_likelihood
            if gain >= SHORTLIST_SHARE * scored_group.log_likelihood_gain:
                confirmed_scores += 1
            margin_by_group[scored_group.group.key] = gain - (refit.penalty - current_penalty)
            if best is None or refit.penalised_nats > best.penalised_nats:
                best = refit
        if best is None or best.penalised_nats - (warm_start.log_likelihood - current_penalty) <= MIN_MARGIN:
            return None
        best_margin = margin_by_group.pop(best.group.key)
        self.lead_over_rival |= {key: best_margin - margin for key, margin in margin_by_group.items()}
        return best

    def slow_finalists(
        self,
        warm_start: Hypothesis,
        disturbances: DisturbanceModel,
        signals: TermSignals,
        all_groups: Sequence[TermGroup],
    ) -> list[ScoredTermGroup]:
        """Score terms without slow disturbances, and choose the best."""
        # A slow disturbance of its size explains a term of slow quantities such as travel, so that the term
        # has hardly any score.
        is_slow = disturbances.slow_std > disturbances.fast_std
        if not is_slow.any():
            return []  # no slow disturbance hides a term
        disturbances_without_drift = replace(
            disturbances, slow_std=np.where(is_slow, _NO_DRIFT_Nm, disturbances.slow_std), curvature=None
        )
        # A drift is a torque: it does not hide an error of a measurement.
        dynamic_groups = [
            group for group in all_groups if not group.terms[0].channel.startswith("measurement")
        ]
        scores = score_groups(
            Screening(replace(warm_start.estimate, disturbances=disturbances_without_drift)),
            signals,
            dynamic_groups,
        )
        return self.finalists(scores)[:ALTERNATIVES]

    def finalists(self, scored: Sequence[ScoredTermGroup]) -> list[ScoredTermGroup]:
        """Choose the groups of terms with the largest score less penalty, which are refitted."""
        # The number is twice `EQUATION_FINALISTS`, because not every score is confirmed. At most
        # `ALTERNATIVES` groups have the same channel and quantities.

        def penalty(scored_group: ScoredTermGroup) -> float:
            """Return the penalty of a group as an equation of its own, nats."""
            return self.refits.penalty(scored_group.group, Equation(scored_group.group.terms), frozenset())

        def net_gain(scored_group: ScoredTermGroup) -> float:
            """Return the score less the penalty, nats."""
            return scored_group.log_likelihood_gain - penalty(scored_group)

        finalists: list[ScoredTermGroup] = []
        for scored_group in sorted(scored, key=net_gain, reverse=True):
            if len(finalists) >= 2 * EQUATION_FINALISTS:
                break
            expected_gain = EXPECTED_REFIT_GAIN * scored_group.log_likelihood_gain
            if expected_gain <= penalty(scored_group) + MIN_MARGIN:
                continue  # no refit can be accepted
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
    """An equation whose last term the held-out flights confirmed."""

    refitted: RefittedEquation
    held_out_nats: float | None  # Log-likelihood ratio on these flights, nats; None without such flights
    lead_over_rival: dict[str, float]  # Lead over each other term, nats, by the term's key


def _select_terms(
    search: EquationSearch,
    disturbances: DisturbanceModel,
    without_equation: Estimate | None,
    max_refits: float,
) -> _ConfirmedEquation | None:
    """Add groups of terms until none exceeds its penalty or is confirmed by the held-out flights; None if the
    first group fails.
    """
    # `without_equation` is the model without an equation on the held-out flights; None if there are none.
    comparison = search.refits.comparison
    confirmed: _ConfirmedEquation | None = None
    confirmed_nats = 0.0
    while comparison.fits < max_refits:
        current = confirmed.refitted if confirmed is not None else None
        term_count = len(current.equation.terms) if current is not None else 0
        if term_count >= EQUATION_MAX_TERMS:
            break
        if current is not None:
            disturbances = current.hypothesis.estimate.disturbances
        result = search.round(current, disturbances)
        # A round also simplifies the equation, which may remove the term that it added.
        if result is None or len(result.equation.terms) <= term_count:
            break
        held_out_nats = None
        if without_equation is not None:
            with_equation = comparison.held_out_estimate(result.hypothesis)
            held_out_nats = with_equation.log_likelihood - without_equation.log_likelihood
            # Flights that had no part in its choice must confirm each term.
            if held_out_nats - confirmed_nats < MIN_MARGIN:
                break
            confirmed_nats = held_out_nats
        confirmed = _ConfirmedEquation(result, held_out_nats, dict(search.lead_over_rival))
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
    """Search for an equation of what a model lacks; None without one."""
    # `curve` is the model with spline terms in the place of the equation, and `kinds` the listed effects that
    # may replace it; without them, neither is compared.
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
            return None  # it describes only a part of the curve
    catalogue = ListedEffects(comparison, base, kinds or {}, search.say)
    if catalogue.equivalent_effect(refitted.equation, refitted.hypothesis, refitted.penalty) is not None:
        return None  # the search missed a listed effect: no equation is needed
    hypothesis, superfluous = catalogue.without_superfluous(refitted.hypothesis)
    rivals = [Rival(key, lead) for key, lead in confirmed.lead_over_rival.items()]
    return Discovery(
        equation=refitted.equation,
        base=base,
        hypothesis=hypothesis,
        penalty=refitted.penalty,
        held_out_nats=confirmed.held_out_nats,
        curve_nats=spline_gain,
        rivals=tuple(sorted(rivals, key=lambda rival: rival.log_likelihood_ratio)),
        tried=max(search.refits.tried.values()),
        superfluous=superfluous,
        elsewhere=None
        if held_out_base is None
        else (held_out_base, comparison.held_out_estimate(hypothesis)),
    )


def _channel_and_quantities(group: TermGroup) -> tuple[str, frozenset[str]]:
    """Return channel and quantities of a group; groups of one family compete with each other."""
    # All encoders count as one, because a scale error of one of them shifts the filtered states of all.
    channel = group.terms[0].channel
    if channel.startswith("measurement"):
        return "measurement", frozenset()
    return channel, frozenset(q for term in group.terms for q in term.term.quantities)
