"""Initial states of single windows, optimised one by one with the free parameters fixed.

A joint Gauss-Newton step of all windows and parameters is accepted or rejected as a whole. Where the model
has kinks, as with dry friction and backlash, it may leave the basin of attraction of a window, and every
joint step would be rejected. Such a window returns in a few damped steps of its own.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from heli_host.arrays import Flags, Floats, Integers

from heli_lab.identify import thresholds
from heli_lab.identify.problem import Evaluation, Problem
from heli_lab.identify.schur import SINGULAR_GUARD, add_state_prior, eliminate

_DAMPING: Final = 1e-3
"""First damping of a window, as a share of its diagonal."""


def window_cost(
    problem: Problem,
    evaluation: Evaluation,
    states: Floats,
    reference: Floats,
    variance: Floats,
    weights: Floats,
) -> Floats:
    """Cost of each window of a record, shape (w,): weighted sums of squares with the states' prior; infinite
    where a prediction diverges.

    Parameters
    ----------
    states : ndarray (w, states)
        Initial states.
    reference : ndarray (w, states)
        Prior means of the initial states of effects.
    variance : ndarray (3,)
        Variance of each axis, by which its squared residuals are divided.
    weights : ndarray (w,)
        Weights of the windows.
    """
    assert evaluation.normal_matrix is not None
    cost = weights * (evaluation.normal_matrix[:, :, -1, -1] / variance).sum(axis=1)
    if problem.state_count > 6:
        cost = cost + (((states - reference)[:, 6:] / problem.state_std) ** 2).sum(axis=1)
    result: Floats = np.where(np.isfinite(cost), cost, np.inf)
    return result


def refine_states(
    problem: Problem,
    index: int,
    theta: Floats,
    states: Floats,
    evaluation: Evaluation,
    reference: Floats,
    variance: Floats,
    which: Integers,
    *,
    before: Floats | None = None,
    fine: bool = False,
    most: int = 4,
) -> tuple[Floats, Evaluation]:
    """Improve the initial states of some windows, each by Levenberg-Marquardt steps of its own.

    Parameters
    ----------
    index : int
        Which record.
    theta : ndarray (f,)
        Free parameters, which stay.
    states : ndarray (w, states)
        Initial states of all windows of the record.
    evaluation : Evaluation
        Predictions from them with their derivatives.
    reference : ndarray (w, states)
        Prior means of the initial states of effects.
    variance : ndarray (3,)
        Variance of each axis, by which its squared residuals are divided.
    which : ndarray of int64 (k,)
        Windows to improve.
    before : ndarray (w, states), optional
        Other states to start from, for windows in which they are better.
    fine : bool
        Compare every sample, as `evaluation` does.
    most : int
        Most steps.

    Returns
    -------
    states : ndarray (w, states)
        Initial states of all windows.
    evaluation : Evaluation
        Predictions from them.
    """
    some = _Windows(problem, index, theta, states, evaluation, reference, variance, which, fine)
    if before is not None:
        some.offer(before[which])
    some.descend(most, thresholds.WINDOW_PATIENCE)
    return some.inserted(states, evaluation)


def restart_states(
    problem: Problem,
    index: int,
    theta: Floats,
    states: Floats,
    evaluation: Evaluation,
    reference: Floats,
    variance: Floats,
    which: Integers,
    other: Floats,
    *,
    fine: bool = False,
    most: int = 12,
) -> tuple[Floats, Evaluation]:
    """Optimise some windows from other initial states, and keep the result where it is better.

    Parameters
    ----------
    problem, index, theta, states, evaluation, reference, variance, which, fine, most
        As in `refine_states`.
    other : ndarray (w, states)
        Initial states to start from, of all windows of the record.

    Returns
    -------
    states : ndarray (w, states)
        Initial states of all windows.
    evaluation : Evaluation
        Predictions from them.
    """
    some = _Windows(problem, index, theta, states, evaluation, reference, variance, which, fine)
    again = _Windows(problem, index, theta, states, evaluation, reference, variance, which, fine)
    again.cost[:] = np.inf
    again.offer(other[which])
    again.descend(most, thresholds.RESTART_PATIENCE)
    some.take(again)
    return some.inserted(states, evaluation)


class _Windows:
    """The best states so far of some windows, with their cost."""

    def __init__(
        self,
        problem: Problem,
        index: int,
        theta: Floats,
        states: Floats,
        evaluation: Evaluation,
        reference: Floats,
        variance: Floats,
        which: Integers,
        fine: bool,
    ) -> None:
        assert evaluation.normal_matrix is not None
        whole = problem.grid(index, fine, theta)
        self.problem, self.which, self.variance = problem, which, variance
        self.grid = whole.only(which)
        self.rows = np.concatenate([np.arange(whole.slices[i].start, whole.slices[i].stop) for i in which])
        self.parameters, self.reference = problem.parameters(theta, index), reference[which]
        self.states, self.normal_matrix = states[which].copy(), evaluation.normal_matrix[which].copy()
        self.residual = evaluation.residual[self.rows].copy()
        self.cost = self._cost(self.states, self.normal_matrix)

    def offer(self, states: Floats) -> Flags:
        """Replace states by other `states` if these are better; return for each window whether they are."""
        measured, sigma = self.grid.measured_rad, self.grid.record.sigma_rad
        kernel = self.problem.kernel
        angles, normal_matrix = kernel.products(self.grid.inputs, states, self.parameters, measured, sigma)
        cost = self._cost(states, normal_matrix)
        better: Flags = cost < self.cost
        self.states[better], self.normal_matrix[better], self.cost[better] = (
            states[better],
            normal_matrix[better],
            cost[better],
        )
        rows = np.repeat(better, self.grid.inputs.steps)
        self.residual[rows] = ((measured - angles) / sigma)[rows]
        return better

    def take(self, other: _Windows) -> None:
        """Replace states by those of another optimisation of the same windows if these are better."""
        better = other.cost < self.cost
        self.states[better], self.normal_matrix[better] = other.states[better], other.normal_matrix[better]
        self.cost[better] = other.cost[better]
        rows = np.repeat(better, self.grid.inputs.steps)
        self.residual[rows] = other.residual[rows]

    def descend(self, most: int, patience: int) -> None:
        """Take damped steps while the cost falls enough."""
        damping, idle = np.full(len(self.which), _DAMPING), 0
        for _ in range(most):
            if not np.isfinite(self.cost).all() or idle == patience:
                break
            total = float(self.cost.sum())
            better = self.offer(self.step(damping))
            damping = np.where(better, 0.2 * damping, 30.0 * damping)
            idle = 0 if total - float(self.cost.sum()) > thresholds.WORTHWHILE_GAIN * total else idle + 1

    def step(self, damping: Floats) -> Floats:
        """States after a damped Gauss-Newton step, each window's damping in units of its own diagonal."""
        nx = self.problem.state_count
        normal = np.einsum("a,waij->wij", 1.0 / self.variance, self.normal_matrix)
        add_state_prior(self.problem, normal, self.states, self.reference, damping)
        residual = [*range(nx), normal.shape[1] - 1]
        _, gain = eliminate(normal[:, residual][:, :, residual], nx, SINGULAR_GUARD)
        result: Floats = self.states + gain[:, :, 0]
        return result

    def inserted(self, states: Floats, evaluation: Evaluation) -> tuple[Floats, Evaluation]:
        """Return states and evaluation of all windows of the record, with these windows replaced."""
        assert evaluation.normal_matrix is not None
        all_states, normal_matrix, residual = (
            states.copy(),
            evaluation.normal_matrix.copy(),
            evaluation.residual.copy(),
        )
        all_states[self.which], normal_matrix[self.which], residual[self.rows] = (
            self.states,
            self.normal_matrix,
            self.residual,
        )
        return all_states, Evaluation(residual, normal_matrix)

    def _cost(self, states: Floats, normal_matrix: Floats) -> Floats:
        evaluation = Evaluation(self.residual, normal_matrix)
        return window_cost(
            self.problem, evaluation, states, self.reference, self.variance, np.ones(len(self.which))
        )
