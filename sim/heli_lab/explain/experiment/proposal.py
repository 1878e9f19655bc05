"""The next experiment: what to fly if a diagnosis is ambiguous, unexplained, or rests on little data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from heli_sim.model.effects import EffectSpec

from heli_lab.explain.discover.spline_curve import spline_curves_of
from heli_lab.explain.evaluate.assessment import Assessment
from heli_lab.explain.experiment.design import (
    ExperimentDesign,
    Pair,
    compose_experiment,
    discriminating_experiment,
    informative_experiment,
)
from heli_lab.explain.search.hypothesis import Refit
from heli_lab.explain.search.model_comparison import ModelComparison
from heli_lab.explain.search.stepwise import Search
from heli_lab.explain.thresholds import MANY_UNDETECTABLE, SHORT_s


def propose_experiment(
    comparison: ModelComparison,
    search: Search,
    assessment: Assessment,
    kinds: Mapping[str, EffectSpec],
    undetectable: Sequence[str],
) -> ExperimentDesign | None:
    """Propose the next flight."""
    label = assessment.verdict.label
    pair = _closest_pair(comparison, search, assessment) if label == "ambiguous" else None
    if pair is not None:
        return discriminating_experiment(pair, comparison, kinds)
    if label == "unexplained":
        return _wider_range(search, assessment)
    seconds = sum(record.used_s for record in comparison.train)
    if seconds < SHORT_s or len(undetectable) > MANY_UNDETECTABLE:
        missing_effects = ", ".join(undetectable) or "small effects"
        return informative_experiment(
            f"{seconds:.0f} s of free flight are too short to show {missing_effects}.",
            undetectable,
            search.baseline,
            kinds,
        )
    return None


def _wider_range(search: Search, assessment: Assessment) -> ExperimentDesign:
    """Compose a flight over a wider range of the quantities on which the missing term depends."""
    unlisted = assessment.verdict.unlisted
    quantities = {cause.candidate.dependence[1] for cause in unlisted}
    parts = {part for part in ("travel", "elevation", "time") if any(part in name for name in quantities)}
    if any("thrust" in name for name in quantities) or not quantities:
        parts.add("motors")
    covered = " and ".join(
        f"{curve.on} only from {curve.quantity[0]:.3g} to {curve.quantity[-1]:.3g} {curve.quantity_unit}"
        for curve in spline_curves_of(unlisted, search.final.estimate)
    )
    limit = f"These flights cover {covered}. " if covered else ""
    return compose_experiment(f"{limit}A wider range would show more of the missing term.", parts)


def _closest_pair(comparison: ModelComparison, search: Search, assessment: Assessment) -> Pair | None:
    """Return the extended model, and the same model with its least certain cause replaced by an alternative.

    The alternative is the closest one. The result is None if no cause is ambiguous, or if the search did not
    refit the alternative.
    """
    ambiguous_causes = [cause for cause in assessment.verdict.causes if cause.ambiguous_with]
    if not ambiguous_causes:
        return None
    least_certain = min(ambiguous_causes, key=lambda cause: cause.alternatives[0].log_likelihood_ratio)
    alternative = least_certain.alternatives[0]
    refit = _refit_of_round(search, least_certain.candidate.id, alternative.id)
    if refit is None:
        return None
    extended = assessment.extended
    other_causes = [other for other in extended.candidates if other.id != least_certain.candidate.id]
    with_alternative = refit.hypothesis
    if other_causes:
        with_alternative = comparison.refit(
            [*other_causes, refit.candidate], with_alternative.values, extended
        )
    ids = (least_certain.candidate.id, alternative.id)
    return Pair(extended, with_alternative, ids, alternative.log_likelihood_ratio)


def _refit_of_round(search: Search, accepted_id: str, candidate_id: str) -> Refit | None:
    """Return the refit of a candidate in the round that accepted another candidate; None without one."""
    for round_ in search.rounds:
        if round_.accepted_id != accepted_id:
            continue
        for refit in round_.refits:
            if refit.candidate.id == candidate_id:
                return refit
    return None
