"""Confirmation of causes: a cause must hold in both directions, fitted on one side and judged on the other.

Where flights are held out, the two sides are the fitted and the held-out flights; otherwise they are two
folds of the fitted flights. A cause is confirmed if two conditions hold in both directions. Its
log-likelihood ratio is positive on the judging flights. With it, no axis' open-loop error at 1 s grows by
more than its bootstrap interval, compared with the baseline.

Only confirmed causes enter the extended rig, unless all are asked for.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

from heli_lab.diagnose.evaluate.assessment import Assessment
from heli_lab.diagnose.evaluate.error_reduction import ErrorReduction, error_reduction
from heli_lab.diagnose.evaluate.free_run import FreeRun, estimated_free_runs
from heli_lab.diagnose.evaluate.held_out import HeldOutEvaluation, evaluate_extension
from heli_lab.diagnose.evaluate.prediction import Prediction, predict
from heli_lab.diagnose.search import Direction, Hypothesis, ModelComparison, Search, direction

WORSE_HORIZON: Final = "1"
"""Horizon of the open-loop errors that decide, a key of `HORIZONS`: long enough to show a lag, and
too short for constants and slow terms to dominate."""


@dataclass(frozen=True)
class CauseReplication:
    """Whether a cause holds in both directions.

    Parameters
    ----------
    forward, reverse : float or None
        Log-likelihood ratio on the held-out flights with the parameters of the fitted ones, and the reverse,
        nats; None if it was not computed.
    why_not : str
        Why the cause is not confirmed, in words; empty if it is.
    """

    forward: float | None
    reverse: float | None
    why_not: str

    @property
    def confirmed(self) -> bool:
        """Whether the cause is confirmed."""
        return not self.why_not


@dataclass(frozen=True)
class WorseAxis:
    """An axis whose open-loop error grows by more than its bootstrap interval.

    Parameters
    ----------
    axis : str
        Elevation, pitch or travel.
    fitted, judged : str
        Labels of the flights that estimated the parameters, and of those that judge.
    reduction : ErrorReduction
        The errors at `WORSE_HORIZON`.
    """

    axis: str
    fitted: str
    judged: str
    reduction: ErrorReduction


@dataclass(frozen=True)
class Replication:
    """Confirmed causes, and the model with them alone.

    Parameters
    ----------
    causes : Mapping[str, CauseReplication]
        By effect id.
    model : Hypothesis
        The model with the confirmed causes, and with events that happened in one of its flights only.
    prediction : Prediction
        Its free runs over all flights.
    evaluation : HeldOutEvaluation
        Its free-run errors on the held-out flights.
    worse : tuple of WorseAxis
        Axes that the model with all named causes predicts worse.
    """

    causes: Mapping[str, CauseReplication]
    model: Hypothesis
    prediction: Prediction
    evaluation: HeldOutEvaluation
    worse: tuple[WorseAxis, ...]

    @property
    def unconfirmed(self) -> dict[str, CauseReplication]:
        """Causes that are not confirmed, by effect id."""
        return {id_: cause for id_, cause in self.causes.items() if not cause.confirmed}


def replicate(
    comparison: ModelComparison,
    search: Search,
    assessment: Assessment,
    evaluation: HeldOutEvaluation,
    calibrate_s: float | None = None,
) -> Replication:
    """Find out which causes hold in both directions.

    Parameters
    ----------
    comparison : ModelComparison
        The flights.
    search : Search
        Its final model is fitted in the reverse direction, from the estimates that exist.
    assessment : Assessment
        Its extended model has all named causes.
    evaluation : HeldOutEvaluation
        Free-run errors of the extended model.
    calibrate_s : float, optional
        Requested duration to calibrate held-out flights on.
    """
    ids = [cause.effect for cause in assessment.verdict.causes]
    if not ids:
        return Replication({}, assessment.extended, assessment.after, evaluation, ())
    judge = _Judge(comparison, search, assessment, evaluation, calibrate_s)
    if judge.directions is None:
        why = "no other flight was given, and this one is too short to be divided into two folds"
        causes = {id_: CauseReplication(None, None, why) for id_ in ids}
        return _replication(judge, causes, ())
    forward, reverse = judge.ratios
    why_not = {id_: judge.contradiction(id_) for id_ in ids}
    worse = judge.worse(ids)
    confirmed = [id_ for id_ in ids if not why_not[id_]]
    while remaining_axes := (worse if len(confirmed) == len(ids) else judge.worse(confirmed)):
        blamed = judge.blamed(confirmed, remaining_axes)
        confirmed.remove(blamed)
        why_not[blamed] = _in_words(remaining_axes[0])
    causes = {id_: CauseReplication(forward.get(id_), reverse.get(id_), why_not[id_]) for id_ in ids}
    return _replication(judge, causes, worse)


def worse_axis_sentence(worse: WorseAxis, model: str = "the extended model") -> str:
    """Describe an axis that a `model` predicts worse, without a full stop."""
    low, high = worse.reduction.interval95
    return (
        f"{model}, fitted on {worse.fitted}, predicts {worse.axis} of {worse.judged} worse than the "
        f"baseline: its error at {WORSE_HORIZON} s is {worse.reduction.ratio:.2f} times as large "
        f"({low:.2f} to {high:.2f})"
    )


def _in_words(worse: WorseAxis) -> str:
    return worse_axis_sentence(worse, "the model with it")


def _replication(
    judge: _Judge, causes: Mapping[str, CauseReplication], worse: tuple[WorseAxis, ...]
) -> Replication:
    confirmed = [id_ for id_, cause in causes.items() if cause.confirmed]
    return Replication(causes, judge.hypothesis(confirmed), *judge.evaluated(confirmed), worse)


class _Judge:
    """Judges models with some of the named causes in both directions; what was computed is kept."""

    def __init__(
        self,
        comparison: ModelComparison,
        search: Search,
        assessment: Assessment,
        evaluation: HeldOutEvaluation,
        calibrate_s: float | None,
    ) -> None:
        self.comparison, self.search, self.assessment = comparison, search, assessment
        self.calibrate_s = calibrate_s
        self.ids = tuple(cause.effect for cause in assessment.verdict.causes)
        self._evaluated = {
            frozenset(self.ids): (assessment.after, evaluation),
        }
        self._hypotheses = {frozenset(self.ids): assessment.extended, frozenset[str](): search.baseline}
        self._baseline_runs: dict[bool, Sequence[FreeRun]] = {}
        self._reductions: dict[tuple[frozenset[str], bool], Mapping[str, ErrorReduction]] = {}

    @cached_property
    def directions(self) -> tuple[Direction | None, Direction] | None:
        """Forward and reverse; no forward direction where the search has it. None if no side can judge."""
        comparison, final = self.comparison, self.search.final
        if comparison.held_out:
            near = comparison.held_out_estimate(final)
            return None, direction(comparison.exchanged(), final, near, final.estimate)
        folds = comparison.folds()
        if folds is None:
            return None
        forward = direction(folds, final, final.estimate, final.estimate)
        return forward, direction(folds.exchanged(), final, final.estimate, final.estimate)

    @cached_property
    def ratios(self) -> tuple[Mapping[str, float], Mapping[str, float]]:
        """Log-likelihood ratios of the causes in both directions."""
        assert self.directions is not None
        forward, reverse = self.directions
        if forward is not None:
            return forward.log_likelihood_ratio, reverse.log_likelihood_ratio
        known = {cause.effect: cause.held_out or 0.0 for cause in self.assessment.verdict.causes}
        return known, reverse.log_likelihood_ratio

    def contradiction(self, id_: str) -> str:
        """Why the log-likelihood ratios of a cause do not confirm it; empty if they do."""
        if self._is_of_one_flight(id_):
            return "it happened in one flight only"
        sides = self._labels()
        for nats, (fitted, judged) in zip(self.ratios, (sides, sides[::-1]), strict=True):
            if not nats[id_] > 0.0:
                return (
                    f"fitted on {fitted}, it makes {judged} less likely "
                    f"(log-likelihood ratio {nats[id_]:.1f} nats)"
                )
        return ""

    def _with_events(self, ids: Sequence[str]) -> frozenset[str]:
        """Some causes, and the events of one flight: these stay in the fit of their flight, and never happen
        in another one.
        """
        return frozenset(ids) | {id_ for id_ in self.ids if self._is_of_one_flight(id_)}

    def _is_of_one_flight(self, id_: str) -> bool:
        effect = next(c.effect for c in self.search.final.candidates if c.id == id_)
        labels = {record.label for record in self.comparison.held_out}
        return bool(effect.flight) and not labels & effect.other_moments_s.keys()

    def worse(self, ids: Sequence[str]) -> tuple[WorseAxis, ...]:
        """Axes that the model with some causes predicts worse in one of the directions."""
        if not ids:
            return ()
        sides = self._labels()
        return tuple(
            WorseAxis(axis, *(sides[::-1] if reverse else sides), reduction)
            for reverse in (False, True)
            for axis, reduction in self.reductions(ids, reverse).items()
            if reduction.interval95[0] > 1.0
        )

    def blamed(self, ids: Sequence[str], worse: Sequence[WorseAxis]) -> str:
        """The cause without which the errors of the axes that are predicted `worse` are smallest."""
        if len(ids) == 1:
            return ids[0]

        def left(without: str) -> float:
            others = [id_ for id_ in ids if id_ != without]
            return sum(
                math.log(self.reductions(others, entry.fitted != self._labels()[0])[entry.axis].ratio)
                for entry in worse
            )

        return min(ids, key=left)

    def reductions(self, ids: Sequence[str], reverse: bool) -> Mapping[str, ErrorReduction]:
        """Open-loop errors at `WORSE_HORIZON` of the model with some causes, compared with the baseline's."""
        assert self.directions is not None
        side = self.directions[int(reverse)]
        if side is None:
            return self.evaluated(ids)[1].extension.horizons[WORSE_HORIZON]
        key = frozenset(ids), reverse
        if key not in self._reductions:
            if reverse not in self._baseline_runs:
                self._baseline_runs[reverse] = self._runs(side, side.baseline)
            runs = self._runs(side, self._fitted(side, ids))
            self._reductions[key] = error_reduction(
                [run.errors[WORSE_HORIZON] for run in self._baseline_runs[reverse]],
                [run.errors[WORSE_HORIZON] for run in runs],
                self.comparison.seed,
            )
        return self._reductions[key]

    def hypothesis(self, ids: Sequence[str]) -> Hypothesis:
        """The model with some of the causes, on the fitted flights."""
        key = self._with_events(ids)
        if key not in self._hypotheses:
            extended = self.assessment.extended
            candidates = [candidate for candidate in extended.candidates if candidate.id in key]
            self._hypotheses[key] = self.comparison.refit(candidates, None, extended)
        return self._hypotheses[key]

    def evaluated(self, ids: Sequence[str]) -> tuple[Prediction, HeldOutEvaluation]:
        """Free runs of the model with some of the causes, and their errors on the held-out flights."""
        key = self._with_events(ids)
        if key not in self._evaluated:
            comparison, before = self.comparison, self.assessment.before
            hypothesis = self.hypothesis(ids)
            after = before if hypothesis is self.search.baseline else None
            after = after or predict(hypothesis.estimate, comparison.train, comparison.held_out)
            _, whole = self._evaluated[frozenset(self.ids)]
            self._evaluated[key] = (
                after,
                evaluate_extension(comparison, before, after, whole, self.calibrate_s),
            )
        return self._evaluated[key]

    def _fitted(self, side: Direction, ids: Sequence[str]) -> Hypothesis:
        """The model with some causes on the fitted flights of a direction, without splines."""
        with_events = self._with_events(ids)
        candidates = tuple(candidate for candidate in side.whole.candidates if candidate.id in with_events)
        if len(candidates) == len(side.whole.candidates):
            return side.whole
        return side.comparison.refit_from(candidates, side.whole.values, side.whole.estimate.disturbances)

    def _runs(self, side: Direction, hypothesis: Hypothesis) -> Sequence[FreeRun]:
        return estimated_free_runs(
            hypothesis.estimate, side.comparison.held_out, self.calibrate_s, (WORSE_HORIZON,)
        )

    def _labels(self) -> tuple[str, str]:
        """Names of the fitted and of the held-out flights, or of the two folds."""
        if not self.comparison.held_out:
            return "the first fold", "the second fold"
        train, held_out = (
            " and ".join(record.label for record in records)
            for records in (self.comparison.train, self.comparison.held_out)
        )
        return train, held_out
