"""Evaluation on held-out flights: free runs before and after, calibrated on the beginning of each flight."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from heli_lab.explain.evaluate.assessment import Assessment
from heli_lab.explain.evaluate.error_reduction import ErrorReduction, HeldOutComparison, compare_free_runs
from heli_lab.explain.evaluate.free_run import FreeRun, free_runs
from heli_lab.explain.evaluate.prediction import Prediction, predict
from heli_lab.explain.search.hypothesis import Hypothesis
from heli_lab.explain.search.model_comparison import ModelComparison
from heli_lab.explain.search.stepwise import Search
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
