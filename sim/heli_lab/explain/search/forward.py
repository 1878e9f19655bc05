"""Forward selection: score all candidates about the current estimate, refit the best, accept the best of
these.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from heli_host.data.arrays import Booleans, Floats
from heli_sim.model.effects.spec import EffectSpec
from heli_sim.model.parts import AXES

from heli_lab.explain import thresholds
from heli_lab.explain.search.acceptance import Acceptance, is_neutral
from heli_lab.explain.search.baseline_terms import RemovedTerm, tightly_specified_terms
from heli_lab.explain.search.candidate import Candidate, ScoredCandidate, may_join, typical_candidate
from heli_lab.explain.search.concentrated_score import hidden_in_disturbances, with_concentrated_scores
from heli_lab.explain.search.hypothesis import Hypothesis, Refit, Round
from heli_lab.explain.search.model_comparison import ModelComparison
from heli_lab.explain.search.progress import Progress
from heli_lab.explain.search.rivals import better_rival
from heli_lab.explain.search.screening import Screening
from heli_lab.fit.reference_trajectory import ReferenceTrajectory, RETURN_s


@dataclass
class ForwardSelection:
    """Adds causes to a model, one per round, until no candidate is accepted."""

    comparison: ModelComparison
    acceptance: Acceptance
    progress: Progress
    removable: Sequence[EffectSpec]  # Terms of the baseline that may be removed
    excluded_ids: Collection[str] = ()  # Ids of candidates that are not tried
    rounds: list[Round] = field(default_factory=list)  # The rounds so far

    def select(self, hypothesis: Hypothesis) -> tuple[Hypothesis, Screening, bool]:
        """Add causes to a `hypothesis`."""
        while True:
            number = len(self.rounds)
            self.progress.round(number)
            screening = Screening(hypothesis.estimate)
            kinds = self.acceptance.kinds
            compatible = [kind for kind in kinds.values() if may_join(kind.id, hypothesis.ids, kinds)]
            screened = with_concentrated_scores(
                screening, self.acceptance.worth_a_refit, screening.effects(compatible)
            )
            splines = screening.splines(number)
            is_full = len(hypothesis.candidates) >= thresholds.MAX_CAUSES or not self.progress.refits_left()
            absent_terms = (
                [] if is_full else tightly_specified_terms(self.comparison, self.removable, screening)
            )
            screening.release()
            round_refits = RoundRefits(
                self.comparison,
                self.acceptance,
                self.progress,
                number,
                hypothesis,
                self._not_excluded(screened),
                tried_ids=set(self.excluded_ids),
            )
            accepted = None
            if not is_full:
                round_refits.refit_effects(screening)
                better_base = round_refits.better_base()
                if better_base is not None:
                    hypothesis = better_base
                    continue
                round_refits.refit_without_terms(absent_terms)
                accepted = round_refits.best_after_splines(self._not_excluded(splines))
            refits = sorted(round_refits.refits, key=lambda refit: -refit.margin)
            accepted_id = accepted.candidate.id if accepted else ""
            self.rounds.append(Round(hypothesis, tuple(screened), tuple(splines), tuple(refits), accepted_id))
            if accepted is None:
                return hypothesis, screening, not is_full and self.progress.refits_left()
            self.progress.accepted += 1
            hypothesis = accepted.hypothesis

    def _not_excluded(self, scored: Sequence[ScoredCandidate]) -> list[ScoredCandidate]:
        return [candidate for candidate in scored if candidate.candidate.id not in self.excluded_ids]


@dataclass
class RoundRefits:
    """Refits of one round of the forward selection."""

    comparison: ModelComparison
    acceptance: Acceptance
    progress: Progress
    number: int  # Number of the round, from 0
    base: Hypothesis  # The model before the round
    screened: Sequence[ScoredCandidate]  # All effects with their scores, the best first
    refits: list[Refit] = field(default_factory=list)  # The refits so far
    tried_ids: set[str] = field(default_factory=set)
    """Ids of the effects whose turn has come, whether or not the limit of refits left them out, and of those
    that are excluded."""

    @property
    def best(self) -> Refit | None:
        """The refit of the largest margin among those that are accepted, or its better rival; None without
        one.
        """
        accepted = [refit for refit in self.refits if self.acceptance.accepts(refit)]
        if not accepted:
            return None
        largest = max(accepted, key=lambda refit: refit.margin)
        return better_rival(self.comparison, largest, accepted)

    def better_base(self) -> Hypothesis | None:
        """Return a more likely estimate of the base; None without one.

        A refit may end without its candidate and be more likely all the same. The other parameters had then
        not reached their best values.
        """
        neutral = [
            refit
            for refit in self.refits
            if refit.gain > thresholds.MIN_MARGIN
            and is_neutral(refit.hypothesis, refit.candidate, self.acceptance.kinds)
        ]
        if not neutral or not self.base.candidates:
            return None
        warm_start = max(neutral, key=lambda refit: refit.gain).hypothesis
        estimate = self.comparison.refit(self.base.candidates, None, warm_start)
        is_better = estimate.log_likelihood > self.base.log_likelihood + thresholds.MIN_MARGIN
        return estimate if is_better else None

    def refit_effects(self, screening: Screening) -> None:
        """Refit the effects with the best scores, then those that the disturbances stand in for, then those
        that a score cannot show; `screening` is about the base.
        """
        remaining = self.acceptance.worth_a_refit(self.screened)
        # A high score that no refit confirms, such as that of an encoder at rest, must not end the round.
        while remaining and self.best is None:
            min_gain = thresholds.SHORTLIST_SHARE * remaining[0].log_likelihood_gain
            shortlist = [scored for scored in remaining if scored.log_likelihood_gain >= min_gain]
            shortlist = shortlist[: thresholds.SHORTLIST]
            self._refit_each(shortlist)
            remaining = remaining[len(shortlist) :]
        if self.best is None:
            untried = [scored for scored in self.screened if scored.candidate.id not in self.tried_ids]
            hidden = hidden_in_disturbances(screening, self.acceptance.worth_a_refit, untried)
            self._refit_each(hidden[: thresholds.SHORTLIST])
        unscored = paused_play(self.base, screening, self.acceptance.kinds, self.tried_ids)
        if self.best is None:
            unscored += resting_friction(self.base, screening, self.acceptance.kinds, self.tried_ids)
        self._refit_each(unscored)
        self._refit_each(self._friction_instead_of_play())

    def _friction_instead_of_play(self) -> list[ScoredCandidate]:
        """Propose dry friction about the axis of a play that would be accepted: it makes counts pause too,
        and its score is too low for the same reason.
        """
        best = self.best
        family, _, axis = best.candidate.id.partition(".") if best else ("", "", "")
        is_proposed = np.array([family == "backlash" and name == axis for name in AXES])
        return _typical_proposals(
            "coulomb_friction", is_proposed, self.acceptance.kinds, self.base, self.tried_ids
        )

    def refit_without_terms(self, absent: Sequence[RemovedTerm]) -> None:
        """Refit the model without each of the terms that the rig may lack, if its score is high enough."""
        best_score = max((scored.log_likelihood_gain for scored in self.screened), default=0.0)
        for term in absent:
            if (
                self.progress.refits_left()
                and term.candidate.id not in {*self.base.ids, *self.tried_ids}
                and term.log_likelihood_gain > thresholds.SHORTLIST_SHARE * best_score
            ):
                candidates = [*self.base.candidates, term.candidate]
                reduced = self.comparison.refit(candidates, term.start, self.base)
                gain = reduced.log_likelihood - self.base.log_likelihood
                penalty = self.acceptance.penalty(term.candidate)
                self.refits.append(Refit(reduced, gain, penalty, term.log_likelihood_gain, term.candidate.id))

    def best_after_splines(self, splines: Sequence[ScoredCandidate]) -> Refit | None:
        """Let the best of the `splines` compete with the best effect; return the refit to accept.

        A spline displaces a listed effect only after that effect was refitted over its grid.
        """
        best = self.best
        required_margin = max(thresholds.SPLINE_MIN, best.margin if best else 0.0)
        if (
            not splines
            or thresholds.EXPECTED_REFIT_GAIN * splines[0].log_likelihood_gain <= required_margin
            or not self.progress.refits_left()
        ):
            return best
        spline_refit = self._refit(splines[0])
        if spline_refit.margin > required_margin:
            channel, _ = splines[0].candidate.dependence
            on_channel = [
                scored
                for scored in self.screened
                if scored.candidate.id not in self.tried_ids
                and _acts_on(self.acceptance.kinds[scored.candidate.id], channel)
            ]
            shortlist = on_channel[: thresholds.ALTERNATIVES]
            self._refit_each([scored for scored in shortlist if scored.log_likelihood_gain > 0.0])
            best = self.best
        self.refits.append(spline_refit)
        lead = spline_refit.margin - (best.margin if best else 0.0)
        is_ahead = lead > max(thresholds.SPLINE_MIN, thresholds.SPLINE_MARGIN * spline_refit.margin)
        return spline_refit if is_ahead else best

    def _refit_each(self, candidates: Sequence[ScoredCandidate]) -> None:
        """Refit the base with each candidate, until the limit of refits."""
        self.tried_ids |= {scored.candidate.id for scored in candidates}
        self.refits += [self._refit(scored) for scored in candidates if self.progress.refits_left()]

    def _refit(self, scored: ScoredCandidate) -> Refit:
        """Refit the base with one more candidate over its grid."""
        self.progress.trial(scored.candidate.id, self.number)
        return refit_on_grid(self.comparison, self.acceptance, self.base, scored)


def refit_on_grid(
    comparison: ModelComparison, acceptance: Acceptance, base: Hypothesis, scored: ScoredCandidate
) -> Refit:
    """Refit a model with one more candidate; search the grid of a parameter that has no prior."""
    (nearest,), *directions = _grid_neighbours(scored, acceptance.kinds)
    best = comparison.refit([*base.candidates, nearest], nearest.start_values(scored.coefficients), base)
    for neighbours in directions:
        for candidate in neighbours:
            grid_values = {name: candidate.effect.values[name] for name in candidate.grid}
            start = {**best.values, **grid_values}
            hypothesis = comparison.refit([*base.candidates, candidate], start, base)
            if hypothesis.log_likelihood <= best.log_likelihood:
                break
            best = hypothesis
    gain = best.log_likelihood - base.log_likelihood
    penalty = acceptance.penalty(scored.candidate, scored.tried)
    return Refit(best, gain, penalty, scored.log_likelihood_gain, scored.candidate.id)


def resting_friction(
    base: Hypothesis, screening: Screening, kinds: Mapping[str, EffectSpec], refitted_ids: Collection[str]
) -> list[ScoredCandidate]:
    """Propose dry friction of typical size for axes that rest for long: a score test linearises, and friction
    that holds an axis has no derivative.
    """
    shares = _flagged_share(reference.at_rest[reference.rows] for reference in _references(screening))
    return _typical_proposals(
        "coulomb_friction", shares > thresholds.MIN_REST_SHARE, kinds, base, refitted_ids
    )


def paused_play(
    base: Hypothesis, screening: Screening, kinds: Mapping[str, EffectSpec], refitted_ids: Collection[str]
) -> list[ScoredCandidate]:
    """Propose play of typical size for axes whose count often pauses: a score test leaves out that a play
    changes the variance of measurements within it. On four simulated flights with a play, scores were 29 to
    243 nats, and refits gained 625 to 1958 nats (2026-11). Next to other causes a score may be too low for a
    refit.
    """
    shares = _flagged_share(
        reference.pause_s[reference.rows] > RETURN_s for reference in _references(screening)
    )
    return _typical_proposals("backlash", shares > thresholds.MIN_PAUSE_SHARE, kinds, base, refitted_ids)


def _references(screening: Screening) -> list[ReferenceTrajectory]:
    """Return the reference trajectory of each fitted flight."""
    return [linear.reference for linear in screening.filtered.linearised_flights]


def _flagged_share(flights: Iterable[Booleans]) -> Floats:
    """Return the share of the time in all flights for which each axis is flagged, shape (3,)."""
    shares: Floats = np.concatenate(list(flights)).mean(axis=0)
    return shares


def _typical_proposals(
    family: str,
    is_proposed: Booleans,
    kinds: Mapping[str, EffectSpec],
    base: Hypothesis,
    refitted_ids: Collection[str],
) -> list[ScoredCandidate]:
    """Return effects of a `family` with their typical size, one for each proposed axis.

    Effects that may not join `base`, and those in `refitted_ids`, are left out.
    """
    proposals = []
    for axis, proposed in zip(AXES, is_proposed, strict=True):
        id_ = f"{family}.{axis}"
        if (
            proposed
            and id_ in kinds
            and id_ not in {*base.ids, *refitted_ids}
            and may_join(id_, base.ids, kinds)
        ):
            candidate = typical_candidate(kinds[id_])
            zeros = np.zeros(len(candidate.linear_parameters))
            proposals.append(ScoredCandidate(candidate, 0.0, zeros, zeros, 1))
    return proposals


def _grid_neighbours(scored: ScoredCandidate, kinds: Mapping[str, EffectSpec]) -> list[list[Candidate]]:
    """Return the neighbours of a candidate on the grid of a parameter without a prior.

    The lists have the nearest grid point, the points of larger values, and those of smaller values, each
    from the nearest on. Without exactly one such parameter, there is one list with the candidate.
    """
    candidate, kind = scored.candidate, kinds.get(scored.candidate.id)
    grid_only = [name for name in candidate.grid if name not in candidate.effect.priors]
    if kind is None or len(grid_only) != 1:
        return [[candidate]]
    (name,) = grid_only
    values = kind.grid_values(1.0)[name]
    nearest = int(np.argmin(np.abs(np.array(values) - candidate.grid[name])))

    def candidate_at(value: float) -> Candidate:
        """Return the candidate at a value of the parameter."""
        return Candidate(
            candidate.id,
            kind.make({**candidate.effect.values, name: value}),
            candidate.linear_parameters,
            {**candidate.grid, name: value},
        )

    larger, smaller = values[nearest + 1 :], values[:nearest][::-1]
    return [
        [candidate_at(values[nearest])],
        [candidate_at(value) for value in larger],
        [candidate_at(value) for value in smaller],
    ]


def _acts_on(kind: EffectSpec, channel: str) -> bool:
    """Whether an effect acts on a channel; one on the input acts on both channels of thrust."""
    return kind.acts_on == channel or (channel.startswith("thrust") and kind.acts_on in ("thrust", "input"))
