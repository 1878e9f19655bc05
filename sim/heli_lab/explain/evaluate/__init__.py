"""Evaluation of a search: residual analysis, free runs on other flights, verdict, and what flights do not
show.
"""

from heli_lab.explain.evaluate.assessment import Assessment, assess
from heli_lab.explain.evaluate.detectability import undetectable_effects, unidentifiable_parameters
from heli_lab.explain.evaluate.error_reduction import ErrorReduction, compare_free_runs
from heli_lab.explain.evaluate.fitted_voltages import Extrapolation, extrapolations
from heli_lab.explain.evaluate.free_run import HORIZONS, FreeRun, calibration_s, free_runs
from heli_lab.explain.evaluate.held_out import (
    HeldOutEvaluation,
    HypothesisEvaluation,
    evaluate_held_out,
    evaluate_hypothesis,
)
from heli_lab.explain.evaluate.kicks import Kicks
from heli_lab.explain.evaluate.listed_remainder import with_listed_remainder
from heli_lab.explain.evaluate.prediction import predict
from heli_lab.explain.evaluate.prior_conflict import PriorConflict, prior_conflicts, tried_without
from heli_lab.explain.evaluate.regions import FailingRegions, RegionTest, failing_regions
from heli_lab.explain.evaluate.replication import WORSE_HORIZON, Replication, replicate, worse_axis_sentence
from heli_lab.explain.evaluate.reported import CauseParameter, cause_parameters
from heli_lab.explain.evaluate.residual_analysis import ResidualAnalysis, correlates
from heli_lab.explain.evaluate.thrust_noise import justified_thrust_noise
from heli_lab.explain.evaluate.verdict import NamedCause, Verdict, unconfirmed_confidence, with_confirmation

__all__ = [
    "HORIZONS",
    "WORSE_HORIZON",
    "Assessment",
    "CauseParameter",
    "ErrorReduction",
    "Extrapolation",
    "FailingRegions",
    "FreeRun",
    "HeldOutEvaluation",
    "HypothesisEvaluation",
    "Kicks",
    "NamedCause",
    "PriorConflict",
    "RegionTest",
    "Replication",
    "ResidualAnalysis",
    "Verdict",
    "assess",
    "calibration_s",
    "cause_parameters",
    "compare_free_runs",
    "correlates",
    "evaluate_held_out",
    "evaluate_hypothesis",
    "extrapolations",
    "failing_regions",
    "free_runs",
    "justified_thrust_noise",
    "predict",
    "prior_conflicts",
    "replicate",
    "tried_without",
    "unconfirmed_confidence",
    "undetectable_effects",
    "unidentifiable_parameters",
    "with_confirmation",
    "with_listed_remainder",
    "worse_axis_sentence",
]
