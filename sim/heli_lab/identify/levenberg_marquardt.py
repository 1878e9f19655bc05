"""Levenberg-Marquardt with the windows' initial states eliminated.

The normal equations have a block for each window's initial state, coupled only to the free parameters. Their
Schur complement is a system of the free parameters alone.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from heli_host.arrays import Floats, Integers

from heli_lab.estimation.bounded_solve import bounded_solve
from heli_lab.identify import thresholds
from heli_lab.identify.fit import Budget, FitProgress
from heli_lab.identify.grid import Grid
from heli_lab.identify.initial_states import alternative_states, initial_state_guess
from heli_lab.identify.problem import Evaluation, Problem
from heli_lab.identify.residual_noise import floor_axes, long_run_variance, window_weights
from heli_lab.identify.schur import eliminate_states
from heli_lab.identify.window_states import refine_states, restart_states, window_cost


@dataclass
class Point:
    """A guess of parameters and initial states, with everything that the next step needs.

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


class LevenbergMarquardt:
    """State of a fit: weights, damping, and the steps that change them. If `robust`, outlying windows lose
    weight; `on_progress` is called with the progress of the fit.
    """

    def __init__(
        self,
        problem: Problem,
        budget: Budget,
        robust: bool,
        on_progress: Callable[[FitProgress], None] | None,
    ) -> None:
        self.problem = problem
        self.robust = robust
        self.budget = budget
        self.on_progress = on_progress
        self.started_s = time.perf_counter()
        self.evaluations = 0
        self.damping = 0.0
        self.fine = False
        self.variance: list[Floats] = []
        self.weights: list[Floats] = []
        self.reference: list[Floats] = []
        self._first: tuple[Floats, list[Floats]] | None = None
        self.frozen = np.zeros(len(problem.free), bool)
        """Which free parameters keep their values for now, shape (f,)."""

    def out_of_budget(self) -> bool:
        """Whether the fit has cost what it may."""
        seconds = time.perf_counter() - self.started_s
        return self.evaluations >= self.budget.evaluations or seconds >= self.budget.seconds

    def initial_state_guess(self, theta: Floats) -> list[Floats]:
        """Initial states that the angles suggest with free parameters `theta`, shape (f,), as of
        `initial_states.initial_state_guess`, worked out once for as long as these stay.
        """
        if self._first is None or not np.array_equal(self._first[0], theta):
            self._first = theta.copy(), initial_state_guess(self.problem, theta)
        return [states.copy() for states in self._first[1]]

    def evaluate(self, theta: Floats, states: list[Floats]) -> Point:
        """Predict all records from a guess, with residuals, derivatives and cost: free parameters `theta`,
        shape (f,), and initial `states` of the windows of each record, shape (w, states).
        """
        evaluations = [
            self.problem.evaluation(index, theta, start, fine=self.fine) for index, start in enumerate(states)
        ]
        self.evaluations += 1
        point = Point(theta, states, evaluations)
        point.cost = self._cost(point) if self.variance else math.inf
        return point

    def reweight(self, point: Point) -> float:
        """Estimate variances and weights again from the residuals of a `point`, whose cost is updated; return
        the largest relative change of a variance.
        """
        variance, weights = [], []
        for index, evaluation in enumerate(point.evaluations):
            grid = self.problem.grid(index, self.fine, point.theta)
            record_variance, weight = self._variance_and_weights(evaluation, grid)
            variance.append(record_variance)
            weights.append(weight)
        change = (
            max(
                float(np.max(np.abs(new / old - 1))) for new, old in zip(variance, self.variance, strict=True)
            )
            if self.variance
            else math.inf
        )
        self.variance, self.weights = variance, weights
        point.cost = self._cost(point)
        return change

    def _variance_and_weights(self, evaluation: Evaluation, grid: Grid) -> tuple[Floats, Floats]:
        """Long-run variance of a record's axes and robust weights of its windows, by turns."""
        weight = np.ones(len(grid.slices))
        for _ in range(thresholds.WEIGHT_TURNS if self.robust else 1):
            rows = np.repeat(weight, grid.inputs.steps)[:, None]
            share = float(np.mean(rows))
            kept = evaluation.residual * np.sqrt(rows)
            variance = np.maximum(1.0, long_run_variance(kept, grid.slices, grid.inputs.step_s) / share)
            variance = floor_axes(variance, np.mean(kept**2, axis=0) / share, grid.record.sigma_rad)
            before = weight
            if self.robust:
                weight = window_weights(evaluation.residual, grid.slices, variance)
            if np.array_equal(weight, before):
                break
        return variance, weight

    def _cost(self, point: Point) -> float:
        problem = self.problem
        prior = (point.theta - problem.parameter_vector.mean) / problem.parameter_vector.std
        total = float(prior @ prior)
        total += float(sum(self._window_cost(point, index).sum() for index in range(len(point.evaluations))))
        return total if math.isfinite(total) else math.inf

    def update_state_prior(self, point: Point) -> None:
        """Take the prior means of effects' states from the flight before their windows, with the parameters
        of a `point`.
        """
        if self.problem.state_count > 6:
            self.reference = self.initial_state_guess(point.theta)

    def _window_cost(self, point: Point, index: int) -> Floats:
        of_record = self.reference[index], self.variance[index], self.weights[index]
        return window_cost(self.problem, point.evaluations[index], point.states[index], *of_record)

    def _refine(self, point: Point, index: int, which: Integers, before: Floats | None, most: int) -> None:
        """Optimise the initial states of some windows of a point alone."""
        of_record = self.reference[index], self.variance[index], which
        point.states[index], point.evaluations[index] = refine_states(
            self.problem,
            index,
            point.theta,
            point.states[index],
            point.evaluations[index],
            *of_record,
            before=before,
            fine=self.fine,
            most=most,
        )
        point.cost = self._cost(point)

    def _recover_windows(self, point: Point, before: Point) -> None:
        """Optimise the windows alone whose cost a joint step raised."""
        for index in range(len(point.evaluations)):
            old, new = self._window_cost(before, index), self._window_cost(point, index)
            with np.errstate(invalid="ignore"):
                lost = (new > thresholds.LEFT_BEHIND * old) & (
                    new - old > thresholds.LEFT_BEHIND_SHARE * before.cost
                )
            if lost.any():
                self._refine(point, index, np.flatnonzero(lost), before.states[index], 4)

    def _reoptimise_states(self, point: Point) -> Point | None:
        """Re-optimise the initial states with the parameters fixed; None where they have converged."""
        other = Point(point.theta, list(point.states), list(point.evaluations), point.cost)
        for index, states in enumerate(point.states):
            self._refine(other, index, np.arange(len(states)), None, 6)
        return other if other.cost < thresholds.WORTHWHILE * point.cost else None

    def restart_outliers(self, point: Point) -> bool:
        """Optimise outlying windows from alternative initial states; return whether the cost fell by more
        than `thresholds.WORTHWHILE` says.
        """
        before = point.cost
        for index in range(len(point.evaluations)):
            of_record = self.reference[index], self.variance[index]
            # In the second turn the window before may have left its own wrong basin.
            for turn in range(thresholds.RESTARTS):
                normal_matrix = point.evaluations[index].normal_matrix
                assert normal_matrix is not None
                steps = self.problem.grid(index, self.fine, point.theta).inputs.steps
                squares = normal_matrix[:, :, -1, -1].sum(axis=1) / (3 * steps)
                usual = float(np.median(squares))
                lost = np.flatnonzero(squares > thresholds.RESTART_OUTLIER * usual)
                if not len(lost) or usual > thresholds.TOO_WRONG:
                    break
                others = alternative_states(self.problem, index, point.theta, point.states[index])
                for other in others if turn == 0 else others[:1]:
                    point.states[index], point.evaluations[index] = restart_states(
                        self.problem,
                        index,
                        point.theta,
                        point.states[index],
                        point.evaluations[index],
                        *of_record,
                        lost,
                        other,
                        fine=self.fine,
                    )
        point.cost = self._cost(point)
        return point.cost < thresholds.WORTHWHILE * before

    def reduced(
        self, point: Point, damping: float = 0.0
    ) -> tuple[Floats, Floats, list[tuple[Floats, Floats]], float]:
        """Normal equations of the free parameters alone, see `eliminate_states`.

        Parameters
        ----------
        damping : float
            Damping of the initial states, as a share of their diagonal.

        Returns
        -------
        information : ndarray (f, f)
            Normal matrix of the free parameters, without priors.
        gradient : ndarray (f,)
            Negative gradient of half the sum of squares, without priors.
        follow : list of (ndarray (w, states), ndarray (w, states, k))
            How the initial states follow.
        gain : float
            Reduction of the sum of squares by the step of the initial states with the parameters fixed.
        """
        of_records = point.evaluations, point.states, self.reference, self.variance, self.weights
        return eliminate_states(self.problem, *of_records, damping=damping)

    def _step(self, point: Point) -> tuple[Floats, list[Floats], Floats, float]:
        """A damped Gauss-Newton step, the standard errors, and the cost that the step is to save."""
        problem = self.problem
        information, gradient, follow, gain = self.reduced(point, thresholds.STATE_DAMPING * self.damping)
        weight = 1.0 / problem.parameter_vector.std**2
        right = gradient + weight * (problem.parameter_vector.mean - point.theta)
        # Damped in units of the priors: weak combinations of known numbers may move that far and no more.
        matrix = information + np.diag((1.0 + self.damping) * weight)
        limits = [
            np.where(self.frozen, 0.0, bound - point.theta) for bound in problem.parameter_vector.bounds
        ]
        move = bounded_solve(matrix, right, *limits)
        states = [
            start + free - np.einsum("wsf,f->ws", slave, move[columns])
            for start, (free, slave), columns in zip(point.states, follow, problem.columns, strict=True)
        ]
        std = np.sqrt(np.diag(np.linalg.inv(matrix))) if len(move) else np.zeros(0)
        return move, states, std, gain + float(move @ (2.0 * right - matrix @ move))

    def descend(
        self, point: Point, stage: str, share: tuple[float, float], most: int = thresholds.COARSE_STEPS
    ) -> tuple[Point, bool]:
        """Step until steps are small.

        Parameters
        ----------
        stage : str
            Name of the stage for `on_progress`, in a few words.
        share : (float, float)
            Shares of the work done before and after.
        most : int
            Most steps.

        Returns
        -------
        point : Point
            The best found.
        converged : bool
            False when the budget ran out first.
        """
        growth, states_optimised, idle = 2.0, False, 0
        for number in range(most):
            if self.on_progress is not None:
                done = share[0] + (share[1] - share[0]) * (1 - 0.5**number)
                self.on_progress(FitProgress(stage, done, point.cost))
            move, states, std, promised = self._step(point)
            if self.out_of_budget():
                return point, False
            if self.damping == 0.0 and promised < thresholds.SMALL_STEP**2:
                return point, True
            other = self.evaluate(point.theta + move, states)
            self._recover_windows(other, point)
            small = not len(move) or bool(np.all(np.abs(move) < thresholds.SMALL_STEP * std))
            if not other.cost < point.cost * (1 + 1e-12):
                if not states_optimised:
                    states_optimised, nearer = True, self._reoptimise_states(point)
                    if nearer is not None:
                        point = nearer
                        continue
                if self.damping > thresholds.LARGEST_DAMPING or (small and len(move)):
                    return point, True
                self.damping = max(1.0, growth * self.damping)
                growth *= 2.0
                continue
            gain = (point.cost - other.cost) / max(other.cost, 1e-300)
            # After a rejected step the damping comes down slowly, or every second step is rejected.
            self.damping *= 0.2 if growth == 2.0 else 0.5
            self.damping = self.damping if self.damping > thresholds.MIN_DAMPING else 0.0
            growth, states_optimised, point = 2.0, False, other
            idle = idle + 1 if gain < (0.2 if self.fine else 1.0) * thresholds.IDLE_GAIN else 0
            if idle == 2 or (
                self.damping < 1.0
                and (gain < thresholds.CONVERGED_GAIN or (small and gain < thresholds.IDLE_GAIN))
            ):
                return point, True
        return point, True
