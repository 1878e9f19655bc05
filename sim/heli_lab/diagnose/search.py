"""Stepwise search for causes: forward selection, confirmed on held-out flights, then backward elimination.

Each round scores all candidates about the current model, refits the best, and takes one whose log-likelihood
ratio exceeds its BIC penalty, white and coloured. A spline term (`spline_term.py`) competes in every round.
Where it predicts clearly better than every effect, the cause is not in the catalogue; the spline then stays
in its place, so that the search can go on beside it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from heli_sim.model.effects.kind import EffectKind

from heli_lab.diagnose import thresholds
from heli_lab.diagnose.absent_terms import without_absent_terms
from heli_lab.diagnose.candidate import Candidate, Regressors
from heli_lab.diagnose.model_comparison import Comparison, Hypothesis
from heli_lab.diagnose.noise_model import MAX_RELINEARISATIONS, DisturbanceFit, fit_disturbance
from heli_lab.diagnose.screening import Scored, Screening, coefficient_std, responses
from heli_lab.diagnose.search_record import Alternative, Cause, Refit, Round, Search
from heli_lab.errors import IdentifyError
from heli_lab.identify import Fit


@dataclass
class _Searcher:
    comparison: Comparison
    kinds: Mapping[str, EffectKind]
    say: Callable[[str, float], None]
    until_s: float
    removable: Sequence[EffectKind]
    rounds: list[Round] = field(default_factory=list)
    disturbances: dict[Hypothesis, DisturbanceFit] = field(default_factory=dict)
    """Coloured-noise models that were estimated; hypotheses are compared by identity."""

    def out_of_time(self) -> bool:
        return time.perf_counter() > self.until_s

    def penalty(self, candidate: Candidate, tried: int = thresholds.CANDIDATES_TRIED) -> float:
        """Bayesian information criterion in nats, and the logarithm of the number of candidates tried."""
        rows = sum(len(record.t_s) for record in self.comparison.train) / thresholds.INDEPENDENT_SAMPLES_EVERY
        free = len(candidate.effect.priors) + sum(
            1 for name in candidate.grid if name not in candidate.effect.priors
        )
        weight = thresholds.SPLINE_COEFFICIENT_WEIGHT if candidate.is_spline else 1.0
        return 0.5 * weight * free * math.log(rows) + math.log(tried)

    def attempt(
        self, base: Hypothesis, candidates: Sequence[Candidate], one: Scored, score: float
    ) -> Refit | None:
        """Refit the model with one more candidate, at the best value of a parameter that only a grid
        searches.
        """
        best: Hypothesis | None = None
        for candidate in self._on_grid(one):
            start = {**base.fit.values, **candidate.start_values(one.result.coefficients)}
            if best is not None:
                start = {**best.fit.values, **{n: candidate.effect.values[n] for n in candidate.grid}}
            try:
                hypothesis = self.comparison.refit([*candidates, candidate], start)
            except (IdentifyError, np.linalg.LinAlgError):
                break
            if best is not None and self.comparison.evidence(hypothesis, best).iid <= 0.0:
                break
            best = hypothesis
        if best is None or not self._in_flight(best.fit, one.candidate):
            return None
        penalty = self.penalty(one.candidate, thresholds.CANDIDATES_TRIED + one.tried)
        return Refit(best, self.comparison.evidence(best, base), penalty, score)

    def _on_grid(self, one: Scored) -> list[Candidate]:
        """The candidate, then the further values of its grid, to be refitted as long as each is better."""
        candidate, kind = one.candidate, self.kinds.get(one.candidate.id)
        fixed = [name for name in candidate.grid if name not in candidate.effect.priors]
        if kind is None or len(fixed) != 1:
            return [candidate]
        (name,) = fixed
        values = kind.grid_values(1.0)[name]
        if len(values) < 3:
            return [candidate]
        near = int(np.argmin(np.abs(np.array(values) - candidate.grid[name])))
        return [
            Candidate(
                candidate.id,
                kind.make({**candidate.effect.values, name: v}),
                candidate.linear_parameters,
                {**candidate.grid, name: v},
            )
            for v in (values[near], *values[near + 1 :])
        ]

    def _in_flight(self, fit: Fit, candidate: Candidate) -> bool:
        """Whether a moment that was found lies within the flight."""
        last_s = max(float(record.t_s[-1] - record.t_s[0]) for record in self.comparison.train)
        moments = [fit.values[q.name] for q in candidate.effect.parameters if q.name.endswith("_at_s")]
        return all(thresholds.EVENT_EDGE_s < moment < last_s - thresholds.EVENT_EDGE_s for moment in moments)

    def shortlist(
        self, base: Hypothesis, screened: Sequence[Scored], splines: Sequence[Scored]
    ) -> list[tuple[Scored, float]]:
        """Candidates to refit, each with its score under the coloured-noise model, the best first."""
        effects = [one for one in screened if one.result.log_likelihood_gain > 0.0][: thresholds.SCREENED]
        curves = [one for one in splines if one.result.log_likelihood_gain > thresholds.SPLINE_MIN][
            : thresholds.SCREENED
        ]
        every = [*effects, *curves]
        if not every:
            return []
        disturbance = self.disturbance(base)
        candidates = [one.candidate for one in every]
        scores = disturbance.innovations_filter.score(
            disturbance.model,
            responses([Regressors(of) for of in disturbance.innovations_filter.linearisations], candidates),
            [max(1, len(candidate.linear_parameters)) for candidate in candidates],
            [coefficient_std(candidate) for candidate in candidates],
        )
        scored = sorted(zip(every, scores, strict=True), key=lambda one: -one[1])
        likely = [
            (one, score)
            for one, score in scored
            if not one.candidate.is_spline
            and thresholds.EXPECTED_REFIT_GAIN * score
            > self.penalty(one.candidate, thresholds.CANDIDATES_TRIED + one.tried)
        ]
        best = likely[0][1] if likely else 0.0
        chosen = [one for one in likely if one[1] >= thresholds.SHORTLIST_SHARE * best][
            : thresholds.SHORTLIST
        ]
        if effects and all(one is not effects[0] for one, _ in chosen):
            # Where the model is so far off that linearisation fails, the white-noise score ranks better.
            chosen = [
                *chosen[: thresholds.SHORTLIST - 1],
                next(one for one in scored if one[0] is effects[0]),
            ]
        curve = next((one for one in scored if one[0].candidate.is_spline), None)
        if curve and curve[1] > max(
            thresholds.SPLINE_MIN, best, self.penalty(curve[0].candidate, len(splines))
        ):
            chosen.append(curve)
        return chosen

    def forward(self, hypothesis: Hypothesis) -> tuple[Hypothesis, Screening, bool]:
        """Add causes until none is accepted."""
        while True:
            number = len(self.rounds)
            self.say(f"looking for what is missing, round {number + 1}", 0.1 + 0.6 * (1 - 0.6**number))
            screening = Screening(hypothesis.fit)
            left = [kind for id_, kind in self.kinds.items() if id_ not in hypothesis.ids]
            screened = screening.effects(left)
            splines = screening.splines(number)
            refits: list[Refit] = []
            full = len(hypothesis.candidates) >= thresholds.MAX_CAUSES or self.out_of_time()
            shortlist = (
                [] if full or _nothing_left(hypothesis) else self.shortlist(hypothesis, screened, splines)
            )
            for one, score in shortlist:
                # Once an effect has reached the noise floor, only a close alternative is worth a refit.
                if _at_noise_floor(refits) and (
                    one.candidate.is_spline or score < thresholds.CLOSE_ALTERNATIVE * refits[0].score
                ):
                    continue
                self.try_refit(refits, hypothesis, one, score)
            refits, taken = self.choice(hypothesis, refits)
            if taken is None and shortlist:
                # Under coloured noise an effect may gain nothing yet beside a larger one that is still
                # missing.
                known = {one.candidate.id for one, _ in shortlist}
                others = [one for one in screened if one.candidate.id not in known][
                    : thresholds.SECOND_CHANCE
                ]
                least = thresholds.SECOND_CHANCE_SHARE * screened[0].result.log_likelihood_gain
                for one in others:
                    if one.result.log_likelihood_gain > least:
                        self.try_refit(refits, hypothesis, one, 0.0)
                refits, taken = self.choice(hypothesis, refits)
            self.rounds.append(
                Round(tuple(screened), tuple(splines), tuple(refits), taken.candidate.id if taken else "")
            )
            if taken is None:
                return hypothesis, screening, not full
            hypothesis = taken.hypothesis

    def disturbance(
        self, hypothesis: Hypothesis, near: Hypothesis | None = None, relinearisations: int = 1
    ) -> DisturbanceFit:
        """Coloured-noise model of a hypothesis, started from that of a near one."""
        known = self.disturbances.get(hypothesis)
        if known is None or known.relinearisations < relinearisations:
            start = known or (self.disturbances.get(near) if near is not None else None)
            known = fit_disturbance(
                self.comparison, hypothesis, start.model if start else None, relinearisations
            )
            self.disturbances[hypothesis] = known
        return known

    def with_coloured_gain(self, base: Hypothesis, refit: Refit) -> Refit:
        """Compare a refit with the model before it under the coloured-noise model."""
        for relinearisations in (1, MAX_RELINEARISATIONS):
            before = self.disturbance(base, relinearisations=relinearisations).model
            after = self.disturbance(refit.hypothesis, base, relinearisations).model
            gain = after.log_likelihood - before.log_likelihood
            # Where a disturbance remains it biases the parameters of both models: then once is not enough.
            if gain < refit.penalty - thresholds.DECIDED or (
                gain > refit.penalty + thresholds.DECIDED
                and refit.evidence.variance_reduction > thresholds.PLAIN
            ):
                break
        return replace(refit, coloured_gain=gain)

    def try_refit(self, refits: list[Refit], base: Hypothesis, one: Scored, score: float) -> None:
        """Refit one more candidate, while there is time."""
        if self.out_of_time() and refits:
            return
        number = len(self.rounds)
        self.say(f"trying {one.candidate.id}", 0.1 + 0.6 * (1 - 0.6 ** (number + 0.5)))
        refit = self.attempt(base, base.candidates, one, score)
        if refit is not None:
            refits.append(refit)

    def choice(self, base: Hypothesis, refits: Sequence[Refit]) -> tuple[list[Refit], Refit | None]:
        """The best effect that coloured noise does not imitate, or a spline that clearly beats it."""
        refits = sorted(refits, key=lambda refit: -refit.net_evidence)
        effects = [refit for refit in refits if refit.accepted and not refit.candidate.is_spline]
        if effects and effects[0].at_noise_floor:
            return refits, effects[0]
        effects = [refit for refit in refits if _eligible(refit, refits)]
        splines = [refit for refit in refits if refit.accepted and refit.candidate.is_spline][:1]
        compared = {
            refit: self.with_coloured_gain(base, refit)
            for refit in (*effects[: thresholds.COMPARED], *splines)
        }
        ahead = [
            compared[one]
            for one in effects[: thresholds.COMPARED]
            if compared[one].margin > thresholds.MIN_COLOURED
        ]
        best = max(ahead, key=lambda refit: refit.margin, default=None)
        for spline in (compared[refit] for refit in splines):
            margin = spline.margin - (best.margin if best else 0.0)
            if margin > max(thresholds.SPLINE_MIN, thresholds.SPLINE_MARGIN * spline.margin):
                best = spline
        return [compared.get(refit, refit) for refit in refits], best

    def backward(self, final: Hypothesis) -> tuple[Hypothesis, list[Cause]]:
        """Drop what is no longer needed; measure the evidence of the rest, and its alternatives."""
        number = 0
        without: dict[str, Hypothesis] = {}
        while number < len(final.candidates):
            candidate = final.candidates[number]
            self.say(
                f"checking whether {candidate.id} is needed", 0.75 + 0.1 * number / len(final.candidates)
            )
            rest = [other for other in final.candidates if other is not candidate]
            less = self.comparison.refit(rest, final.fit.values) if rest else self.baseline
            refit = Refit(final, self.comparison.evidence(final, less), self.penalty(candidate), 0.0)
            seen = next((one.refits for one in self.rounds if one.taken == candidate.id), ())
            needed = refit.accepted or _eligible(refit, seen)
            if needed and not refit.at_noise_floor:
                refit = self.with_coloured_gain(less, refit)
            if not (needed and refit.margin > thresholds.MIN_COLOURED) and not self.out_of_time():
                final, number = less, 0
                without.clear()
                continue
            without[candidate.id] = less
            number += 1
        found = [
            Cause(
                candidate,
                self.comparison.evidence(final, without[candidate.id]),
                self.penalty(candidate),
                self.alternatives(final, candidate, without[candidate.id]),
            )
            for candidate in final.candidates
        ]
        return final, sorted(found, key=lambda one: -one.evidence.total)

    def alternatives(
        self, final: Hypothesis, candidate: Candidate, less: Hypothesis
    ) -> tuple[Alternative, ...]:
        """Other effects in the place of one of the final model's, closest first."""
        ratios: dict[str, float] = {}
        seen = next((r for r in self.rounds if r.taken == candidate.id), None)
        if seen is None:
            return ()
        rest = [other for other in final.candidates if other is not candidate]
        best = max(refit.score for refit in seen.refits)
        for refit in sorted(seen.refits, key=lambda refit: -refit.score):
            if (
                refit.candidate.id == candidate.id
                or refit.candidate.id in final.ids
                or refit.candidate.is_spline
            ):
                continue
            if len(rest) == 0:
                other = refit
            elif self.out_of_time() or ratios or refit.score < thresholds.ALTERNATIVE_SHARE * best:
                continue
            else:
                scored = next(one for one in seen.screened if one.candidate.id == refit.candidate.id)
                attempted = self.attempt(less, rest, scored, refit.score)
                if attempted is None:
                    continue
                other = attempted
            ahead = self.comparison.evidence(final, other.hypothesis).total
            ratios[refit.candidate.id] = ahead + self.penalty(refit.candidate) - self.penalty(candidate)
        return tuple(Alternative(id_, ratio) for id_, ratio in sorted(ratios.items(), key=lambda one: one[1]))

    def run(self) -> Search:
        self.say("refitting the baseline", 0.02)
        self.baseline = self.comparison.refit([])
        start = without_absent_terms(self.comparison, self.baseline, self.removable)
        reached, screening, complete = self.forward(start)
        final, found = self.backward(reached)
        if final is not reached:
            screening = Screening(final.fit)
        disturbance = None
        if min(final.train.normalised, final.held_out.normalised) >= thresholds.AT_NOISE_FLOOR:
            self.say("estimating the disturbance that remains", 0.88)
            disturbance = self.disturbance(final, self.baseline, MAX_RELINEARISATIONS)
        return Search(
            self.baseline, final, tuple(found), tuple(self.rounds), screening, complete, disturbance
        )


def _eligible(refit: Refit, beside: Sequence[Refit]) -> bool:
    """Whether it is an effect that is accepted, or one that is not told apart from such a one."""
    if refit.candidate.is_spline or refit.accepted:
        return not refit.candidate.is_spline
    if refit.evidence.train <= refit.penalty or refit.evidence.variance_reduction < thresholds.MIN_REDUCTION:
        return False
    # Between two that the flights do not tell apart, such as a lag and a delay, no threshold may decide.
    least = refit.evidence.total + thresholds.AMBIGUOUS
    return any(least > one.evidence.total for one in beside if one.accepted and not one.candidate.is_spline)


def _nothing_left(hypothesis: Hypothesis) -> bool:
    return max(hypothesis.train.normalised, hypothesis.held_out.normalised) < thresholds.NOTHING_LEFT


def _at_noise_floor(refits: Sequence[Refit]) -> bool:
    """Whether a candidate leaves nothing but quantisation."""
    return any(
        refit.accepted
        and not refit.candidate.is_spline
        and refit.normalised_error < thresholds.AT_NOISE_FLOOR
        for refit in refits
    )


def search(
    comparison: Comparison,
    kinds: Mapping[str, EffectKind],
    *,
    removable: Sequence[EffectKind] = (),
    say: Callable[[str, float], None] | None = None,
    seconds: float = math.inf,
) -> Search:
    """Find what a model lacks; what was found counts also when the time ran out.

    Parameters
    ----------
    removable : sequence of EffectKind
        Kinds that remove terms of the baseline which the rig states closely.
    say : callable, optional
        Called with what is being done, and the share of the work that is done, 0 to 1.
    seconds : float
        Time after which no further refit is begun.
    """
    until_s = time.perf_counter() + seconds
    return _Searcher(comparison, kinds, say or (lambda _what, _share: None), until_s, removable).run()
