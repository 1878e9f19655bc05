"""Search for the causes of what a model lacks: candidates, score tests, refits, stepwise selection."""

from heli_lab.explain.search.acceptance import Acceptance, min_margin
from heli_lab.explain.search.candidate import Candidate, ScoredCandidate, may_join, typical_candidate
from heli_lab.explain.search.estimate_cache import EstimateCache, fingerprint
from heli_lab.explain.search.folds import split
from heli_lab.explain.search.hypothesis import Alternative, Cause, Hypothesis, Refit, Round
from heli_lab.explain.search.model_comparison import ModelComparison
from heli_lab.explain.search.regressors import ExtendedModel, spline_candidate, spline_candidates
from heli_lab.explain.search.replication import Direction, direction, held_out_screening
from heli_lab.explain.search.resolution import limited_std
from heli_lab.explain.search.score_test import ScoreStatistics, score_of
from heli_lab.explain.search.screening import Screening, coefficient_std
from heli_lab.explain.search.splines import (
    KNOTS,
    QUANTITIES,
    SplineTerm,
    bspline_basis,
    knot_span,
    quantity_values,
    spline_term,
)
from heli_lab.explain.search.stepwise import Search, search

__all__ = [
    "KNOTS",
    "QUANTITIES",
    "Acceptance",
    "Alternative",
    "Candidate",
    "Cause",
    "Direction",
    "EstimateCache",
    "ExtendedModel",
    "Hypothesis",
    "ModelComparison",
    "Refit",
    "Round",
    "ScoreStatistics",
    "ScoredCandidate",
    "Screening",
    "Search",
    "SplineTerm",
    "bspline_basis",
    "coefficient_std",
    "direction",
    "fingerprint",
    "held_out_screening",
    "knot_span",
    "limited_std",
    "may_join",
    "min_margin",
    "quantity_values",
    "score_of",
    "search",
    "spline_candidate",
    "spline_candidates",
    "spline_term",
    "split",
    "typical_candidate",
]
