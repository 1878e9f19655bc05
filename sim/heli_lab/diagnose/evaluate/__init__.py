"""Evaluation of a search: residual analysis, free runs on other flights, verdict, and what flights do not
show.
"""

from heli_lab.diagnose.evaluate.absent_terms import AbsentTerm
from heli_lab.diagnose.evaluate.assessment import Assessment, assess
from heli_lab.diagnose.evaluate.detectability import undetectable_effects, unidentifiable_parameters
from heli_lab.diagnose.evaluate.error_reduction import ErrorReduction, compare_free_runs
from heli_lab.diagnose.evaluate.free_run import HORIZONS, FreeRun, calibration_s, free_runs
from heli_lab.diagnose.evaluate.held_out import (
    HeldOutEvaluation,
    HypothesisEvaluation,
    evaluate_held_out,
    evaluate_hypothesis,
)
from heli_lab.diagnose.evaluate.kicks import Kicks
from heli_lab.diagnose.evaluate.prediction import predict
from heli_lab.diagnose.evaluate.prior_conflict import PriorConflict, prior_conflicts, tried_without
from heli_lab.diagnose.evaluate.regions import FailingRegions, RegionTest, failing_regions
from heli_lab.diagnose.evaluate.reported import CauseParameter, cause_parameters, reported_std
from heli_lab.diagnose.evaluate.residual_analysis import ResidualAnalysis, correlates
from heli_lab.diagnose.evaluate.verdict import NamedCause, Verdict, confidence

__all__ = [
    "HORIZONS",
    "AbsentTerm",
    "Assessment",
    "CauseParameter",
    "ErrorReduction",
    "FailingRegions",
    "FreeRun",
    "HeldOutEvaluation",
    "HypothesisEvaluation",
    "Kicks",
    "NamedCause",
    "PriorConflict",
    "RegionTest",
    "ResidualAnalysis",
    "Verdict",
    "assess",
    "calibration_s",
    "cause_parameters",
    "compare_free_runs",
    "confidence",
    "correlates",
    "evaluate_held_out",
    "evaluate_hypothesis",
    "failing_regions",
    "free_runs",
    "predict",
    "prior_conflicts",
    "reported_std",
    "tried_without",
    "undetectable_effects",
    "unidentifiable_parameters",
]
