"""Assessment of a search: what the model with the causes leaves and predicts, and the verdict."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from heli_sim.model.effects import EffectSpec

from heli_lab.explain.evaluate.absent_terms import AbsentTerm, absent_terms
from heli_lab.explain.evaluate.prediction import Prediction, predict
from heli_lab.explain.evaluate.relevance import prediction_changes, spline_change
from heli_lab.explain.evaluate.residual_analysis import ResidualAnalysis, residual_analysis
from heli_lab.explain.evaluate.verdict import Verdict, judge, small_effects
from heli_lab.explain.search.hypothesis import Hypothesis
from heli_lab.explain.search.model_comparison import ModelComparison
from heli_lab.explain.search.replication import held_out_screening
from heli_lab.explain.search.stepwise import Search
from heli_lab.explain.thresholds import MATTERS_COUNTS


@dataclass(frozen=True)
class Assessment:
    """Remaining errors and predictions of the model with the causes, and the verdict."""

    residual_analysis: ResidualAnalysis  # Analysis of the residuals of the final model
    extended: Hypothesis
    """The model with the named causes of the catalogue, without spline terms and without effects that are too
    small to matter: the one that a simulator can fly."""
    before: Prediction
    """before, after: Free runs of the refitted baseline and of the extended model over all flights."""
    after: Prediction
    absent: tuple[AbsentTerm, ...]  # Terms of the baseline whose parameters the fit estimated as zero
    verdict: Verdict  # The verdict and its causes


def assess(comparison: ModelComparison, search: Search, kinds: Mapping[str, EffectSpec]) -> Assessment:
    """Assess the result of a search: residuals, predictions, effects too small to matter, and the verdict."""
    train, held_out = comparison.train, comparison.held_out
    held_out_screenings = []
    if comparison.can_test_held_out:
        held_out_screenings = [held_out_screening(comparison, search.final)]
    residual = residual_analysis([search.screening, *held_out_screenings])
    extended = without_splines(comparison, search)
    before = predict(search.baseline.estimate, train, held_out)
    after = before if extended is search.baseline else predict(extended.estimate, train, held_out)
    absent = absent_terms(after.fit, comparison.rig, kinds)
    changes = prediction_changes(comparison, search, extended, before, after)
    spline_counts = spline_change(comparison, search, extended, after)
    small_changes = {id_: counts for id_, counts in changes.items() if counts < MATTERS_COUNTS}
    small = small_effects(search, small_changes, kinds, after.fit)
    if small:
        # The extended model has only the effects that matter.
        extended = without(comparison, search, extended, small_changes)
        after = before if extended is search.baseline else predict(extended.estimate, train, held_out)
        absent = absent_terms(after.fit, comparison.rig, kinds)
    verdict = judge(search, residual, after, kinds, bool(absent), small, spline_counts)
    return Assessment(residual, extended=extended, before=before, after=after, absent=absent, verdict=verdict)


def without_splines(comparison: ModelComparison, search: Search) -> Hypothesis:
    """Refit the final model of a `search` without its spline terms, which no simulator flies."""
    effects = [candidate for candidate in search.final.candidates if not candidate.is_spline]
    if len(effects) == len(search.final.candidates):
        return search.final
    if not effects:
        return search.baseline
    return comparison.refit(effects, None, search.final)


def without(
    comparison: ModelComparison, search: Search, extended: Hypothesis, ids: Collection[str]
) -> Hypothesis:
    """Refit an `extended` model without the effects `ids`."""
    other_effects = [candidate for candidate in extended.candidates if candidate.id not in ids]
    return comparison.refit(other_effects, None, extended) if other_effects else search.baseline
