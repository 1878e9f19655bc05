"""An equation against the catalogue: whether an effect is equivalent, and which causes become superfluous."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cached_property

from heli_sim.model.effects import EffectSpec

from heli_lab.diagnose.discover.equation import Equation
from heli_lab.diagnose.search import (
    Candidate,
    Hypothesis,
    ModelComparison,
    Screening,
    may_join,
    typical_candidate,
)
from heli_lab.diagnose.thresholds import (
    CANDIDATES_TRIED,
    EXPECTED_REFIT_GAIN,
    MIN_MARGIN,
    SHORTLIST,
    SHORTLIST_SHARE,
    SPLINE_MARGIN,
)


class ListedEffects:
    """Search for an effect of the catalogue that explains the flights as well as an equation does.

    Parameters
    ----------
    comparison : ModelComparison
        Estimates models on the flights.
    base : Hypothesis
        The model with the named causes, without the equation.
    kinds : Mapping[str, EffectSpec]
        Catalogue by effect id.
    say : callable
        Called with the present step in words.
    """

    def __init__(
        self,
        comparison: ModelComparison,
        base: Hypothesis,
        kinds: Mapping[str, EffectSpec],
        say: Callable[[str], None],
    ) -> None:
        self.comparison, self.base, self.kinds, self.say = comparison, base, kinds, say

    def equivalent_effect(self, equation: Equation, warm_start: Hypothesis, penalty: float) -> str | None:
        """Find an effect that fits all flights as well as an equation, and that the equation does not
        encompass.

        The search may have missed it, because its disturbances replaced what is missing.

        Parameters
        ----------
        warm_start : Hypothesis
            The model with the equation.
        penalty : float
            Complexity penalty of the equation, nats.

        Returns
        -------
        str or None
            Id of the effect; None if there is none.
        """
        # Like a spline, an equation must beat an effect by a share of its own margin.
        margin = warm_start.log_likelihood - penalty + self.held_out(warm_start)
        required = margin - max(MIN_MARGIN, SPLINE_MARGIN * (margin - self.base.log_likelihood))
        screening = Screening(replace(self.base.estimate, disturbances=warm_start.estimate.disturbances))
        remaining = self.remaining

        def is_equivalent(listed: Candidate, start: Mapping[str, float]) -> tuple[bool, float]:
            """Whether an effect is equivalent to the equation, and its margin over all flights [nats]."""
            refitted = self.refit(listed, start, warm_start)
            listed_margin = self.margin(refitted, listed) + self.held_out(refitted)
            fits_as_well = listed_margin > required and self.comparison.in_flight(refitted)
            equivalent = fits_as_well and not self.encompasses(warm_start, refitted, listed, penalty)
            return equivalent, listed_margin

        # Friction that holds an axis has no derivative, so no score shows it.
        dry = {f"coulomb_friction.{axis}" for axis in _axes(equation)}
        for kind in remaining:
            if kind.id in dry and is_equivalent(typical_candidate(kind), kind.typical)[0]:
                return kind.id
        promising = 0
        for scored in screening.effects(remaining)[: 2 * SHORTLIST]:
            complexity_penalty = self.complexity_penalty(scored.candidate)
            if (
                promising >= SHORTLIST
                or EXPECTED_REFIT_GAIN * scored.log_likelihood_gain <= complexity_penalty + MIN_MARGIN
            ):
                break
            equivalent, value = is_equivalent(
                scored.candidate, scored.candidate.start_values(scored.coefficients)
            )
            if equivalent:
                return scored.candidate.id
            gain = value + complexity_penalty - self.base.log_likelihood
            promising += gain >= SHORTLIST_SHARE * scored.log_likelihood_gain
        return None

    @property
    def remaining(self) -> list[EffectSpec]:
        """Effects that may be added to the base."""
        return [
            kind
            for kind in self.kinds.values()
            if not kind.baseline and not kind.noise_inputs and may_join(kind.id, self.base.ids, self.kinds)
        ]

    def refit(self, listed: Candidate, start: Mapping[str, float], warm_start: Hypothesis) -> Hypothesis:
        """Estimate the base with one more effect, `listed`, from the values `start` and the disturbances of
        `warm_start`.
        """
        self.say(f"trying {listed.id} in its place")
        return self.comparison.refit([*self.base.candidates, listed], start, warm_start)

    def margin(self, made: Hypothesis, listed: Candidate) -> float:
        """Log-likelihood, in nats, of the model `made` with the effect `listed`, less the effect's penalty,
        without the priors of its parameters: an equation's coefficients may have any size, too.
        """
        parameters = [
            (made.values[name], prior) for name, prior in listed.effect.priors.items() if name in made.values
        ]
        unusual = sum(0.5 * ((value - prior.mean) / prior.std) ** 2 for value, prior in parameters)
        return made.log_likelihood + unusual - self.complexity_penalty(listed)

    def held_out(self, made: Hypothesis) -> float:
        """Log-likelihood ratio of the model `made` over the base on the held-out flights, nats; 0 without
        any.
        """
        if not self.comparison.held_out:
            return 0.0
        return self.comparison.held_out_estimate(made).log_likelihood - self._base_held_out

    @cached_property
    def _base_held_out(self) -> float:
        return self.comparison.held_out_estimate(self.base).log_likelihood

    def encompasses(
        self, warm_start: Hypothesis, made: Hypothesis, listed: Candidate, penalty: float
    ) -> bool:
        """Whether an equation encompasses an effect that fits equally well in its place.

        It does if, in a model with both, the equation exceeds its penalty and the effect adds less. This is
        the J test (Davidson and MacKinnon, Econometrica 49 (1981) 781) by likelihoods.

        Parameters
        ----------
        warm_start : Hypothesis
            The model with the equation.
        made : Hypothesis
            The model with the effect.
        listed : Candidate
            The effect.
        penalty : float
            Complexity penalty of the equation, nats.
        """
        equation = warm_start.candidates[-1]
        start = {name: made.values[name] for name in listed.effect.priors if name in made.values}
        both = self.comparison.refit([*self.base.candidates, listed, equation], start, warm_start)
        by_equation, by_effect = (
            both.log_likelihood - hypothesis.log_likelihood + self.held_out(both) - self.held_out(hypothesis)
            for hypothesis in (made, warm_start)
        )
        return by_equation - penalty > max(MIN_MARGIN, by_effect - self.complexity_penalty(listed))

    def complexity_penalty(self, listed: Candidate) -> float:
        """Complexity penalty of the effect `listed`, nats: BIC for its parameters, and for multiple
        testing.
        """
        return 0.5 * len(listed.effect.priors) * math.log(self.comparison.rows) + math.log(CANDIDATES_TRIED)

    def without_superfluous(self, with_equation: Hypothesis) -> tuple[Hypothesis, tuple[str, ...]]:
        """Remove causes that are not significant in the model `with_equation`; return it and their ids."""
        final, gone = with_equation, list[str]()
        for candidate in self.base.candidates:
            others = [other for other in final.candidates[:-1] if other.id != candidate.id]
            less = self.comparison.refit([*others, final.candidates[-1]], None, final)
            if final.log_likelihood - less.log_likelihood - self.complexity_penalty(candidate) <= MIN_MARGIN:
                final = less
                gone.append(candidate.id)
        return final, tuple(gone)


def _axes(equation: Equation) -> set[str]:
    """Axes about which an equation acts directly."""
    by_rotors = {"both": "elevation", "difference": "pitch", "front": "pitch", "back": "pitch"}
    places = (channel.partition(".")[2] for channel in equation.channels)
    return {by_rotors.get(place, place) for place in places}
