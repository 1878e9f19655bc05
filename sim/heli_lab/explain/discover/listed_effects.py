"""Compares a proposed equation with the catalogue: an equivalent effect makes the equation superfluous, and
the equation may make named causes superfluous.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

from heli_sim.model.effects import EffectSpec

from heli_lab.explain.discover.equation import Equation
from heli_lab.explain.search.candidate import Candidate, may_join, typical_candidate
from heli_lab.explain.search.hypothesis import Hypothesis
from heli_lab.explain.search.model_comparison import ModelComparison
from heli_lab.explain.search.screening import Screening
from heli_lab.explain.thresholds import (
    CANDIDATES_TRIED,
    EXPECTED_REFIT_GAIN,
    MIN_MARGIN,
    SHORTLIST,
    SHORTLIST_SHARE,
    SPLINE_MARGIN,
)


@dataclass
class ListedEffects:
    """Search for an effect of the catalogue that explains the flights as well as an equation does."""

    comparison: ModelComparison  # Estimates models on the flights
    base: Hypothesis  # The model with the named causes, without the equation
    kinds: Mapping[str, EffectSpec]  # Catalogue by effect id
    say: Callable[[str], None]  # Called with the present step in words

    def equivalent_effect(self, equation: Equation, warm_start: Hypothesis, penalty: float) -> str | None:
        """Find an effect of the catalogue that explains all flights as well as an equation does.

        The search may have missed this effect, because disturbances explained its torque. An effect does not
        count if the equation encompasses it, see `encompasses`.

        Effects are refitted in the order of their scores, until no further effect can be good enough.
        """
        # Like a spline, an equation must exceed an effect by a share of its own margin over the base.
        equation_margin = warm_start.log_likelihood - penalty + self.held_out(warm_start)
        lead = SPLINE_MARGIN * (equation_margin - self.base.log_likelihood)
        required_margin = equation_margin - max(MIN_MARGIN, lead)
        # The search ends after enough refits have reached about the gain that their score predicted.
        confirmed_scores = 0
        for effect, start, score in self._possible_effects(equation, warm_start):
            complexity_penalty = self.complexity_penalty(effect)
            if score is not None and (
                confirmed_scores >= SHORTLIST
                or EXPECTED_REFIT_GAIN * score <= complexity_penalty + MIN_MARGIN
            ):
                break
            rival = self.refit(effect, start, warm_start)
            margin = self.margin(rival, effect) + self.held_out(rival)
            if (
                margin > required_margin
                and self.comparison.in_flight(rival)
                and not self.encompasses(warm_start, rival, effect, penalty)
            ):
                return effect.id
            gain = margin + complexity_penalty - self.base.log_likelihood
            confirmed_scores += score is not None and gain >= SHORTLIST_SHARE * score
        return None

    def _possible_effects(
        self, equation: Equation, warm_start: Hypothesis
    ) -> Iterator[tuple[Candidate, Mapping[str, float], float | None]]:
        """Yield effects that may be equivalent, each with start values and its score in nats, the best first.

        Friction that holds an axis has no derivative, and thus no score. It comes first, at its typical size.
        """
        screening = Screening(replace(self.base.estimate, disturbances=warm_start.estimate.disturbances))
        dry_friction = {f"coulomb_friction.{axis}" for axis in _axes_of_equation(equation)}
        for kind in self.eligible_effects:
            if kind.id in dry_friction:
                yield typical_candidate(kind), kind.typical, None
        for scored in screening.effects(self.eligible_effects)[: 2 * SHORTLIST]:
            start = scored.candidate.start_values(scored.coefficients)
            yield scored.candidate, start, scored.log_likelihood_gain

    @property
    def eligible_effects(self) -> list[EffectSpec]:
        """Effects of the catalogue that may be added to the base."""
        return [
            kind
            for kind in self.kinds.values()
            if not kind.baseline and not kind.noise_inputs and may_join(kind.id, self.base.ids, self.kinds)
        ]

    def refit(self, effect: Candidate, start: Mapping[str, float], warm_start: Hypothesis) -> Hypothesis:
        """Estimate the base with one more `effect`.

        The estimation starts from the values `start` and from the disturbances of `warm_start`.
        """
        self.say(f"trying {effect.id} in its place")
        return self.comparison.refit([*self.base.candidates, effect], start, warm_start)

    def margin(self, model: Hypothesis, effect: Candidate) -> float:
        """Return the log-likelihood, in nats, of a `model` with an `effect`, less the effect's penalty.

        The priors of the effect's parameters do not count, because an equation's coefficients may have any
        size, too.
        """
        parameters = [
            (model.values[name], prior)
            for name, prior in effect.effect.priors.items()
            if name in model.values
        ]
        prior_nats = sum(0.5 * ((value - prior.mean) / prior.std) ** 2 for value, prior in parameters)
        return model.log_likelihood + prior_nats - self.complexity_penalty(effect)

    def held_out(self, model: Hypothesis) -> float:
        """Return the log-likelihood ratio of a `model` over the base on the held-out flights, nats.

        It is 0 if no flight is held out.
        """
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
        """Whether an equation encompasses an effect that fits equally well in its place.

        It does if, in a model with both, the equation exceeds its penalty and the effect adds less. This is
        the J test (Davidson and MacKinnon, Econometrica 49 (1981) 781) by likelihoods.
        """
        equation = warm_start.candidates[-1]
        start = {name: rival.values[name] for name in effect.effect.priors if name in rival.values}
        with_both_terms = self.comparison.refit([*self.base.candidates, effect, equation], start, warm_start)

        def gain_over(model: Hypothesis) -> float:
            """Return the gain of the model with both over another model on all flights, nats."""
            fitted = with_both_terms.log_likelihood - model.log_likelihood
            return fitted + self.held_out(with_both_terms) - self.held_out(model)

        equation_gain, effect_gain = gain_over(rival), gain_over(warm_start)
        return equation_gain - penalty > max(MIN_MARGIN, effect_gain - self.complexity_penalty(effect))

    def complexity_penalty(self, effect: Candidate) -> float:
        """Return the complexity penalty of an `effect`, nats.

        It is BIC for its parameters, plus the logarithm of the number of candidates (multiple testing).
        """
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
    axes_or_rotors = (channel.partition(".")[2] for channel in equation.channels)
    return {axis_of_rotors.get(name, name) for name in axes_or_rotors}
