"""Estimate a model's parameters and their standard errors from flights."""

from __future__ import annotations

from heli_lab.identify.check import FreeRunErrors, Trace, check, trace, validate
from heli_lab.identify.fit import Budget, Fit, FitProgress
from heli_lab.identify.problem import Problem
from heli_lab.identify.record import Record, prepare
from heli_lab.identify.solve import solve
from heli_lab.identify.uncertainty import Combination, combinations, uninformed_parameters

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
