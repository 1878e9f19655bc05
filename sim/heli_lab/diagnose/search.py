"""Stepwise search for causes: forward selection on the flights fitted, then exchange and elimination.

Each round scores all candidates about the current estimate, refits the best, and takes one whose
log-likelihood ratio exceeds its BIC penalty. A spline term (`spline_term.py`) competes in every round: where
it beats every effect refitted over its grid, the cause is not in the catalogue, and the spline stays in its
place, so that the search can go on beside it. Held-out flights have no part in it: they judge what was found.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from heli_sim.model.effect import Stage
from heli_sim.model.effects.kind import EffectKind
from heli_sim.model.parts import AXES

from heli_lab.diagnose import thresholds
from heli_lab.diagnose.absent_terms import tightly_specified_terms
from heli_lab.diagnose.candidate import Candidate, typical_candidate
from heli_lab.diagnose.model_comparison import Hypothesis, ModelComparison
from heli_lab.diagnose.screening import Scored, Screening
from heli_lab.diagnose.search_record import Alternative, Cause, Refit, Round, Search
from heli_lab.threads import parallel_map

_SEARCH_SHARE: Final = 0.9
"""Share of a diagnosis at which its search has ended."""


@dataclass
class _Searcher:
    comparison: ModelComparison
    kinds: Mapping[str, EffectKind]
    say: Callable[[str, float], None]
    refits_left: Callable[[], bool]
    removable: Sequence[EffectKind]
    rounds: list[Round] = field(default_factory=list)
    bases: list[Hypothesis] = field(default_factory=list)
    """What each round began with."""

    def penalty(self, candidate: Candidate, tried: int = 0) -> float:
        """Bayesian information criterion in nats, and the logarithm of the number of candidates tried."""
        free = len(candidate.effect.priors) + sum(
            1 for name in candidate.grid if name not in candidate.effect.priors
        )
        weight = thresholds.SPLINE_COEFFICIENT_WEIGHT if candidate.is_spline else 1.0
        tries = thresholds.CANDIDATES_TRIED + tried
        return 0.5 * weight * free * math.log(self.comparison.rows) + math.log(tries)

    def attempt(self, base: Hypothesis, candidates: Sequence[Candidate], scored_candidate: Scored) -> Refit:
        """Refit the model with one more candidate, at the best value of a parameter that only a grid
        searches.
        """
        scored, *directions = self._on_grid(scored_candidate)
        (first,) = scored
        best = self.comparison.refit(
            [*candidates, first], first.start_values(scored_candidate.coefficients), base
        )
        for further in directions:
            for candidate in further:
                start = {**best.values, **{n: candidate.effect.values[n] for n in candidate.grid}}
                hypothesis = self.comparison.refit([*candidates, candidate], start, base)
                if hypothesis.log_likelihood <= best.log_likelihood:
                    break
                best = hypothesis
        gain = best.log_likelihood - base.log_likelihood
        return Refit(
            best,
            gain,
            self.penalty(scored_candidate.candidate, scored_candidate.tried),
            scored_candidate.log_likelihood_gain,
        )

    def _on_grid(self, scored: Scored) -> list[list[Candidate]]:
        """The candidate; then, where only a grid searches a parameter, those at its larger and at its smaller
        values, to be refitted as long as each is better.
        """
        candidate, kind = scored.candidate, self.kinds.get(scored.candidate.id)
        fixed = [name for name in candidate.grid if name not in candidate.effect.priors]
        if kind is None or len(fixed) != 1:
            return [[candidate]]
        (name,) = fixed
        values = kind.grid_values(1.0)[name]
        warm_start = int(np.argmin(np.abs(np.array(values) - candidate.grid[name])))
        return [
            [
                Candidate(
                    candidate.id,
                    kind.make({**candidate.effect.values, name: v}),
                    candidate.linear_parameters,
                    {**candidate.grid, name: v},
                )
                for v in some
            ]
            for some in ((values[warm_start],), values[warm_start + 1 :], values[:warm_start][::-1])
        ]

    def _accepted(self, refit: Refit) -> bool:
        """Whether it exceeds its penalty, its size is told from nothing, and a moment that was found lies
        within the flight.
        """
        if refit.margin <= thresholds.MIN_MARGIN:
            return False
        if refit.candidate.is_spline:
            return True
        return self.comparison.in_flight(refit.hypothesis) and self._told(refit, refit.candidate)

    def _told(self, refit: Refit, candidate: Candidate) -> bool:
        """Whether the size of one of its candidates, without which it is worse by its margin, is told from
        nothing: by its standard error, or where that tells of one side alone, by the likelihood.
        """
        plain = refit.margin > thresholds.WALD_OVERRIDE_NATS
        return plain or candidate.is_spline or is_significant(refit.hypothesis, candidate, self.kinds)

    def forward(self, hypothesis: Hypothesis) -> tuple[Hypothesis, Screening, bool]:
        """Add causes until none is accepted."""
        while True:
            number = len(self.rounds)
            self.bases.append(hypothesis)
            self.say(f"looking for what is missing, round {number + 1}", 0.1 + 0.6 * (1 - 0.6**number))
            screening = Screening(hypothesis.estimate)
            known = [self.kinds[id_] for id_ in hypothesis.ids if id_ in self.kinds]
            remaining = [
                kind for kind in self.kinds.values() if all(_together(kind, candidate) for candidate in known)
            ]
            screened = screening.effects(remaining)
            splines = screening.splines(number)
            full = len(hypothesis.candidates) >= thresholds.MAX_CAUSES or not self.refits_left()
            refits: list[Refit] = []
            accepted: Refit | None = None
            absent = [] if full else tightly_specified_terms(self.comparison, self.removable, screening)
            screening.release()
            if not full:
                refits, accepted = self.choice(hypothesis, screening, screened, splines, absent)
            self.rounds.append(
                Round(
                    tuple(screened), tuple(splines), tuple(refits), accepted.candidate.id if accepted else ""
                )
            )
            if accepted is None:
                return hypothesis, screening, not full and self.refits_left()
            hypothesis = accepted.hypothesis

    def choice(
        self,
        base: Hypothesis,
        screening: Screening,
        screened: Sequence[Scored],
        splines: Sequence[Scored],
        absent: Sequence[tuple[Candidate, dict[str, float], float]],
    ) -> tuple[list[Refit], Refit | None]:
        """Refit the best of a round, terms that may be `absent` among them; the one to take, None where
        nothing is significant.
        """
        number = len(self.rounds)

        def refit(scored: Scored) -> Refit:
            self.say(f"trying {scored.candidate.id}", 0.1 + 0.6 * (1 - 0.6 ** (number + 0.5)))
            return self.attempt(base, base.candidates, scored)

        best_score = max((scored.log_likelihood_gain for scored in screened), default=0.0)
        remaining, likely, refits = self._worth_a_refit(screened), list[Scored](), list[Refit]()
        # Scores that no refit bears out, as of an encoder at rest, say nothing against those below them.
        while remaining and not any(self._accepted(refit_) for refit_ in refits):
            share = thresholds.SHORTLIST_SHARE * remaining[0].log_likelihood_gain
            some = [scored for scored in remaining if scored.log_likelihood_gain >= share][
                : thresholds.SHORTLIST
            ]
            refits += [refit(scored) for scored in some if self.refits_left()]
            likely += some
            remaining = remaining[len(some) :]
        if not any(self._accepted(refit_) for refit_ in refits):
            dry = self._dry_friction(base, screening, {scored.candidate.id for scored in likely})
            refits += [refit(scored) for scored in dry if self.refits_left()]
            likely += dry
        for gone, start, score in absent:
            if (
                self.refits_left()
                and gone.id not in base.ids
                and score > thresholds.SHORTLIST_SHARE * best_score
            ):
                less = self.comparison.refit([*base.candidates, gone], start, base)
                refits.append(
                    Refit(less, less.log_likelihood - base.log_likelihood, self.penalty(gone), score)
                )
        accepted = [refit_ for refit_ in refits if self._accepted(refit_)]
        best = max(accepted, key=lambda refit_: refit_.margin, default=None)
        curve = splines[0] if splines else None
        needed = max(thresholds.SPLINE_MIN, best.margin if best else 0.0)
        promised = thresholds.EXPECTED_REFIT_GAIN * curve.log_likelihood_gain if curve else 0.0
        if curve is not None and promised > needed and self.refits_left():
            # An effect of the list is not displaced before its like was refitted over its grid.
            channel = curve.candidate.id.split(":")[1]
            known = {scored.candidate.id for scored in likely}
            like = [
                scored
                for scored in screened
                if scored.candidate.id not in known and _acts_on(self.kinds[scored.candidate.id], channel)
            ]
            spline = refit(curve)
            if spline.margin > needed:
                like = [
                    scored for scored in like[: thresholds.LIKE_REFITTED] if scored.log_likelihood_gain > 0.0
                ]
                more = [refit(scored) for scored in like if self.refits_left()]
                refits += more
                accepted += [refit_ for refit_ in more if self._accepted(refit_)]
                best = max(accepted, key=lambda refit_: refit_.margin, default=None)
            refits.append(spline)
            lead = spline.margin - (best.margin if best else 0.0)
            if lead > max(thresholds.SPLINE_MIN, thresholds.SPLINE_MARGIN * spline.margin):
                best = spline
        return sorted(refits, key=lambda refit_: -refit_.margin), best

    def _worth_a_refit(self, screened: Sequence[Scored]) -> list[Scored]:
        """Those that may be significant, the highest score first."""
        return [
            scored
            for scored in screened
            if thresholds.EXPECTED_REFIT_GAIN * scored.log_likelihood_gain
            > self.penalty(scored.candidate, scored.tried) + thresholds.MIN_MARGIN
        ]

    def _dry_friction(self, base: Hypothesis, screening: Screening, known: Collection[str]) -> list[Scored]:
        """Dry friction of its usual size of axes that rest for long: a score is taken where an axis creeps,
        and does not see one that is held.
        """
        references = [linear.reference for linear in screening.filtered.linearised_flights]
        resting = np.concatenate([reference.at_rest[reference.rows] for reference in references]).mean(axis=0)
        scored_ = []
        for axis, share in zip(AXES, resting, strict=True):
            id_ = f"coulomb_friction.{axis}"
            if share > thresholds.HELD_SHARE and id_ in self.kinds and id_ not in {*base.ids, *known}:
                candidate = typical_candidate(self.kinds[id_])
                none = np.zeros(len(candidate.linear_parameters))
                scored_.append(Scored(candidate, 0.0, none, none, 1))
        return scored_

    def exchange(self, final: Hypothesis) -> Hypothesis:
        """Put wider laws in the place of those that they contain, where that is significant."""
        for candidate in final.candidates:
            for kind in self.kinds.values():
                if candidate.id not in kind.contains or kind.id in final.ids or not self.refits_left():
                    continue
                rest = [other for other in final.candidates if other is not candidate]
                if not all(_together(kind, self.kinds[other.id]) for other in rest if other.id in self.kinds):
                    continue
                wider = Candidate(kind.id, kind.make(kind.from_contained(final.values)), (), {})
                refit = self.comparison.refit([*rest, wider], wider.start_values(np.zeros(0)), final)
                gain = refit.log_likelihood - final.log_likelihood
                if gain - self.penalty(wider) + self.penalty(candidate) > thresholds.MIN_MARGIN and all(
                    is_significant(refit, wider, self.kinds, name) for name in kind.size
                ):
                    return self.exchange(refit)
        return final

    def backward(self, final: Hypothesis) -> tuple[Hypothesis, list[Cause]]:
        """Drop what is no longer needed; measure the evidence of the rest, and its alternatives."""
        final, without = self._needed(final)
        held_out = self._held_out(final, without)
        against = min(held_out, key=lambda id_: held_out[id_], default=None)
        if against is not None and held_out[against] < thresholds.HELD_OUT_AGAINST:
            return self.backward(self._instead(final, against, without[against]))
        causes = [
            Cause(
                candidate,
                final.log_likelihood - without[candidate.id].log_likelihood,
                held_out.get(candidate.id),
                self.penalty(candidate),
                self.alternatives(final, candidate, without[candidate.id]),
            )
            for candidate in final.candidates
        ]
        return final, sorted(causes, key=lambda cause: -cause.train)

    def _instead(self, final: Hypothesis, against: str, less: Hypothesis) -> Hypothesis:
        """The model `less`, without a cause that the flights held out speak against. A spline may have
        followed one flight only: what it had displaced comes back, the causes before it and the best of its
        round.
        """
        number = next((n for n, round_ in enumerate(self.rounds) if round_.taken == against), None)
        gone = next(candidate for candidate in final.candidates if candidate.id == against)
        if not gone.is_spline or number is None:
            return less
        displaced = list(self.bases[number].candidates)
        displaced += [refit_.candidate for refit_ in self.rounds[number].refits if self._accepted(refit_)][:1]
        back = [
            candidate for candidate in displaced if not candidate.is_spline and candidate.id not in less.ids
        ]
        if not back:
            return less
        start = {**self.bases[number].values, **less.values}
        return self.comparison.refit([*less.candidates, *back], start, less)

    def _needed(self, final: Hypothesis) -> tuple[Hypothesis, dict[str, Hypothesis]]:
        """The model with the causes alone that are needed, and by each of their ids the model without it."""
        while True:
            every = final.candidates
            without: dict[str, Hypothesis] = {}
            less = final
            for number, candidate in enumerate(every):
                share = 0.75 + 0.1 * number / len(every)
                self.say(f"checking whether {candidate.id} is needed", share)
                rest = [other for other in every if other is not candidate]
                less = self.comparison.refit(rest, None, final) if rest else self.baseline
                gain = final.log_likelihood - less.log_likelihood
                refit = Refit(final, gain, self.penalty(candidate), 0.0)
                if refit.margin <= thresholds.MIN_MARGIN or not self._told(refit, candidate):
                    break
                without[candidate.id] = less
            if len(without) == len(every):
                return final, without
            final = less

    def _held_out(self, final: Hypothesis, without: Mapping[str, Hypothesis]) -> dict[str, float]:
        if not self.comparison.held_out or not without:
            return {}
        every = parallel_map(self.comparison.held_out_estimate, [final, *without.values()])
        whole, *less = (estimate.log_likelihood for estimate in every)
        return {id_: whole - log_likelihood for id_, log_likelihood in zip(without, less, strict=True)}

    def alternatives(
        self, final: Hypothesis, candidate: Candidate, less: Hypothesis
    ) -> tuple[Alternative, ...]:
        """Other effects in the place of one of the final model's, closest first."""
        if candidate.is_spline:
            return ()
        seen = next((r for r in self.rounds if r.taken == candidate.id), None)
        if seen is None:
            return ()
        rest = [other for other in final.candidates if other is not candidate]
        best = max(refit.score for refit in seen.refits)

        def beside_the_rest(refit: Refit) -> bool:
            if refit.score < thresholds.ALTERNATIVE_SHARE * best:
                return False
            # A term of the baseline that was removed is no candidate.
            kind = self.kinds.get(refit.candidate.id)
            return kind is None or all(
                _together(kind, self.kinds[candidate.id]) for candidate in rest if candidate.id in self.kinds
            )

        likely = [
            refit
            for refit in sorted(seen.refits, key=lambda refit: -refit.score)
            if refit.candidate.id not in final.ids
            and not refit.candidate.is_spline
            and (not rest or beside_the_rest(refit))
        ]
        ratios: dict[str, float] = {}
        for refit in likely:
            if len(ratios) >= thresholds.ALTERNATIVES or (rest and not self.refits_left()):
                break
            other = refit.hypothesis
            if rest:
                other = self.comparison.refit([*rest, refit.candidate], refit.hypothesis.values, less)
            if not self.comparison.in_flight(other):
                continue
            ratio = final.log_likelihood - other.log_likelihood
            ratios[refit.candidate.id] = ratio + self.penalty(refit.candidate) - self.penalty(candidate)
        return tuple(
            Alternative(id_, ratio) for id_, ratio in sorted(ratios.items(), key=lambda item: item[1])
        )

    def run(self) -> Search:
        self.say("refitting the baseline", 0.02)
        self.baseline = self.comparison.refit([])
        reached, screening, complete = self.forward(self.baseline)
        final, causes = self.backward(self.exchange(reached))
        if final is not reached:
            screening = Screening(final.estimate)
        return Search(self.baseline, final, tuple(causes), tuple(self.rounds), screening, complete)


def is_significant(
    hypothesis: Hypothesis, candidate: Candidate, kinds: Mapping[str, EffectKind], name: str | None = None
) -> bool:
    """Whether the size of an effect, or its parameter `name`, is told from nothing by two standard errors."""
    kind = kinds.get(candidate.id)
    if kind is None:
        return True
    parameter_vector, estimate = hypothesis.estimate.parameter_vector, hypothesis.estimate
    std = dict(zip(parameter_vector.names, np.sqrt(np.diag(estimate.covariance)), strict=True))
    values = hypothesis.values
    sizes = [size for size in ([name] if name else kind.size) if size in values]
    neutral = kind.neutral
    return not sizes or any(
        abs(values[size] - neutral[size]) > thresholds.NOTHING_STD_ERRORS * std[size] for size in sizes
    )


def _together(kind: EffectKind, other: EffectKind) -> bool:
    """Whether one model may have both: not two laws of how the rotors lag."""
    return kind.goes_with(other) and not (kind.stage == other.stage == Stage.LAG)


def _acts_on(kind: EffectKind, channel: str) -> bool:
    return kind.acts_on == channel or (channel.startswith("thrust") and kind.acts_on in ("thrust", "input"))


def search(
    comparison: ModelComparison,
    kinds: Mapping[str, EffectKind],
    *,
    removable: Sequence[EffectKind] = (),
    say: Callable[[str, float], None] | None = None,
    refits: float = math.inf,
) -> Search:
    """Find what a model lacks; what was found counts also when the work allowed ran out.

    Parameters
    ----------
    removable : sequence of EffectKind
        Kinds that remove terms of the baseline which the rig states closely.
    say : callable, optional
        Called with what is being done, and the share of the work that is done, 0 to 1.
    refits : float
        Refits after which no further cause is tried, those of the elimination that follows included: each
        cause taken is refitted without once.
    """

    def tell(what: str, share: float) -> None:
        # Of the work allowed, what is done is done: whoever reckons the time left finds no more than that.
        if say is not None:
            say(what, max(share, _SEARCH_SHARE * min(1.0, comparison.fits / max(refits, 1.0))))

    def left() -> bool:
        return comparison.fits + sum(bool(round_.taken) for round_ in searcher.rounds) < refits

    searcher = _Searcher(comparison, kinds, tell, left, removable)
    return searcher.run()
