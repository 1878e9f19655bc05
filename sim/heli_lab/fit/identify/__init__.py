"""Estimate a model's parameters and their standard errors from flights."""

from heli_lab.fit.identify.estimation_problem import (
    Budget,
    Combination,
    Fit,
    FitProgress,
    Problem,
    combinations,
    uninformed_parameters,
)
from heli_lab.fit.identify.record import Record, prepare
from heli_lab.fit.identify.results import FreeRunErrors, Trace, check, trace, validate
from heli_lab.fit.identify.shooting import solve

__all__ = [
    "Budget",
    "Combination",
    "Fit",
    "FitProgress",
    "FreeRunErrors",
    "Problem",
    "Record",
    "Trace",
    "check",
    "combinations",
    "prepare",
    "solve",
    "trace",
    "uninformed_parameters",
    "validate",
]
