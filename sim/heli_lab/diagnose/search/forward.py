"""Forward selection: score all candidates about the current estimate, refit the best, accept the best of
these.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from heli_host.arrays import Flags, Floats
from heli_sim.model.effects.spec import EffectSpec
from heli_sim.model.parts import AXES

from heli_lab.diagnose import thresholds
from heli_lab.diagnose.search.acceptance import Acceptance
from heli_lab.diagnose.search.baseline_terms import RemovedTerm, tightly_specified_terms
from heli_lab.diagnose.search.candidate import Candidate, Scored, may_join, typical_candidate
from heli_lab.diagnose.search.concentrated_score import with_concentrated_scores
from heli_lab.diagnose.search.hypothesis import Hypothesis, Refit, Round
from heli_lab.diagnose.search.model_comparison import ModelComparison
from heli_lab.diagnose.search.progress import Progress
from heli_lab.diagnose.search.screening import Screening
from heli_lab.estimation import ReferenceTrajectory
from heli_lab.estimation.reference_trajectory import RETURN_s


@dataclass
class ForwardSelection:
    """Adds causes to a model, one per round, until no candidate is accepted.

    Parameters
    ----------
    removable : sequence of EffectSpec
        Terms of the baseline that may be removed.
    rounds : list of Round
        The rounds so far.
    """

    comparison: ModelComparison
    acceptance: Acceptance
    progress: Progress
    removable: Sequence[EffectSpec]
    rounds: list[Round] = field(default_factory=list)

    @property
    def kinds(self) -> Mapping[str, EffectSpec]:
        """Catalogue by effect id."""
        return self.acceptance.kinds

    def select(self, hypothesis: Hypothesis) -> tuple[Hypothesis, Screening, bool]:
        """Add causes to a `hypothesis`.

        Returns
        -------
        Hypothesis
            The model with all accepted causes.
        Screening
            Scores of all candidates about that model.
        bool
            False if a limit, and not a lack of candidates, ended the selection.
        """
        while True:
            number = len(self.rounds)
            self.progress.round(number)
            screening = Screening(hypothesis.estimate)
            remaining = [
                kind for kind in self.kinds.values() if may_join(kind.id, hypothesis.ids, self.kinds)
            ]
            screened = with_concentrated_scores(screening, self.acceptance, screening.effects(remaining))
            splines = screening.splines(number)
            full = len(hypothesis.candidates) >= thresholds.MAX_CAUSES or not self.progress.refits_left()
            refits: list[Refit] = []
            accepted: Refit | None = None
            absent = [] if full else tightly_specified_terms(self.comparison, self.removable, screening)
            screening.release()
            if not full:
                refits, accepted = self._choose(hypothesis, screening, screened, splines, absent)
            accepted_id = accepted.candidate.id if accepted else ""
            self.rounds.append(Round(hypothesis, tuple(screened), tuple(splines), tuple(refits), accepted_id))
            if accepted is None:
                return hypothesis, screening, not full and self.progress.refits_left()
            self.progress.accepted += 1
            hypothesis = accepted.hypothesis

    def _choose(
        self,
        base: Hypothesis,
        screening: Screening,
        screened: Sequence[Scored],
        splines: Sequence[Scored],
        absent: Sequence[RemovedTerm],
    ) -> tuple[list[Refit], Refit | None]:
        """All refits of a round, the largest margin first, and the accepted one."""
        refits, likely = self._refit_effects(base, screening, screened)
        best_score = max((scored.log_likelihood_gain for scored in screened), default=0.0)
        for term in absent:
            if (
                self.progress.refits_left()
                and term.candidate.id not in base.ids
                and term.log_likelihood_gain > thresholds.SHORTLIST_SHARE * best_score
            ):
                refits.append(self._refit_without(base, term))
        best = self._best(refits)
        if splines:
            more, best = self._try_spline(base, splines[0], best, screened, likely, refits)
            refits += more
        return sorted(refits, key=lambda refit: -refit.margin), best

    def _try_spline(
        self,
        base: Hypothesis,
        spline: Scored,
        best: Refit | None,
        screened: Sequence[Scored],
        likely: Sequence[Scored],
        refits: Sequence[Refit],
    ) -> tuple[list[Refit], Refit | None]:
        """Let the best `spline` compete with the `best` effect: further refits, and the one to accept."""
        needed = max(thresholds.SPLINE_MIN, best.margin if best else 0.0)
        promised = thresholds.EXPECTED_REFIT_GAIN * spline.log_likelihood_gain
        if promised <= needed or not self.progress.refits_left():
            return [], best
        spline_refit = self._refit(base, spline)
        more: list[Refit] = []
        if spline_refit.margin > needed:
            more = self._refit_same_channel(base, spline, screened, likely)
            best = self._best([*refits, *more])
        lead = spline_refit.margin - (best.margin if best else 0.0)
        if lead > max(thresholds.SPLINE_MIN, thresholds.SPLINE_MARGIN * spline_refit.margin):
            best = spline_refit
        return [*more, spline_refit], best

    def _best(self, refits: Sequence[Refit]) -> Refit | None:
        accepted = [refit for refit in refits if self.acceptance.accepts(refit)]
        return max(accepted, key=lambda refit: refit.margin, default=None)

    def _refit_effects(
        self, base: Hypothesis, screening: Screening, screened: Sequence[Scored]
    ) -> tuple[list[Refit], list[Scored]]:
        """Refits of the effects with the best scores, and those effects."""
        remaining, likely, refits = self.acceptance.worth_a_refit(screened), list[Scored](), list[Refit]()
        # A high score that no refit confirms, such as that of an encoder at rest, must not end the round.
        while remaining and self._best(refits) is None:
            share = thresholds.SHORTLIST_SHARE * remaining[0].log_likelihood_gain
            some = [scored for scored in remaining if scored.log_likelihood_gain >= share][
                : thresholds.SHORTLIST
            ]
            refits += [self._refit(base, scored) for scored in some if self.progress.refits_left()]
            likely += some
            remaining = remaining[len(some) :]
        known = {scored.candidate.id for scored in likely}
        unscored = paused_play(base, screening, self.kinds, known)
        if self._best(refits) is None:
            unscored += resting_friction(base, screening, self.kinds, known)
        refits += [self._refit(base, scored) for scored in unscored if self.progress.refits_left()]
        return refits, [*likely, *unscored]

    def _refit_same_channel(
        self, base: Hypothesis, spline: Scored, screened: Sequence[Scored], likely: Sequence[Scored]
    ) -> list[Refit]:
        """Refits of further effects on a spline's channel: the spline displaces a listed effect only after
        that was refitted over its grid.
        """
        channel = spline.candidate.id.split(":")[1]
        known = {scored.candidate.id for scored in likely}
        like = [
            scored
            for scored in screened
            if scored.candidate.id not in known and _acts_on(self.kinds[scored.candidate.id], channel)
        ]
        like = [scored for scored in like[: thresholds.ALTERNATIVES] if scored.log_likelihood_gain > 0.0]
        return [self._refit(base, scored) for scored in like if self.progress.refits_left()]

    def _refit_without(self, base: Hypothesis, term: RemovedTerm) -> Refit:
        less = self.comparison.refit([*base.candidates, term.candidate], term.start, base)
        gain = less.log_likelihood - base.log_likelihood
        return Refit(less, gain, self.acceptance.penalty(term.candidate), term.log_likelihood_gain)

    def _refit(self, base: Hypothesis, scored: Scored) -> Refit:
        self.progress.trial(scored.candidate.id, len(self.rounds))
        return refit_on_grid(self.comparison, self.acceptance, base, scored)


def refit_on_grid(
    comparison: ModelComparison, acceptance: Acceptance, base: Hypothesis, scored: Scored
) -> Refit:
    """Refit a model with one more candidate; of a parameter that no refit moves, search the grid.

    Parameters
    ----------
    acceptance : Acceptance
        Knows the penalty and the grids of the catalogue.
    base : Hypothesis
        The model before.
    scored : Scored
        The candidate at the best point of its grid by score; the search goes up and down from there as long
        as the likelihood grows.
    """
    (first,), *directions = _grid_neighbours(scored, acceptance.kinds)
    best = comparison.refit([*base.candidates, first], first.start_values(scored.coefficients), base)
    for further in directions:
        for candidate in further:
            start = {**best.values, **{n: candidate.effect.values[n] for n in candidate.grid}}
            hypothesis = comparison.refit([*base.candidates, candidate], start, base)
            if hypothesis.log_likelihood <= best.log_likelihood:
                break
            best = hypothesis
    gain = best.log_likelihood - base.log_likelihood
    penalty = acceptance.penalty(scored.candidate, scored.tried)
    return Refit(best, gain, penalty, scored.log_likelihood_gain)


def resting_friction(
    base: Hypothesis, screening: Screening, kinds: Mapping[str, EffectSpec], known: Collection[str]
) -> list[Scored]:
    """Propose dry friction of typical size for axes that rest for long: a score test linearises, and friction
    that holds an axis has no derivative.

    Parameters
    ----------
    base : Hypothesis
        The present model.
    screening : Screening
        Scores about it; shows when each axis rests.
    known : collection of str
        Effects that were refitted already.
    """
    shares = _mean_over_time(reference.at_rest[reference.rows] for reference in _references(screening))
    return _typical("coulomb_friction", shares > thresholds.MIN_REST_SHARE, kinds, base, known)


def paused_play(
    base: Hypothesis, screening: Screening, kinds: Mapping[str, EffectSpec], known: Collection[str]
) -> list[Scored]:
    """Propose play of typical size for axes whose count often pauses: a score test leaves out that a play
    changes the variance of measurements within it. On four simulated flights with a play, scores were 29 to
    243 nats, and refits gained 625 to 1958 nats (2026-11). Next to other causes a score may be too low for a
    refit.

    Parameters
    ----------
    base : Hypothesis
        The present model.
    screening : Screening
        Scores about it; shows when the count of each axis pauses.
    known : collection of str
        Effects that were refitted already.
    """
    shares = _mean_over_time(
        reference.pause_s[reference.rows] > RETURN_s for reference in _references(screening)
    )
    return _typical("backlash", shares > thresholds.MIN_PAUSE_SHARE, kinds, base, known)


def _references(screening: Screening) -> list[ReferenceTrajectory]:
    return [linear.reference for linear in screening.filtered.linearised_flights]


def _mean_over_time(flights: Iterable[Flags]) -> Floats:
    """Share of the time in all flights for which each axis is flagged, shape (3,)."""
    shares: Floats = np.concatenate(list(flights)).mean(axis=0)
    return shares


def _typical(
    family: str,
    is_proposed: Flags,
    kinds: Mapping[str, EffectSpec],
    base: Hypothesis,
    known: Collection[str],
) -> list[Scored]:
    """Effects of a `family` with their typical size that may join `base`, one for each proposed axis, unless
    they are `known`.
    """
    proposals = []
    for axis, proposed in zip(AXES, is_proposed, strict=True):
        id_ = f"{family}.{axis}"
        if proposed and id_ in kinds and id_ not in {*base.ids, *known} and may_join(id_, base.ids, kinds):
            candidate = typical_candidate(kinds[id_])
            none = np.zeros(len(candidate.linear_parameters))
            proposals.append(Scored(candidate, 0.0, none, none, 1))
    return proposals


def _grid_neighbours(scored: Scored, kinds: Mapping[str, EffectSpec]) -> list[list[Candidate]]:
    """The candidate itself; then, if only a grid searches one of its parameters, the candidates at larger
    values, and those at smaller values, each list from the nearest on.
    """
    candidate, kind = scored.candidate, kinds.get(scored.candidate.id)
    fixed = [name for name in candidate.grid if name not in candidate.effect.priors]
    if kind is None or len(fixed) != 1:
        return [[candidate]]
    (name,) = fixed
    values = kind.grid_values(1.0)[name]
    nearest = int(np.argmin(np.abs(np.array(values) - candidate.grid[name])))
    return [
        [
            Candidate(
                candidate.id,
                kind.make({**candidate.effect.values, name: value}),
                candidate.linear_parameters,
                {**candidate.grid, name: value},
            )
            for value in some
        ]
        for some in ((values[nearest],), values[nearest + 1 :], values[:nearest][::-1])
    ]


def _acts_on(kind: EffectSpec, channel: str) -> bool:
    return kind.acts_on == channel or (channel.startswith("thrust") and kind.acts_on in ("thrust", "input"))
