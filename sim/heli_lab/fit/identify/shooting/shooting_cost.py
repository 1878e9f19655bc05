"""The cost of a multiple-shooting fit: weighted squares of all windows' residuals, plus those of the priors.

The weights are estimated from the residuals, between two searches for the minimum.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from heli_host.data.arrays import Floats

from heli_lab.fit.identify import thresholds
from heli_lab.fit.identify.estimation_problem import Evaluation, Problem
from heli_lab.fit.identify.estimation_problem.grid import Grid
from heli_lab.fit.identify.estimation_problem.initial_states import initial_state_guess
from heli_lab.fit.identify.estimation_problem.problem import RIGID_STATES
from heli_lab.fit.identify.estimation_problem.residual_noise import (
    floor_axes,
    long_run_variance,
    window_weights,
)


@dataclass
class Iterate:
    """Values of the parameters and initial states, with everything that the next step needs."""

    theta: Floats  # (f,): Free parameters
    states: list[Floats]  # (w, states): Initial states of the windows of each record
    evaluations: list[Evaluation]  # Predictions of each record with their derivatives
    cost: float = math.inf  # Weighted sum of squares plus priors


def window_cost(
    problem: Problem,
    squares: Floats,
    states: Floats,
    prior_mean: Floats,
    variance: Floats,
    weights: Floats | float = 1.0,
) -> Floats:
    """Compute the cost of each window of a record, shape (w,): the weighted sum of squared residuals, plus
    the prior of the initial states; infinite if a prediction diverges. Shapes: `squares` (w, 3), `states`
    (w, states), `prior_mean` (w, states), `variance` (3,), `weights` (w,).
    """
    deviation = (states - prior_mean)[:, RIGID_STATES:] / problem.state_std
    cost = weights * (squares / variance).sum(axis=1) + (deviation**2).sum(axis=1)
    return np.where(np.isfinite(cost), cost, np.inf)


class ShootingCost:
    """Cost of multiple shooting: each window is predicted from its own initial state. `variance` has shape
    (3,). `weights` has shape (w,). `state_prior` has shape (w, states).
    """

    def __init__(self, problem: Problem, robust: bool) -> None:
        self.problem, self.robust = problem, robust
        self.fine = False
        self.variance: list[Floats] = []
        self.weights: list[Floats] = []
        self.state_prior: list[Floats] = []
        self.evaluations = 0
        self._last_guess: tuple[Floats, list[Floats]] | None = None
        """Free parameters of the last guess of the initial states, and that guess."""

    def initial_state_guess(self, theta: Floats) -> list[Floats]:
        """Guess the initial states from the angles, with free parameters `theta`, shape (f,).

        The result of `initial_states.initial_state_guess` is kept until the parameters change.
        """
        if self._last_guess is None or not np.array_equal(self._last_guess[0], theta):
            self._last_guess = theta.copy(), initial_state_guess(self.problem, theta)
        _, guess = self._last_guess
        return [states.copy() for states in guess]

    def evaluate(self, theta: Floats, states: list[Floats]) -> Iterate:
        """Predict all records, and return residuals, derivatives and cost. Shapes: `theta` (f,), `states`
        (w, states).
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
        return window_cost(
            self.problem,
            iterate.evaluations[index].squares,
            iterate.states[index],
            self.state_prior[index],
            self.variance[index],
            self.weights[index],
        )

    def reweight(self, iterate: Iterate) -> float:
        """Estimate variances and weights from the residuals of an `iterate`, and update its cost with
        them.
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
        """Estimate the long-run variance of each axis, shape (3,), and the robust weight of each window,
        shape (w,), of a record.

        The two depend on each other, so that they are estimated in turn.
        """
        weights = np.ones(len(grid.slices))
        for _ in range(thresholds.WEIGHT_TURNS if self.robust else 1):
            row_weights = np.repeat(weights, grid.inputs.steps)[:, None]
            mean_weight = float(np.mean(row_weights))
            weighted = evaluation.residual * np.sqrt(row_weights)
            variance = np.maximum(
                1.0, long_run_variance(weighted, grid.slices, grid.inputs.step_s) / mean_weight
            )
            mean_square = np.mean(weighted**2, axis=0) / mean_weight
            variance = floor_axes(variance, mean_square, grid.record.sigma_rad)
            weights_before = weights
            if self.robust:
                weights = window_weights(evaluation.residual, grid.slices, variance)
            if np.array_equal(weights, weights_before):
                break
        return variance, weights

    def update_state_prior(self, iterate: Iterate) -> None:
        """Set the prior means of effects' states: simulate the flight before each window with the parameters
        of an `iterate`.
        """
        if self.problem.state_count > RIGID_STATES:
            self.state_prior = self.initial_state_guess(iterate.theta)
