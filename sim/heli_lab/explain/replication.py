"""Evaluation on held-out flights, and confirmation of causes there.

A cause must also improve the model on flights that did not fit it. The test uses two sets of flights, and
repeats with the sets exchanged. If flights are held out, the sets are the fitted and the held-out flights;
otherwise they are two folds of the fitted flights. A cause holds if two conditions are met both times. First,
its log-likelihood ratio is positive on the flights that did not fit it. Second, with the cause, no axis has
an open-loop error at 1 s that is larger than the baseline's by more than the bootstrap interval.

A cause is confirmed if it holds, and if flights are held out. Folds can only contradict a cause, because the
search has chosen it on these same flights.

Only confirmed causes enter the extended rig, unless all are requested.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Final, NamedTuple

from heli_lab.explain.assessment import Assessment
from heli_lab.explain.comparison import Hypothesis, ModelComparison
from heli_lab.explain.prediction import (
    ErrorReduction,
    FreeRun,
    HeldOutComparison,
    Prediction,
    compare_free_runs,
    error_reduction,
    estimated_free_runs,
    free_runs,
    predict,
)
from heli_lab.explain.stepwise import Direction, Search, direction
from heli_lab.explain.thresholds import CALIBRATE_s


@dataclass(frozen=True)
class HeldOutEvaluation:
    """Free-run errors on the held-out flights, or on the fitted flights if none is held out."""

    extension: HeldOutComparison  # Refitted baseline against the extended model
    splines: Mapping[str, ErrorReduction]
    """Baseline against the final model with its spline terms, by axis, over 2 s; empty without spline terms.
    """
    requested_s: float  # Requested duration of free flight to calibrate on

    @property
    def reductions(self) -> Mapping[str, ErrorReduction]:
        """Error reductions by the extension over 2 s, by axis."""
        return self.extension.horizons["2"]


@dataclass(frozen=True)
class HypothesisEvaluation:
    """Free runs of one model, compared with the baseline's."""

    prediction: Prediction  # Free runs over all flights
    reductions: Mapping[str, ErrorReduction]  # Error reductions on the held-out flights over 2 s, by axis


def evaluate_hypothesis(
    hypothesis: Hypothesis,
    comparison: ModelComparison,
    runs_before: Sequence[FreeRun],
    calibrate_s: float | None,
) -> HypothesisEvaluation:
    """Simulate a model on all flights, and compare it with the baseline."""
    prediction = predict(hypothesis.estimate, comparison.train, comparison.held_out)
    runs = free_runs(prediction.fit, comparison.held_out, calibrate_s)
    reductions = compare_free_runs(runs_before, runs, comparison.seed).horizons["2"]
    return HypothesisEvaluation(prediction, reductions)


def evaluate_held_out(
    comparison: ModelComparison, search: Search, assessment: Assessment, calibrate_s: float | None = None
) -> HeldOutEvaluation:
    """Compare baseline, extended model and spline terms on the held-out flights."""
    before, after, flights = assessment.before, assessment.after, comparison.held_out
    runs_before = free_runs(before.fit, flights, calibrate_s)
    runs_after = runs_before if after is before else free_runs(after.fit, flights, calibrate_s)
    splines: Mapping[str, ErrorReduction] = {}
    if assessment.verdict.unlisted:
        splines = evaluate_hypothesis(search.final, comparison, runs_before, calibrate_s).reductions
    extension = compare_free_runs(runs_before, runs_after, comparison.seed)
    return HeldOutEvaluation(extension, splines, CALIBRATE_s if calibrate_s is None else calibrate_s)


def evaluate_extension(
    comparison: ModelComparison,
    before: Prediction,
    after: Prediction,
    whole: HeldOutEvaluation,
    calibrate_s: float | None,
) -> HeldOutEvaluation:
    """Compare the baseline and another extended model on the held-out flights."""
    runs_before = whole.extension.before
    runs_after = runs_before if after is before else free_runs(after.fit, comparison.held_out, calibrate_s)
    return replace(whole, extension=compare_free_runs(runs_before, runs_after, comparison.seed))


WORSE_HORIZON: Final = "1"
"""Horizon of the open-loop errors that decide, a key of `HORIZONS`: long enough to show a lag, and
too short for constants and slow terms to dominate."""
_TOO_SHORT: Final = "no other flight was given, and this one is too short to be divided into two folds"
_NO_OTHER_FLIGHT: Final = (
    "no other flight was given; it holds in both halves of the fitted flights, but the search has used both"
)


@dataclass(frozen=True)
class CauseReplication:
    """Whether a cause holds in both directions."""

    forward: float | None
    """forward, reverse: Log-likelihood ratios, nats: on the held-out flights with parameters from the fitted
    flights, and the reverse; None if a ratio was not computed."""
    reverse: float | None
    why_not: str  # Why the cause is not confirmed, in words; empty if it is

    @property
    def confirmed(self) -> bool:
        """Whether the cause is confirmed."""
        return not self.why_not


@dataclass(frozen=True)
class WorseAxis:
    """An axis whose open-loop error grows by more than its bootstrap interval."""

    axis: str  # Elevation, pitch or travel
    fitted: str
    """fitted, judged: Labels of the flights that estimated the parameters, and of the flights that are
    predicted."""
    judged: str
    reduction: ErrorReduction  # The errors at `WORSE_HORIZON`


@dataclass(frozen=True)
class Replication:
    """Confirmed causes, and the model with them alone."""

    causes: Mapping[str, CauseReplication]  # By effect id
    model: Hypothesis
    """The model with the confirmed causes, and with events that happened in one of its flights only."""
    prediction: Prediction  # Its free runs over all flights
    evaluation: HeldOutEvaluation  # Its free-run errors on the held-out flights
    worse: tuple[WorseAxis, ...]  # Axes that the model with all named causes predicts worse
    with_causes: Callable[[Sequence[str]], Prediction] | None = field(repr=False, compare=False)
    """Returns the prediction of the model with some of the named causes, which is estimated if needed; None
    in a result that was pickled, because the search that it continues is not."""

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "with_causes": None}

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
    """Determine which causes are confirmed, and evaluate the model with these causes alone."""
    ids = [cause.effect for cause in assessment.verdict.causes]
    if not ids:
        return Replication(
            {},
            assessment.extended,
            prediction=assessment.after,
            evaluation=evaluation,
            worse=(),
            with_causes=lambda _ids: assessment.after,
        )
    models = _CauseSubsets(comparison, search, assessment, evaluation, calibrate_s)
    if models.directions is None:
        causes = {id_: CauseReplication(forward=None, reverse=None, why_not=_TOO_SHORT) for id_ in ids}
        return _replication(models, causes, worse=())
    reasons = {id_: models.contradiction(id_) for id_ in ids}
    worse_with_all = models.worse_axes(ids)
    confirmed_ids = [id_ for id_ in ids if not reasons[id_]]
    # Drop causes one by one until no axis is predicted worse than by the baseline.
    while True:
        are_all_confirmed = len(confirmed_ids) == len(ids)
        worse = worse_with_all if are_all_confirmed else models.worse_axes(confirmed_ids)
        if not worse:
            break
        harmful_id = models.most_harmful(confirmed_ids, worse)
        confirmed_ids.remove(harmful_id)
        reasons[harmful_id] = worse_axis_sentence(worse[0], "the model with it")
    if not comparison.held_out:
        reasons = {id_: reason or _NO_OTHER_FLIGHT for id_, reason in reasons.items()}
    forward_ratios, reverse_ratios = models.ratios
    causes = {
        id_: CauseReplication(forward_ratios.get(id_), reverse_ratios.get(id_), reasons[id_]) for id_ in ids
    }
    return _replication(models, causes, worse_with_all)


def worse_axis_sentence(worse: WorseAxis, model: str = "the extended model") -> str:
    """Describe an axis that a `model` predicts worse, without a full stop."""
    low, high = worse.reduction.interval95
    return (
        f"{model}, fitted on {worse.fitted}, predicts {worse.axis} of {worse.judged} worse than the "
        f"baseline: its error at {WORSE_HORIZON} s is {worse.reduction.ratio:.2f} times as large "
        f"({low:.2f} to {high:.2f})"
    )


def _replication(
    models: _CauseSubsets, causes: Mapping[str, CauseReplication], worse: tuple[WorseAxis, ...]
) -> Replication:
    """Return the result with the model of the confirmed causes."""
    confirmed_ids = [id_ for id_, cause in causes.items() if cause.confirmed]
    evaluation = models.evaluation(confirmed_ids)
    return Replication(
        causes,
        models.hypothesis(confirmed_ids),
        prediction=evaluation.prediction,
        evaluation=evaluation.held_out,
        worse=worse,
        with_causes=lambda ids: models.evaluation(ids).prediction,
    )


class _SubsetEvaluation(NamedTuple):
    """Free runs over all flights of a model with some causes, and its errors on the held-out flights."""

    prediction: Prediction
    held_out: HeldOutEvaluation


class _CauseSubsets:
    """Models with subsets of the named causes, compared in both directions; each is computed once."""

    # The forward direction estimates on the fitted flights and evaluates on the held-out flights. The reverse
    # direction exchanges them. Without held-out flights, the directions use two folds.

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
        all_ids = frozenset(self.ids)
        # By the ids of a model's causes; free runs also by whether the direction is reverse.
        self._evaluations = {all_ids: _SubsetEvaluation(assessment.after, evaluation)}
        self._hypotheses = {all_ids: assessment.extended, frozenset[str](): search.baseline}
        self._baseline_runs: dict[bool, Sequence[FreeRun]] = {}
        self._reductions: dict[tuple[frozenset[str], bool], Mapping[str, ErrorReduction]] = {}

    @cached_property
    def directions(self) -> tuple[Direction | None, Direction] | None:
        """Fits of the forward and the reverse direction."""
        # With held-out flights, the forward direction is None: the search has estimated and evaluated it.
        # Without any, both directions use two folds, halves of the fitted flights; the result is None if a
        # fold is too short.
        comparison, final = self.comparison, self.search.final
        if comparison.held_out:
            held_out = comparison.held_out_estimate(final)
            return None, direction(comparison.exchanged(), final, held_out, final.estimate)
        folds = comparison.folds()
        if folds is None:
            return None
        forward = direction(folds, final, final.estimate, final.estimate)
        return forward, direction(folds.exchanged(), final, final.estimate, final.estimate)

    @cached_property
    def ratios(self) -> tuple[Mapping[str, float], Mapping[str, float]]:
        """Log-likelihood ratios of the causes in the forward and the reverse direction, nats, by id."""
        assert self.directions is not None
        forward, reverse = self.directions
        if forward is not None:
            return forward.log_likelihood_ratio, reverse.log_likelihood_ratio
        search_ratios = {cause.effect: cause.held_out_nats or 0.0 for cause in self.assessment.verdict.causes}
        return search_ratios, reverse.log_likelihood_ratio

    def contradiction(self, id_: str) -> str:
        """Return the reason why the log-likelihood ratios do not confirm a cause; empty if they do."""
        if self._is_of_one_flight(id_):
            return "it happened in one flight only"
        for ratios, (fitted, evaluated) in zip(self.ratios, self._side_labels, strict=True):
            if not ratios[id_] > 0.0:
                return (
                    f"fitted on {fitted}, it makes {evaluated} less likely "
                    f"(log-likelihood ratio {ratios[id_]:.1f} nats)"
                )
        return ""

    def _with_events(self, ids: Sequence[str]) -> frozenset[str]:
        """Return the ids of causes, and in addition those of events that happened in one flight only."""
        # Such an event stays in every model: it affects the fit of its flight, and no prediction of others.
        return frozenset(ids) | {id_ for id_ in self.ids if self._is_of_one_flight(id_)}

    def _is_of_one_flight(self, id_: str) -> bool:
        """Whether a cause is an event that no held-out flight has."""
        effect = next(candidate.effect for candidate in self.search.final.candidates if candidate.id == id_)
        labels = {record.label for record in self.comparison.held_out}
        return bool(effect.flight) and not labels & effect.other_moments_s.keys()

    def worse_axes(self, ids: Sequence[str]) -> tuple[WorseAxis, ...]:
        """Return the axes that the model with some causes predicts worse than the baseline."""
        if not ids:
            return ()
        return tuple(
            WorseAxis(axis, fitted, evaluated, reduction)
            for is_reverse, (fitted, evaluated) in zip((False, True), self._side_labels, strict=True)
            for axis, reduction in self.reductions(ids, is_reverse).items()
            if min(reduction.interval95) > 1.0  # surely larger errors than the baseline
        )

    def most_harmful(self, ids: Sequence[str], worse: Sequence[WorseAxis]) -> str:
        """Return the cause without which the errors of the `worse` axes are smallest."""
        if len(ids) == 1:
            return ids[0]
        (forward_fitted, _), _ = self._side_labels

        def log_error_without(id_: str) -> float:
            """Return the sum of the log error ratios of the worse axes without a cause."""
            other_ids = [other for other in ids if other != id_]
            total = 0.0
            for axis in worse:
                is_reverse = axis.fitted != forward_fitted
                total += math.log(self.reductions(other_ids, is_reverse)[axis.axis].ratio)
            return total

        return min(ids, key=log_error_without)

    def reductions(self, ids: Sequence[str], reverse: bool) -> Mapping[str, ErrorReduction]:
        """Compare the open-loop errors of the model with some causes and of the baseline, by axis."""
        assert self.directions is not None
        side = self.directions[int(reverse)]
        if side is None:
            return self.evaluation(ids).held_out.extension.horizons[WORSE_HORIZON]
        key = frozenset(ids), reverse
        if key not in self._reductions:
            if reverse not in self._baseline_runs:
                self._baseline_runs[reverse] = self._free_runs(side, side.baseline)
            runs = self._free_runs(side, self._refit(side, ids))
            self._reductions[key] = error_reduction(
                [run.errors[WORSE_HORIZON] for run in self._baseline_runs[reverse]],
                [run.errors[WORSE_HORIZON] for run in runs],
                self.comparison.seed,
            )
        return self._reductions[key]

    def hypothesis(self, ids: Sequence[str]) -> Hypothesis:
        """Return the model with some of the causes, estimated on the fitted flights."""
        key = self._with_events(ids)
        if key not in self._hypotheses:
            extended = self.assessment.extended
            candidates = [candidate for candidate in extended.candidates if candidate.id in key]
            self._hypotheses[key] = self.comparison.refit(candidates, None, extended)
        return self._hypotheses[key]

    def evaluation(self, ids: Sequence[str]) -> _SubsetEvaluation:
        """Simulate the model with some of the causes, and compare its errors with those of the baseline."""
        key = self._with_events(ids)
        if key not in self._evaluations:
            comparison, before = self.comparison, self.assessment.before
            hypothesis = self.hypothesis(ids)
            if hypothesis is self.search.baseline:
                after = before
            else:
                after = predict(hypothesis.estimate, comparison.train, comparison.held_out)
            with_all_causes = self._evaluations[frozenset(self.ids)].held_out
            held_out = evaluate_extension(comparison, before, after, with_all_causes, self.calibrate_s)
            self._evaluations[key] = _SubsetEvaluation(after, held_out)
        return self._evaluations[key]

    def _refit(self, side: Direction, ids: Sequence[str]) -> Hypothesis:
        """Return the model with some causes on the fitted flights of a direction, without splines."""
        key = self._with_events(ids)
        candidates = tuple(candidate for candidate in side.whole.candidates if candidate.id in key)
        if len(candidates) == len(side.whole.candidates):
            return side.whole
        return side.comparison.refit_from(candidates, side.whole.params, side.whole.estimate.disturbances)

    def _free_runs(self, side: Direction, hypothesis: Hypothesis) -> Sequence[FreeRun]:
        """Simulate the held-out flights of a direction."""
        return estimated_free_runs(
            hypothesis.estimate, side.comparison.held_out, self.calibrate_s, (WORSE_HORIZON,)
        )

    @cached_property
    def _side_labels(self) -> tuple[tuple[str, str], tuple[str, str]]:
        """Labels of the fitted and of the evaluated flights, in the forward and in the reverse direction."""
        first, second = "the first fold", "the second fold"
        if self.comparison.held_out:
            first = " and ".join(record.label for record in self.comparison.train)
            second = " and ".join(record.label for record in self.comparison.held_out)
        return (first, second), (second, first)
