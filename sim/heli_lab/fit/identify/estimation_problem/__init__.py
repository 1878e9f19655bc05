"""The estimation problem: windows of flights, free parameters, noise, and the fit."""

from heli_lab.fit.identify.estimation_problem.fit import Budget, Fit, FitProgress
from heli_lab.fit.identify.estimation_problem.problem import Evaluation, Problem
from heli_lab.fit.identify.estimation_problem.uncertainty import (
    Combination,
    combinations,
    uninformed_parameters,
)

__all__ = [
    "Budget",
    "Combination",
    "Evaluation",
    "Fit",
    "FitProgress",
    "Problem",
    "combinations",
    "uninformed_parameters",
]
