"""A law against the catalogue: whether an effect does as well, and which causes the law makes superfluous."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cached_property

from heli_sim.model.effects import EffectKind

from heli_lab.diagnose.candidate import Candidate, typical_candidate
from heli_lab.diagnose.equation_discovery.equation import Equation
from heli_lab.diagnose.model_comparison import Hypothesis, ModelComparison
from heli_lab.diagnose.screening import Screening
from heli_lab.diagnose.thresholds import (
    AMBIGUOUS,
    CANDIDATES_TRIED,
    EXPECTED_REFIT_GAIN,
    LAW_KEPT_SHARE,
    MIN_MARGIN,
    SHORTLIST,
    SPLINE_MARGIN,
)


class Catalogue:
    """Effects of the list beside, or in the place of, a law that is proposed.

    Parameters
    ----------
    comparison : ModelComparison
        The flights.
    base : Hypothesis
        The model with the causes that were named.
    kinds : Mapping[str, EffectKind]
        The list.
    say : callable
        Called with what is being done.
    """

    def __init__(
        self,
        comparison: ModelComparison,
        base: Hypothesis,
        kinds: Mapping[str, EffectKind],
        say: Callable[[str], None],
    ) -> None:
        self.comparison, self.base, self.kinds, self.say = comparison, base, kinds, say

    def equivalent_effect(self, equation: Equation, warm_start: Hypothesis, penalty: float) -> str | None:
        """Name a listed effect that fits all flights as well as the `equation` does, and that the equation
        does not encompass; None where none does. `warm_start` is the model with it, `penalty` what it
        pays.

        While the weather stood for what is missing, the search could not see it.
        """
        # As a spline has to, a law has to be better by a share of what it gains.
        margin = warm_start.log_likelihood - penalty + self.held_out(warm_start)
        enough = margin - max(AMBIGUOUS, SPLINE_MARGIN * (margin - self.base.log_likelihood))
        screening = Screening(replace(self.base.estimate, disturbances=warm_start.estimate.disturbances))
        remaining = [
            kind
            for kind in self.kinds.values()
            if kind.id not in self.base.ids and not kind.baseline and not kind.noise_inputs
        ]

        def does(listed: Candidate, start: Mapping[str, float]) -> tuple[bool, float]:
            made = self.refit(listed, start, warm_start)
            value = self.margin(made, listed) + self.held_out(made)
            equal = value > enough and self.comparison.in_flight(made)
            return equal and not self.encompasses(warm_start, made, listed, penalty), value

        # A score is taken where an axis creeps, and does not see one that sticks.
        dry = {f"coulomb_friction.{axis}" for axis in _axes(equation)}
        for kind in remaining:
            if kind.id in dry and does(typical_candidate(kind), kind.typical)[0]:
                return kind.id
        kept = 0
        for scored in screening.effects(remaining)[: 2 * SHORTLIST]:
            complexity_penalty = self.complexity_penalty(scored.candidate)
            if (
                kept >= SHORTLIST
                or EXPECTED_REFIT_GAIN * scored.log_likelihood_gain <= complexity_penalty + MIN_MARGIN
            ):
                break
            instead, value = does(scored.candidate, scored.candidate.start_values(scored.coefficients))
            if instead:
                return scored.candidate.id
            gain = value + complexity_penalty - self.base.log_likelihood
            kept += gain >= LAW_KEPT_SHARE * scored.log_likelihood_gain
        return None

    def refit(self, listed: Candidate, start: Mapping[str, float], warm_start: Hypothesis) -> Hypothesis:
        """Estimate the base with one more effect, `listed`, from `start` and the weather of `warm_start`."""
        self.say(f"trying {listed.id} in its place")
        return self.comparison.refit([*self.base.candidates, listed], start, warm_start)

    def margin(self, made: Hypothesis, listed: Candidate) -> float:
        """Log-likelihood of a model `made` with an effect, less its price; that the effect's numbers are
        unusual counts for nothing, as a law's may have any size.
        """
        parameters = [
            (made.values[name], prior) for name, prior in listed.effect.priors.items() if name in made.values
        ]
        unusual = sum(0.5 * ((value - prior.mean) / prior.std) ** 2 for value, prior in parameters)
        return made.log_likelihood + unusual - self.complexity_penalty(listed)

    def held_out(self, made: Hypothesis) -> float:
        """What a model gains over the base on the flights held out, nats; 0 without any."""
        if not self.comparison.held_out:
            return 0.0
        return self.comparison.held_out_estimate(made).log_likelihood - self._base_held_out

    @cached_property
    def _base_held_out(self) -> float:
        return self.comparison.held_out_estimate(self.base).log_likelihood

    def encompasses(
        self, warm_start: Hypothesis, made: Hypothesis, listed: Candidate, penalty: float
    ) -> bool:
        """Whether a law is worth its `penalty` beside an effect, `listed`, that does as well in its place,
        and more than the effect is worth beside the law: Davidson and MacKinnon, Econometrica 49 (1981) 781,
        by likelihoods. `warm_start` is the model with the law, `made` the one with the effect.
        """
        equation = warm_start.candidates[-1]
        start = {name: made.values[name] for name in listed.effect.priors if name in made.values}
        both = self.comparison.refit([*self.base.candidates, listed, equation], start, warm_start)
        of_law, of_effect = (
            both.log_likelihood - hypothesis.log_likelihood + self.held_out(both) - self.held_out(hypothesis)
            for hypothesis in (made, warm_start)
        )
        return of_law - penalty > max(AMBIGUOUS, of_effect - self.complexity_penalty(listed))

    def complexity_penalty(self, listed: Candidate) -> float:
        """What an effect of the catalogue pays: BIC for its numbers, and for the list."""
        return 0.5 * len(listed.effect.priors) * math.log(self.comparison.rows) + math.log(CANDIDATES_TRIED)

    def without_superfluous(self, with_law: Hypothesis) -> tuple[Hypothesis, tuple[str, ...]]:
        """The model `with_law`, without causes that the likelihood does not miss beside it; their ids."""
        final, gone = with_law, list[str]()
        for candidate in self.base.candidates:
            rest = [other for other in final.candidates[:-1] if other.id != candidate.id]
            less = self.comparison.refit([*rest, final.candidates[-1]], None, final)
            if final.log_likelihood - less.log_likelihood - self.complexity_penalty(candidate) <= MIN_MARGIN:
                final = less
                gone.append(candidate.id)
        return final, tuple(gone)


def _axes(equation: Equation) -> set[str]:
    """Axes about which a law acts first."""
    by_rotors = {"both": "elevation", "difference": "pitch", "front": "pitch", "back": "pitch"}
    places = (channel.partition(".")[2] for channel in equation.channels)
    return {by_rotors.get(place, place) for place in places}
