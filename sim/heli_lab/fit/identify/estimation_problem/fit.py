"""Budget, progress and result of a fit."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from heli_host.data.arrays import Floats

from heli_lab.fit.identify.estimation_problem.problem import Problem


@dataclass(frozen=True)
class Budget:
    """Limits of a fit.

    Parameters
    ----------
    max_evaluations : int
        Largest number of predictions of all flights with derivatives.
    max_time_s : float
        Longest time on this computer [s].
    """

    max_evaluations: int = 80
    max_time_s: float = math.inf


@dataclass(frozen=True)
class FitProgress:
    """Progress of a fit.

    Parameters
    ----------
    stage : str
        Name of the present stage, in a few words.
    done : float
        Share of the work done, 0 to 1; an estimate.
    cost : float
        Weighted sum of squares.
    """

    stage: str
    done: float
    cost: float


@dataclass(frozen=True)
class Fit:
    """Estimates with their covariance.

    Parameters
    ----------
    theta : ndarray (f,)
        Free parameters.
    covariance : ndarray (f, f)
        Posterior covariance: flights and priors.
    information : ndarray (f, f)
        Fisher information of the flights alone: inverse covariance without priors.
    states : tuple of ndarray (w, states)
        Initial states of the windows of each record.
    variance : tuple of ndarray (3,)
        For each record, the variance by which the squared residuals of each axis were divided, in variances
        of the quantisation: 1 if the residuals are quantisation alone.
    weights : tuple of ndarray (w,)
        Robust weights of the windows of each record, 0 to 1.
    cost : float
        Weighted sum of squares plus priors.
    at_bound : tuple of str
        Names of parameters that lie on a bound.
    evaluations : int
        Predictions of all flights with derivatives.
    elapsed_s : float
        Time that the fit took [s].
    converged : bool
        Whether further steps would not change the estimates noticeably. False when the budget, or the largest
        number of steps or rounds, ended the fit before.
    """

    problem: Problem
    theta: Floats
    covariance: Floats
    information: Floats
    states: tuple[Floats, ...]
    variance: tuple[Floats, ...]
    weights: tuple[Floats, ...]
    cost: float
    at_bound: tuple[str, ...]
    evaluations: int
    elapsed_s: float
    converged: bool

    @property
    def values(self) -> dict[str, float]:
        """Free parameters by name."""
        return self.problem.parameter_vector.by_name(self.theta)

    @property
    def std(self) -> dict[str, float]:
        """Standard errors by name."""
        return self.problem.parameter_vector.by_name(np.sqrt(np.diag(self.covariance)))

    @property
    def correlation(self) -> Floats:
        """Correlations of the free parameters, shape (f, f)."""
        std = np.sqrt(np.diag(self.covariance))
        return np.asarray(self.covariance / np.outer(std, std))
