"""Finds causes: forward, one effect after the other, each paid for and confirmed on other flights; then back.

A spline term stands in every round beside the catalogue. Where one predicts clearly better than
every effect, the cause is off the list, and the pattern is kept in its place so that the search can go on.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from heli_sim.model.effects.kind import EffectKind

from heli_lab.diagnose.absent_terms import without_absent_terms
from heli_lab.diagnose.candidate import Candidate, Regressors
from heli_lab.diagnose.model_comparison import Comparison, Hypothesis
from heli_lab.diagnose.noise_model import MOST_ROUNDS, DisturbanceModel, InnovationsFilter, fit_disturbance
from heli_lab.diagnose.screening import Scored, Screening, answers, spread
from heli_lab.diagnose.search_record import MIN_REDUCTION, PLAIN, SETTLED, Cause, Refit, Rival, Round, Search
from heli_lab.errors import IdentifyError
from heli_lab.identify import Fit

MAX_CAUSES: Final = 6
NOTHING_LEFT: Final = 1.012
"""Normalised error, on all flights, below which nothing is worth a fit."""
RIVAL: Final = 0.5
"""Share of the best score that makes a rival close."""
SCREENED: Final = 12
"""Effects whose scores are weighed against chance in a round, at most."""
SCREENED_SPLINES: Final = 12
"""The same of patterns."""
SHORTLIST: Final = 3
"""Effects that are refitted in a round, at most."""
SECOND_CHANCE: Final = 2
"""Further effects that are refitted where none of the shortlist is accepted, at most."""
SECOND_LEAST: Final = 0.3
"""Share of the best first-order score that they must have."""
WORTH_A_FIT: Final = 0.25
"""Share of the best score that an effect must reach to be refitted."""
SPLINE_MARGIN: Final = 0.2
"""Share by which a pattern must be ahead of the best effect to be taken in its place."""
SPLINE_MIN: Final = 20.0
MIN_COLOURED: Final = 6.0
"""Logarithm of the likelihood ratio, torques that wander by chance allowed, over an effect's price."""
PLAINLY: Final = 60.0
"""A gain further than this from its price need not be known any better."""
WEIGHED: Final = 3
"""Effects that are weighed against chance in a round, at most."""
AMBIGUOUS: Final = 6.0
"""Two candidates are not told apart when the logarithm of their likelihood ratio is below this."""
_EDGE_s: Final = 1.0
"""A moment this close to a flight's end changes nothing that other numbers could not."""


@dataclass
class _Searcher:
    comparison: Comparison
    kinds: Mapping[str, EffectKind]
    say: Callable[[str, float], None]
    until_s: float
    removable: Sequence[EffectKind]
    rounds: list[Round] = field(default_factory=list)
    colours: dict[int, tuple[Hypothesis, DisturbanceModel, InnovationsFilter, int]] = field(
        default_factory=dict
    )

    def out_of_time(self) -> bool:
        return time.perf_counter() > self.until_s

    def penalty(self, candidate: Candidate, tried: int) -> float:
        """Bayesian information criterion, and the logarithm of what was tried."""
        rows = sum(len(record.t_s) for record in self.comparison.train) / 5.0
        free = len(candidate.effect.priors) + sum(
            1 for name in candidate.scanned if name not in candidate.effect.priors
        )
        if candidate.is_spline:
            # Their points are held by priors, and neighbours move together.
            return 0.25 * free * math.log(rows) + math.log(tried)
        return 0.5 * free * math.log(rows) + math.log(tried)

    def attempt(
        self, base: Hypothesis, candidates: Sequence[Candidate], one: Scored, score: float
    ) -> Refit | None:
        best: Hypothesis | None = None
        for candidate in self._places(one):
            start = {**base.fit.values, **candidate.started(one.answer.size)}
            if best is not None:
                start = {**best.fit.values, **{n: candidate.effect.values[n] for n in candidate.scanned}}
            try:
                hypothesis = self.comparison.refit([*candidates, candidate], start)
            except (IdentifyError, np.linalg.LinAlgError):
                break
            if best is not None and self.comparison.evidence(hypothesis, best).raw <= 0.0:
                break
            best = hypothesis
        if best is None or not self._in_flight(best.fit, one.candidate):
            return None
        penalty = self.penalty(one.candidate, 60 + one.tried)
        return Refit(best, self.comparison.evidence(best, base), penalty, score)

    def _places(self, one: Scored) -> list[Candidate]:
        """The candidate, then its further places that no descent finds, as long as each is better."""
        candidate, kind = one.candidate, self.kinds.get(one.candidate.id)
        fixed = [name for name in candidate.scanned if name not in candidate.effect.priors]
        if kind is None or len(fixed) != 1:
            return [candidate]
        (name,) = fixed
        values = kind.grid_values(1.0)[name]
        if len(values) < 3:
            return [candidate]
        near = int(np.argmin(np.abs(np.array(values) - candidate.scanned[name])))
        return [
            Candidate(
                candidate.id,
                kind.make({**candidate.effect.values, name: v}),
                candidate.size,
                {**candidate.scanned, name: v},
            )
            for v in (values[near], *values[near + 1 :])
        ]

    def _in_flight(self, fit: Fit, candidate: Candidate) -> bool:
        """Whether a moment that was found lies within the flight."""
        last_s = max(float(record.t_s[-1] - record.t_s[0]) for record in self.comparison.train)
        moments = [fit.values[q.name] for q in candidate.effect.parameters if q.name.endswith("_at_s")]
        return all(_EDGE_s < moment < last_s - _EDGE_s for moment in moments)

    def shortlist(
        self, base: Hypothesis, screened: Sequence[Scored], splines: Sequence[Scored]
    ) -> list[tuple[Scored, float]]:
        """Candidates that are worth a refit, each with its score beside chance, the best first."""
        net_evidence = [one for one in screened if one.answer.gain > 0.0][:SCREENED]
        curves = [one for one in splines if one.answer.gain > SPLINE_MIN][:SCREENED_SPLINES]
        every = [*net_evidence, *curves]
        if not every:
            return []
        disturbance = self.disturbance(base)
        innovations_filter = self.colours[id(base)][2]
        candidates = [one.candidate for one in every]
        gains = innovations_filter.gains(
            disturbance,
            answers([Regressors(tangent) for tangent in innovations_filter.tangents], candidates),
            [max(1, len(candidate.size)) for candidate in candidates],
            [spread(candidate) for candidate in candidates],
        )
        scored = sorted(zip(every, gains, strict=True), key=lambda one: -one[1])
        # A first-order score may be half of what a refit finds.
        effects = [
            (one, gain)
            for one, gain in scored
            if not one.candidate.is_spline and gain > 0.5 * self.penalty(one.candidate, 60 + one.tried)
        ]
        least = WORTH_A_FIT * effects[0][1] if effects else 0.0
        chosen = [one for one in effects if one[1] >= least][:SHORTLIST]
        if net_evidence and all(one is not net_evidence[0] for one, _ in chosen):
            # What bends the flight so much that nothing is linear any more is seen better without the filter.
            chosen = [*chosen[: SHORTLIST - 1], next(one for one in scored if one[0] is net_evidence[0])]
        best = effects[0][1] if effects else 0.0
        curve = next((one for one in scored if one[0].candidate.is_spline), None)
        if curve and curve[1] > max(SPLINE_MIN, best, self.penalty(curve[0].candidate, len(splines))):
            chosen.append(curve)
        return chosen

    def forward(self, hypothesis: Hypothesis) -> tuple[Hypothesis, Screening, bool]:
        while True:
            number = len(self.rounds)
            self.say(f"looking for what is missing, round {number + 1}", 0.1 + 0.6 * (1 - 0.6**number))
            screening = Screening(hypothesis.fit)
            left = [kind for id_, kind in self.kinds.items() if id_ not in hypothesis.ids]
            screened = screening.effects(left)
            splines = screening.splines(number)
            steps: list[Refit] = []
            full = len(hypothesis.candidates) >= MAX_CAUSES or self.out_of_time()
            shortlist = (
                [] if full or _nothing_left(hypothesis) else self.shortlist(hypothesis, screened, splines)
            )
            for one, score in shortlist:
                # No curve is taken in the place of an effect that leaves nothing.
                if _settled(steps) and (one.candidate.is_spline or score < RIVAL * steps[0].linear):
                    continue
                self.tried(steps, hypothesis, one, score)
            steps, taken = self.choice(hypothesis, steps)
            if taken is None and shortlist:
                # What is worth most of all may be worth nothing yet, beside something larger.
                known = {one.candidate.id for one, _ in shortlist}
                others = [one for one in screened if one.candidate.id not in known][:SECOND_CHANCE]
                for one in others:
                    if one.answer.gain > SECOND_LEAST * screened[0].answer.gain:
                        self.tried(steps, hypothesis, one, 0.0)
                steps, taken = self.choice(hypothesis, steps)
            self.rounds.append(
                Round(tuple(screened), tuple(splines), tuple(steps), taken.candidate.id if taken else "")
            )
            if taken is None:
                return hypothesis, screening, not full
            hypothesis = taken.hypothesis

    def disturbance(
        self, hypothesis: Hypothesis, near: Hypothesis | None = None, rounds: int = 1
    ) -> DisturbanceModel:
        """Random torques that make all flights likeliest under a hypothesis."""
        known = self.colours.get(id(hypothesis))
        if known is None or known[3] < rounds:
            beside = known or (self.colours.get(id(near)) if near is not None else None)
            found = fit_disturbance(self.comparison, hypothesis, beside[1] if beside else None, rounds)
            self.colours[id(hypothesis)] = hypothesis, *found, rounds
        return self.colours[id(hypothesis)][1]

    def weighed(self, base: Hypothesis, step: Refit) -> Refit:
        """The candidate with what it has over chance."""
        for rounds in (1, MOST_ROUNDS):
            before = self.disturbance(base, rounds=rounds).likelihood
            gain = self.disturbance(step.hypothesis, base, rounds).likelihood - before
            # A gust that remains pulls the numbers of both models; once is not enough then.
            if gain < step.penalty - PLAINLY or (
                gain > step.penalty + PLAINLY and step.evidence.variance_reduction > PLAIN
            ):
                break
        return replace(step, fit_disturbance=gain)

    def tried(self, steps: list[Refit], base: Hypothesis, one: Scored, score: float) -> None:
        """Refit one more candidate, while there is time."""
        if self.out_of_time() and steps:
            return
        number = len(self.rounds)
        self.say(f"trying {one.candidate.id}", 0.1 + 0.6 * (1 - 0.6 ** (number + 0.5)))
        step = self.attempt(base, base.candidates, one, score)
        if step is not None:
            steps.append(step)

    def choice(self, base: Hypothesis, steps: Sequence[Refit]) -> tuple[list[Refit], Refit | None]:
        """The best effect that chance does not imitate, or a pattern that is clearly ahead of it."""
        steps = sorted(steps, key=lambda step: -step.net_evidence)
        effects = [step for step in steps if step.accepted and not step.candidate.is_spline]
        if effects and effects[0].settled:
            return steps, effects[0]
        effects = [step for step in steps if _counts(step, steps)]
        splines = [step for step in steps if step.accepted and step.candidate.is_spline][:1]
        known = {id(step): self.weighed(base, step) for step in (*effects[:WEIGHED], *splines)}
        ahead = [known[id(s)] for s in effects[:WEIGHED] if known[id(s)].margin > MIN_COLOURED]
        best = max(ahead, key=lambda step: step.margin, default=None)
        for spline_term in (known[id(step)] for step in splines):
            margin = spline_term.margin - (best.margin if best else 0.0)
            if margin > max(SPLINE_MIN, SPLINE_MARGIN * spline_term.margin):
                best = spline_term
        return [known.get(id(step), step) for step in steps], best

    def backward(self, final: Hypothesis) -> tuple[Hypothesis, list[Cause]]:
        """Drop what is not needed any more; measure what the rest is worth, and its rivals."""
        number = 0
        without: dict[str, Hypothesis] = {}
        while number < len(final.candidates):
            candidate = final.candidates[number]
            self.say(
                f"checking whether {candidate.id} is needed", 0.75 + 0.1 * number / len(final.candidates)
            )
            rest = [other for other in final.candidates if other is not candidate]
            less = self.comparison.refit(rest, final.fit.values) if rest else self.baseline
            step = Refit(final, self.comparison.evidence(final, less), self.penalty(candidate, 60), 0.0)
            seen = next((one.steps for one in self.rounds if one.taken == candidate.id), ())
            needed = step.accepted or _counts(step, seen)
            if needed and not step.settled:
                step = self.weighed(less, step)
            if not (needed and step.margin > MIN_COLOURED) and not self.out_of_time():
                final, number = less, 0
                without.clear()
                continue
            without[candidate.id] = less
            number += 1
        found = [
            Cause(
                candidate,
                self.comparison.evidence(final, without[candidate.id]),
                self.penalty(candidate, 60),
                self.rivals(final, candidate, without[candidate.id]),
            )
            for candidate in final.candidates
        ]
        return final, sorted(found, key=lambda one: -one.evidence.total)

    def rivals(self, final: Hypothesis, candidate: Candidate, less: Hypothesis) -> tuple[Rival, ...]:
        rivals: dict[str, float] = {}
        seen = next((r for r in self.rounds if r.taken == candidate.id), None)
        if seen is None:
            return ()
        rest = [other for other in final.candidates if other is not candidate]
        best = max(step.linear for step in seen.steps)
        for step in sorted(seen.steps, key=lambda step: -step.linear):
            if (
                step.candidate.id == candidate.id
                or step.candidate.id in final.ids
                or step.candidate.is_spline
            ):
                continue
            if len(rest) == 0:
                other = step
            elif self.out_of_time() or rivals or step.linear < 0.2 * best:
                continue
            else:
                scored = next(one for one in seen.screened if one.candidate.id == step.candidate.id)
                attempted = self.attempt(less, rest, scored, step.linear)
                if attempted is None:
                    continue
                other = attempted
            ahead = self.comparison.evidence(final, other.hypothesis).total
            rivals[step.candidate.id] = ahead + self.penalty(step.candidate, 60) - self.penalty(candidate, 60)
        return tuple(Rival(id_, behind) for id_, behind in sorted(rivals.items(), key=lambda one: one[1]))

    def run(self) -> Search:
        self.say("refitting the baseline", 0.02)
        self.baseline = self.comparison.refit([])
        whole = without_absent_terms(self.comparison, self.baseline, self.removable)
        reached, screening, complete = self.forward(whole)
        final, found = self.backward(reached)
        if final is not reached:
            screening = Screening(final.fit)
        chance = None
        if min(final.train.normalised, final.held.normalised) >= SETTLED:
            self.say("weighing what remains against chance", 0.88)
            self.disturbance(final, self.baseline, MOST_ROUNDS)
            chance = self.colours[id(final)][1:3]
        return Search(self.baseline, final, tuple(found), tuple(self.rounds), screening, complete, chance)


def _counts(step: Refit, beside: Sequence[Refit]) -> bool:
    """Whether it is an effect that is accepted, or one that is not told apart from such a one."""
    if step.candidate.is_spline or step.accepted:
        return not step.candidate.is_spline
    if step.evidence.train <= step.penalty or step.evidence.variance_reduction < MIN_REDUCTION:
        return False
    # No threshold decides between two of these: lag and delay are often such.
    least = step.evidence.total + AMBIGUOUS
    return any(least > one.evidence.total for one in beside if one.accepted and not one.candidate.is_spline)


def _nothing_left(hypothesis: Hypothesis) -> bool:
    return max(hypothesis.train.normalised, hypothesis.held.normalised) < NOTHING_LEFT


def _settled(steps: Sequence[Refit]) -> bool:
    """Whether a candidate leaves nothing but rounding."""
    return any(step.accepted and not step.candidate.is_spline and step.leaves < SETTLED for step in steps)


def search(
    comparison: Comparison,
    kinds: Mapping[str, EffectKind],
    *,
    removable: Sequence[EffectKind] = (),
    say: Callable[[str, float], None] | None = None,
    seconds: float = math.inf,
) -> Search:
    """Find what a model lacks.

    Parameters
    ----------
    comparison : Comparison
        Flights, rig and model.
    kinds : Mapping[str, EffectKind]
        Effects to try.
    removable : sequence of EffectKind
        Kinds that take away terms of the baseline which the rig states closely.
    say : callable, optional
        Told what is being done, and which share of the work is.
    seconds : float
        Most time.

    Returns
    -------
    Search
        What was found, also when the time ran out.
    """
    until_s = time.perf_counter() + seconds
    return _Searcher(comparison, kinds, say or (lambda _what, _share: None), until_s, removable).run()
