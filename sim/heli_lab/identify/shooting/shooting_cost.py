"""The cost of a fit: weighted squares of all windows' residuals, with the priors.

Its weights are estimated from the residuals themselves, between the searches for the minimum.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from heli_host.arrays import Floats

from heli_lab.identify import thresholds
from heli_lab.identify.estimation_problem import Evaluation, Problem
from heli_lab.identify.estimation_problem.grid import Grid
from heli_lab.identify.estimation_problem.initial_states import initial_state_guess
from heli_lab.identify.estimation_problem.problem import RIGID_STATES
from heli_lab.identify.estimation_problem.residual_noise import floor_axes, long_run_variance, window_weights


@dataclass
class Iterate:
    """Values of the parameters and initial states, with everything that the next step needs.

    Parameters
    ----------
    theta : ndarray (f,)
        Free parameters.
    states : list of ndarray (w, states)
        Initial states of the windows of each record.
    evaluations : list of Evaluation
        Predictions of each record with their derivatives.
    cost : float
        Weighted sum of squares plus priors.
    """

    theta: Floats
    states: list[Floats]
    evaluations: list[Evaluation]
    cost: float = math.inf


def window_cost(
    problem: Problem,
    squares: Floats,
    states: Floats,
    prior_mean: Floats,
    variance: Floats,
    weights: Floats | float = 1.0,
) -> Floats:
    """Cost of each window of a record, shape (w,): weighted sums of squares with the states' prior; infinite
    if a prediction diverges.

    Parameters
    ----------
    squares : ndarray (w, 3)
        Sum of the squared residuals of each window and axis.
    states : ndarray (w, states)
        Initial states.
    prior_mean : ndarray (w, states)
        Prior means of the initial states of effects.
    variance : ndarray (3,)
        Variance of each axis, by which its squared residuals are divided.
    weights : ndarray (w,), optional
        Weights of the windows.
    """
    deviation = (states - prior_mean)[:, RIGID_STATES:] / problem.state_std
    cost = weights * (squares / variance).sum(axis=1) + (deviation**2).sum(axis=1)
    return np.where(np.isfinite(cost), cost, np.inf)


class ShootingCost:
    """Cost of multiple shooting: each window is predicted from its own initial state.

    Parameters
    ----------
    problem : Problem
        The model and the windows.
    robust : bool
        Whether outlying windows lose weight.

    Attributes
    ----------
    fine : bool
        Whether every sample is compared, not the coarse grid alone.
    variance : list of ndarray (3,)
        For each record the variance by which the squares of each axis are divided.
    weights : list of ndarray (w,)
        Weights of the windows of each record.
    state_prior : list of ndarray (w, states)
        Prior means of the initial states of effects.
    evaluations : int
        Number of evaluations so far.
    """

    def __init__(self, problem: Problem, robust: bool) -> None:
        self.problem, self.robust = problem, robust
        self.fine = False
        self.variance: list[Floats] = []
        self.weights: list[Floats] = []
        self.state_prior: list[Floats] = []
        self.evaluations = 0
        self._guess: tuple[Floats, list[Floats]] | None = None

    def initial_state_guess(self, theta: Floats) -> list[Floats]:
        """Guess the initial states from the angles, with free parameters `theta`, shape (f,): as
        `initial_states.initial_state_guess`, computed once for as long as the parameters stay the same.
        """
        if self._guess is None or not np.array_equal(self._guess[0], theta):
            self._guess = theta.copy(), initial_state_guess(self.problem, theta)
        return [states.copy() for states in self._guess[1]]

    def evaluate(self, theta: Floats, states: list[Floats]) -> Iterate:
        """Predict all records, with residuals, derivatives and cost, from free parameters `theta`, shape
        (f,), and initial `states` of the windows of each record, shape (w, states).
        """
        evaluations = [
            self.problem.evaluation(index, theta, start, fine=self.fine) for index, start in enumerate(states)
        ]
        self.evaluations += 1
        iterate = Iterate(theta, states, evaluations)
        iterate.cost = self.cost(iterate) if self.variance else math.inf
        return iterate

    def cost(self, iterate: Iterate) -> float:
        """Cost of an `iterate` with the present weights; infinite if a prediction diverges."""
        vector = self.problem.parameter_vector
        prior = (iterate.theta - vector.mean) / vector.std
        total = float(prior @ prior)
        total += float(sum(self.window_cost(iterate, i).sum() for i in range(len(iterate.evaluations))))
        return total if math.isfinite(total) else math.inf

    def window_cost(self, iterate: Iterate, index: int) -> Floats:
        """Cost of each window of record `index`, shape (w,)."""
        of_record = self.state_prior[index], self.variance[index], self.weights[index]
        return window_cost(
            self.problem, iterate.evaluations[index].squares, iterate.states[index], *of_record
        )

    def reweight(self, iterate: Iterate) -> float:
        """Estimate variances and weights again from the residuals of an `iterate`, whose cost is updated;
        return the largest relative change of a variance.
        """
        before = self.variance
        estimates = [
            self._variance_and_weights(evaluation, self.problem.grid(index, self.fine, iterate.theta))
            for index, evaluation in enumerate(iterate.evaluations)
        ]
        self.variance = [variance for variance, _ in estimates]
        self.weights = [weights for _, weights in estimates]
        iterate.cost = self.cost(iterate)
        changes = [
            float(np.max(np.abs(new / old - 1))) for new, old in zip(self.variance, before, strict=False)
        ]
        return max(changes, default=math.inf)

    def _variance_and_weights(self, evaluation: Evaluation, grid: Grid) -> tuple[Floats, Floats]:
        """Long-run variance of a record's axes and robust weights of its windows, by turns."""
        weight = np.ones(len(grid.slices))
        for _ in range(thresholds.WEIGHT_TURNS if self.robust else 1):
            rows = np.repeat(weight, grid.inputs.steps)[:, None]
            share = float(np.mean(rows))
            weighted = evaluation.residual * np.sqrt(rows)
            variance = np.maximum(1.0, long_run_variance(weighted, grid.slices, grid.inputs.step_s) / share)
            variance = floor_axes(variance, np.mean(weighted**2, axis=0) / share, grid.record.sigma_rad)
            before = weight
            if self.robust:
                weight = window_weights(evaluation.residual, grid.slices, variance)
            if np.array_equal(weight, before):
                break
        return variance, weight

    def update_state_prior(self, iterate: Iterate) -> None:
        """Set the prior means of effects' states to those after the flight before their windows, with the
        parameters of an `iterate`.
        """
        if self.problem.state_count > RIGID_STATES:
            self.state_prior = self.initial_state_guess(iterate.theta)
