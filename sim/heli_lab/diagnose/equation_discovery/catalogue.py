"""A law against the catalogue: whether an effect does as well, and which causes the law makes superfluous."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

from heli_sim.model.effects import EffectKind

from heli_lab.diagnose.candidate import Candidate, usual
from heli_lab.diagnose.equation_discovery.law import Law
from heli_lab.diagnose.model_comparison import Comparison, Hypothesis
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
    comparison : Comparison
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
        comparison: Comparison,
        base: Hypothesis,
        kinds: Mapping[str, EffectKind],
        say: Callable[[str], None],
    ) -> None:
        self.comparison, self.base, self.kinds, self.say = comparison, base, kinds, say

    def as_good(self, law: Law, near: Hypothesis, margin: float) -> str | None:
        """Name an effect of the list that does as well in the place of a `law`, None where none does; `near`
        is the model with the law, `margin` its log-likelihood less what it pays.

        While the weather stood for what is missing, the search could not see it.
        """
        # As a spline has to, a law has to be better by a share of what it gains.
        gained = margin - self.base.log_likelihood
        enough = margin - max(AMBIGUOUS, SPLINE_MARGIN * gained)
        screening = Screening(replace(self.base.estimate, weather=near.estimate.weather))
        left = [
            kind
            for kind in self.kinds.values()
            if kind.id not in self.base.ids and not kind.baseline and not kind.noise_inputs
        ]
        # A score is taken where an axis creeps, and does not see one that sticks.
        dry = {f"coulomb_friction.{axis}" for axis in _axes(law)}
        for kind in left:
            if kind.id in dry and self.margin_of(usual(kind), kind.typical, near) > enough:
                return kind.id
        kept = 0
        for one in screening.effects(left)[: 2 * SHORTLIST]:
            price = self.price(one.candidate)
            if kept >= SHORTLIST or EXPECTED_REFIT_GAIN * one.log_likelihood_gain <= price + MIN_MARGIN:
                break
            listed = self.margin_of(one.candidate, one.candidate.start_values(one.coefficients), near)
            if listed > enough:
                return one.candidate.id
            gain = listed + price - self.base.log_likelihood
            kept += gain >= LAW_KEPT_SHARE * one.log_likelihood_gain
        return None

    def margin_of(self, listed: Candidate, start: Mapping[str, float], near: Hypothesis) -> float:
        """Log-likelihood, less its price, of the base with one more effect, `listed`, estimated from `start`
        and from the weather of the model `near`; that its numbers are unusual counts for nothing, as a law's
        may have any size.
        """
        self.say(f"trying {listed.id} in its place")
        made = self.comparison.refit([*self.base.candidates, listed], start, near)
        own = [
            (made.values[name], prior) for name, prior in listed.effect.priors.items() if name in made.values
        ]
        unusual = sum(0.5 * ((value - prior.mean) / prior.std) ** 2 for value, prior in own)
        return made.log_likelihood + unusual - self.price(listed)

    def price(self, listed: Candidate) -> float:
        """What an effect of the catalogue pays: BIC for its numbers, and for the list."""
        return 0.5 * len(listed.effect.priors) * math.log(self.comparison.rows) + math.log(CANDIDATES_TRIED)

    def without_superfluous(self, with_law: Hypothesis) -> tuple[Hypothesis, tuple[str, ...]]:
        """The model `with_law`, without causes that the likelihood does not miss beside it; their ids."""
        final, gone = with_law, list[str]()
        for one in self.base.candidates:
            rest = [other for other in final.candidates[:-1] if other.id != one.id]
            less = self.comparison.refit([*rest, final.candidates[-1]], None, final)
            if final.log_likelihood - less.log_likelihood - self.price(one) <= MIN_MARGIN:
                final = less
                gone.append(one.id)
        return final, tuple(gone)


def _axes(law: Law) -> set[str]:
    """Axes about which a law acts first."""
    by_rotors = {"both": "elevation", "difference": "pitch", "front": "pitch", "back": "pitch"}
    places = (channel.partition(".")[2] for channel in law.channels)
    return {by_rotors.get(place, place) for place in places}
