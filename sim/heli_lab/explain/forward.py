"""Forward selection: scores all candidates about the current estimate, refits the best, accepts one.

Terms of the baseline may be absent although the rig file specifies their parameters tightly. A parameter with
a wide prior, such as a friction, is estimated as zero if its term is absent. A narrow prior, such as that of
a pendulum's length, prevents this: the model is refitted without the term, in competition with the effects
that may be tried in its place.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

import numpy as np
from heli_host.data.arrays import Booleans, Floats
from heli_sim.model.effect import AXES
from heli_sim.model.effects.spec import EffectSpec
from heli_sim.rig import Prior, Rig

from heli_lab.explain import thresholds
from heli_lab.explain.candidates import Candidate, ScoredCandidate, may_join, typical_candidate
from heli_lab.explain.comparison import Hypothesis, ModelComparison, Refit, Round
from heli_lab.explain.screening import Screening, hidden_in_disturbances, with_concentrated_scores
from heli_lab.fit.records import Record
from heli_lab.fit.reference_trajectory import ReferenceTrajectory, RETURN_s

_BASELINE, _FORWARD, _CHECKS, _END = 0.02, 0.1, 0.75, 0.9
"""Shares of a diagnosis at which the refit of the baseline, the forward rounds, the elimination and what
follows the search begin."""
_ROUND_DECAY: Final = 0.6
"""Share of the remaining forward search that remains after another round: their number is not known
beforehand."""


@dataclass
class Progress:
    """Reports what a search does, and says whether it may go on."""

    comparison: ModelComparison  # Counts the refits
    say: Callable[[str, float], None]
    """Called with the present step in words, and with the share of the whole diagnosis that is done, 0 to 1.
    """
    max_refits: float
    """Refits after which no further cause is tried. They include one refit for each accepted cause, which the
    elimination needs."""
    accepted: int = 0  # Causes that were accepted so far
    reached: float = 0.0
    """Largest share that was reported so far; a second turn of the search does not report less."""

    def refits_left(self) -> bool:
        """Whether another candidate may be refitted."""
        return self.comparison.fits + self.accepted < self.max_refits

    def baseline(self) -> None:
        """Report the refit of the baseline."""
        self._report("refitting the baseline", _BASELINE)

    def round(self, number: int) -> None:
        """Report that the forward round `number`, from 0, begins."""
        self._report(f"looking for what is missing, round {number + 1}", _forward_share(number))

    def trial(self, candidate_id: str, number: int) -> None:
        """Report the refit of the candidate `candidate_id` in the forward round `number`, from 0."""
        self._report(f"trying {candidate_id}", _forward_share(number + 0.5))

    def check(self, candidate_id: str, number: int, count: int) -> None:
        """Report the refit without the cause `candidate_id`, the `number`-th, from 0, of `count`."""
        self._report(f"checking whether {candidate_id} is needed", _CHECKS + 0.1 * number / count)

    def _report(self, step: str, share: float) -> None:
        # A search that runs into its limit ends there: the time left is no longer than the work left.
        work = _END * min(1.0, self.comparison.fits / max(self.max_refits, 1.0))
        self.reached = max(self.reached, share, work)
        self.say(step, self.reached)


def _forward_share(rounds: float) -> float:
    """Return the share of the work after some `rounds`; each further one is less likely to be needed."""
    return float(_FORWARD + 0.6 * (1.0 - _ROUND_DECAY**rounds))


def limited_std(
    kind: EffectSpec, values: Mapping[str, float], std: Mapping[str, float], record: Record
) -> dict[str, float]:
    """Return standard errors that are not smaller than the resolution of the flights."""
    # Three limits apply. A time constant or delay is uncertain by a part of a sample, because voltages are
    # held over a sample. A size is uncertain by a share of itself, because the model averages over its steps.
    # An effect between an axis and its encoder is uncertain by a part of a count.
    channel, _, axis = kind.acts_on.partition(".")
    std_by_name = {}
    for parameter in kind.parameters:
        if parameter.name not in std:
            continue  # fixed
        parameter_std, resolution = std[parameter.name], 0.0
        if parameter.unit == "s":
            parameter_std = time_std_s(parameter_std, record.step_s)
        elif parameter.unit == "rad" and channel == "measurement" and axis in AXES:
            resolution = thresholds.MIN_STD_COUNTS * float(record.count_rad[AXES.index(axis)])
        size_error = thresholds.MIN_STD_SHARE * values[parameter.name] if parameter.name in kind.size else 0.0
        std_by_name[parameter.name] = math.hypot(parameter_std, resolution, size_error)
    return std_by_name


def time_std_s(std_s: float, step_s: float) -> float:
    """Return the standard error of a time constant or delay that the flights support [s]."""
    # Voltages are held over a step, so a time is uncertain by a part of it, and by what a controller answers
    # within it.
    return math.hypot(thresholds.TIME_STD_FACTOR * std_s, 0.5 * step_s)


_NEUTRAL_SHARE: Final = 0.01
"""Share of its typical size below which an effect counts as absent: sizes at their bounds are ten times
smaller. Higher: small causes are lost. Lower: a better estimate of the other parameters is taken for a cause,
such as a play of 0.000 degrees that gained 289 nats (2026-11)."""


@dataclass(frozen=True)
class Acceptance:
    """Decides whether a refitted candidate belongs into the model."""

    # A candidate is accepted if its log-likelihood ratio exceeds its penalty by `min_margin`, its size is
    # significant, and the moment at which it acts, if it has one, is within the free flight.

    comparison: ModelComparison
    kinds: Mapping[str, EffectSpec]

    def penalty(self, candidate: Candidate, grid_points: int = 0) -> float:
        """Return the complexity penalty of a `candidate`, nats: BIC for its parameters, and the logarithm of
        the number of tests.
        """
        free_count = len(set(candidate.effect.priors) | set(candidate.grid))
        coefficient_weight = thresholds.SPLINE_COEFFICIENT_WEIGHT if candidate.is_spline else 1.0
        tests = thresholds.CANDIDATES_TRIED + grid_points
        return 0.5 * coefficient_weight * free_count * math.log(self.comparison.rows) + math.log(tests)

    def accepts(self, refit: Refit) -> bool:
        """Whether a refitted candidate may be added to the model."""
        if refit.margin <= min_margin(refit.candidate.id, refit.hypothesis.ids):
            return False
        if refit.candidate.is_spline:
            return True  # it has no moment, and no single size
        return self.comparison.in_flight(refit.hypothesis) and self.is_significant(refit, refit.candidate)

    def is_significant(self, refit: Refit, candidate: Candidate) -> bool:
        """Whether the size of a candidate of `refit` differs from zero: by its standard error (Wald test),
        or, where a likelihood is one-sided and the Wald test fails, by the log-likelihood ratio.
        """
        if candidate.is_spline:
            return True  # its coefficients are significant together, by the margin
        if refit.margin > thresholds.WALD_OVERRIDE_NATS:
            return not is_neutral(refit.hypothesis, candidate, self.kinds)
        return is_significant(refit.hypothesis, candidate, self.kinds, self.comparison.train[0])

    def resolves(self, hypothesis: Hypothesis, kind: EffectSpec) -> bool:
        """Whether the flights resolve each size of an effect of a model, `is_resolved`."""
        return is_resolved(hypothesis, kind, self.comparison.train[0])

    def worth_a_refit(self, screened: Sequence[ScoredCandidate]) -> list[ScoredCandidate]:
        """Candidates whose score leaves a chance that a refit is accepted, in their order."""
        return [
            scored
            for scored in screened
            if thresholds.EXPECTED_REFIT_GAIN * scored.log_likelihood_gain
            > self.penalty(scored.candidate, scored.grid_points) + thresholds.MIN_MARGIN
        ]


def min_margin(id_: str, present: Collection[str]) -> float:
    """Return the log-likelihood ratio by which an effect must exceed its penalty, nats."""
    family, _, axis = id_.partition(".")
    if family == "backlash" and f"coulomb_friction.{axis}" in present:
        return thresholds.PLAY_NEXT_TO_FRICTION_NATS
    return thresholds.MIN_MARGIN


def is_significant(
    hypothesis: Hypothesis, candidate: Candidate, kinds: Mapping[str, EffectSpec], record: Record
) -> bool:
    """Whether a size of an effect differs from its neutral value by two standard errors (Wald test)."""
    kind = kinds.get(candidate.id)
    if kind is None:
        return True  # only the catalogue states which parameters are sizes
    are_significant = _significant_sizes(hypothesis, kind, record)
    return not are_significant or any(are_significant)


def is_resolved(hypothesis: Hypothesis, kind: EffectSpec, record: Record) -> bool:
    """Whether each size of an effect differs from its neutral value by two standard errors."""
    return all(_significant_sizes(hypothesis, kind, record))


def _significant_sizes(hypothesis: Hypothesis, kind: EffectSpec, record: Record) -> list[bool]:
    """Return for each free size of an effect whether it differs from its neutral value by two of its
    `limited_std`.
    """
    values, neutral = hypothesis.params, kind.neutral
    std = limited_std(kind, values, hypothesis.std, record)
    return [
        abs(values[size] - neutral[size]) > thresholds.SIGNIFICANT_STD_ERRORS * std[size]
        for size in kind.size
        if size in values
    ]


def is_neutral(hypothesis: Hypothesis, candidate: Candidate, kinds: Mapping[str, EffectSpec]) -> bool:
    """Whether all sizes of an effect ended at their neutral values."""
    # A gain of such a refit comes from better estimates of the other parameters.
    kind = kinds.get(candidate.id)
    if kind is None:
        return False
    values, neutral, typical = hypothesis.params, kind.neutral, kind.typical
    free_sizes = [size for size in kind.size if size in values]
    return bool(free_sizes) and all(
        abs(values[size] - neutral[size]) < _NEUTRAL_SHARE * abs(typical[size]) for size in free_sizes
    )


_ABSENT_PRIOR: Final = Prior(mean=1.0, std=0.03, low=0.0, high=1.0)
"""Prior of the share of a term that is absent: all of it. With a wider prior, a share of the term would
replace a parameter that is merely wrong."""
_SCORE_PRIOR: Final = Prior(mean=0.0, std=1.0, low=0.0, high=1.0)
_START_SHARE: Final = 0.99
"""Just inside the bound of that prior."""


@dataclass(frozen=True)
class RemovedTerm:
    """A term of the baseline that the model is to be refitted without."""

    candidate: Candidate  # The removal of the term as an effect
    start: Mapping[str, float]  # Parameter values to refit from, by full name
    log_likelihood_gain: float  # Gain that is expected of the refit, nats


def tightly_specified(kind: EffectSpec, rig: Rig) -> bool:
    """Whether a `rig` file gives the parameters of a term such narrow priors that no fit estimates them as
    zero; False if the rig does not have the term.
    """
    return bool(kind.override) and all(
        name in rig and 0.0 < rig[name].tolerance < thresholds.TIGHT_TOLERANCE * rig[name].value
        for name in kind.override
    )


def tightly_specified_terms(
    comparison: ModelComparison, kinds: Iterable[EffectSpec], screening: Screening
) -> list[RemovedTerm]:
    """Find tightly specified terms that the score test removes nearly as a whole, or whose parameters the fit
    has made much smaller than their priors allow.
    """
    present_names = {effect.name for effect in screening.estimate.parameter_vector.model.effects}
    removals = [
        kind
        for kind in kinds
        if kind.baseline
        and kind.id not in present_names
        and kind.suits(comparison.model)
        and tightly_specified(kind, comparison.rig)
    ]
    share_candidates = [
        Candidate(kind.id, replace(kind.make(), priors={kind.size[0]: _SCORE_PRIOR}), kind.size)
        for kind in removals
    ]
    low, high = thresholds.ABSENT_SHARE_RANGE
    removed_terms = []
    for kind, (score_nats, coefficients, _) in zip(removals, screening.score(share_candidates), strict=True):
        share = coefficients[0]
        nats_of_removal = score_nats if low < share < high else 0.0
        gain = max(nats_of_removal, _shrunk_prior_nats(screening, kind))
        if gain < thresholds.ABSENT_MIN_NATS:
            continue
        (name,) = kind.size  # The share that is absent
        candidate = Candidate(kind.id, replace(kind.make({name: 1.0}), priors={name: _ABSENT_PRIOR}), (name,))
        start = {parameter: comparison.rig[parameter].value for parameter in kind.override}
        removed_terms.append(RemovedTerm(candidate, {**start, name: _START_SHARE}, gain))
    return removed_terms


def _shrunk_prior_nats(screening: Screening, kind: EffectSpec) -> float:
    """Return the log-likelihood that the priors of a term's parameters cost, because the fit has made them
    smaller than the rig file states, nats.
    """
    # Without the term, the parameters return to their priors, so that a refit gains this much.
    estimate = screening.estimate
    deviations: dict[str, float] = estimate.parameter_vector.by_name(estimate.prior_deviations)
    shrunk = (min(deviations[name], 0.0) for name in kind.override if name in deviations)
    return 0.5 * sum(deviation**2 for deviation in shrunk)


PAUSE_FAMILIES: Final = ("coulomb_friction", "backlash")
"""Families of effects that make the count of an axis pause."""


def better_rival(comparison: ModelComparison, best: Refit, accepted: Sequence[Refit]) -> Refit:
    """Return the more likely one on all flights of `best` and its rival, the other effect that makes the same
    count pause.
    """
    # The fitted flights alone may prefer the wrong effect, because it fits their peculiarities. While each
    # measurement of a rest counted, friction of 0.03 N m gained 207 nats more there than the play that was
    # hidden in a measured flight, and 516 nats less on the held-out flight. Since a rest counts once, the
    # fitted flights alone would have made the same choice in 16 simulated and measured flights; in one of
    # them, it is wrong (2026-11).
    family, _, axis = best.candidate.id.partition(".")
    if family not in PAUSE_FAMILIES or not comparison.held_out:
        return best  # it has no rival, or no flights decide between them
    ids = {f"{rival}.{axis}" for rival in PAUSE_FAMILIES}
    rivals = [refit for refit in accepted if refit.candidate.id in ids]
    if len(rivals) < len(PAUSE_FAMILIES):
        return best  # the rival was not accepted

    def on_all_flights(refit: Refit) -> float:
        return refit.margin + comparison.held_out_estimate(refit.hypothesis).log_likelihood

    return max(rivals, key=on_all_flights)


class Selection(NamedTuple):
    """Result of a forward selection."""

    hypothesis: Hypothesis  # The model with the added causes
    screening: Screening  # Scores of candidates about that model
    complete: bool  # Whether no limit ended the selection


@dataclass
class ForwardSelection:
    """Adds causes to a model, one per round, until no candidate is accepted."""

    comparison: ModelComparison
    acceptance: Acceptance
    progress: Progress
    removable: Sequence[EffectSpec]  # Terms of the baseline that may be removed
    excluded_ids: Collection[str] = ()  # Ids of candidates that are not tried
    rounds: list[Round] = field(default_factory=list)  # The rounds so far

    def select(self, hypothesis: Hypothesis) -> Selection:
        """Add causes to a `hypothesis`, one per turn of the loop."""
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
            is_last = len(hypothesis.candidates) >= thresholds.MAX_CAUSES or not self.progress.refits_left()
            absent_terms = (
                [] if is_last else tightly_specified_terms(self.comparison, self.removable, screening)
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
            if not is_last:
                round_refits.refit_effects(screening)
                better_base = round_refits.better_base()
                if better_base is not None:
                    # Begin the round again from the better estimate.
                    hypothesis = better_base
                    continue
                round_refits.refit_without_terms(absent_terms)
                accepted = round_refits.best_after_splines(self._not_excluded(splines))
            refits = sorted(round_refits.refits, key=lambda refit: -refit.margin)
            accepted_id = accepted.candidate.id if accepted else ""
            self.rounds.append(Round(hypothesis, tuple(screened), tuple(splines), tuple(refits), accepted_id))
            if accepted is None:
                is_complete = not is_last and self.progress.refits_left()
                return Selection(hypothesis, screening, complete=is_complete)
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
        """Return a more likely estimate of the base; None without one."""
        # A refit may end without its candidate and be more likely all the same. The other parameters had then
        # not reached their best values.
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
        """Let the best of the `splines` compete with the best effect; return the refit to accept, or None."""
        # A spline displaces a listed effect only after that effect was refitted over its grid.
        best = self.best
        required_margin = max(thresholds.SPLINE_MIN, best.margin if best else 0.0)
        if not splines or not self.progress.refits_left():
            return best
        if thresholds.EXPECTED_REFIT_GAIN * splines[0].log_likelihood_gain <= required_margin:
            return best
        spline_refit = self._refit(splines[0])
        if spline_refit.margin > required_margin:
            channel = splines[0].candidate.dependence.channel
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
    grid = _grid_neighbours(scored, acceptance.kinds)
    start = grid.nearest.start_values(scored.coefficients)
    best = comparison.refit([*base.candidates, grid.nearest], start, base)
    # Outwards from the nearest point, in both directions.
    for neighbours in (grid.larger, grid.smaller):
        for candidate in neighbours:
            grid_values = {name: candidate.effect.values[name] for name in candidate.grid}
            start = {**best.params, **grid_values}
            hypothesis = comparison.refit([*base.candidates, candidate], start, base)
            if hypothesis.log_likelihood <= best.log_likelihood:
                break  # points farther away are less likely still
            best = hypothesis
    gain = best.log_likelihood - base.log_likelihood
    penalty = acceptance.penalty(scored.candidate, scored.grid_points)
    return Refit(best, gain, penalty, score=scored.log_likelihood_gain, added_id=scored.candidate.id)


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
    changes the variance of measurements within it.
    """
    # On four simulated flights with a play, scores were 29 to 243 nats, and refits gained 625 to 1958 nats
    # (2026-11). Next to other causes a score may be too low for a refit.
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
    """Return effects of a `family` with their typical size, one for each proposed axis."""
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
            proposals.append(ScoredCandidate(candidate, 0.0, zeros, zeros, 1))  # no score shows it
    return proposals


class _GridNeighbours(NamedTuple):
    """A candidate at its nearest grid point, and at those of larger and of smaller values, each from the
    nearest on.
    """

    nearest: Candidate
    larger: list[Candidate]
    smaller: list[Candidate]


def _grid_neighbours(scored: ScoredCandidate, kinds: Mapping[str, EffectSpec]) -> _GridNeighbours:
    """Return the neighbours of a candidate on the grid of a parameter without a prior; without exactly one
    such parameter, it has no neighbours.
    """
    candidate, kind = scored.candidate, kinds.get(scored.candidate.id)
    grid_only = [name for name in candidate.grid if name not in candidate.effect.priors]
    if kind is None or len(grid_only) != 1:
        return _GridNeighbours(candidate, [], [])
    (name,) = grid_only
    values = kind.grid_values(seconds=1.0)[name]  # No grid without a prior depends on the duration
    nearest = int(np.argmin(np.abs(np.array(values) - candidate.grid[name])))

    def candidate_at(value: float) -> Candidate:
        """Return the candidate at a value of the parameter."""
        return Candidate(
            candidate.id,
            kind.make({**candidate.effect.values, name: value}),
            candidate.linear_parameters,
            {**candidate.grid, name: value},
        )

    return _GridNeighbours(
        candidate_at(values[nearest]),
        larger=[candidate_at(value) for value in values[nearest + 1 :]],
        smaller=[candidate_at(value) for value in values[:nearest][::-1]],
    )


def _acts_on(kind: EffectSpec, channel: str) -> bool:
    """Whether an effect acts on a channel; one on the input acts on both channels of thrust."""
    return kind.acts_on == channel or (channel.startswith("thrust") and kind.acts_on in ("thrust", "input"))
