"""Initial states of single windows, each on its own way, with the free parameters as they are.

A step of all windows and parameters together is taken or not as a whole. Where the model has kinks, as dry
friction and play have, there is nearly always some window that the step throws out of its valley, and then
no step is taken at all. A window alone finds its way back in a few damped steps.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from heli_lab.identify.functions import Floats, Integers
from heli_lab.identify.problem import Evaluation, Problem

_FIRST_DAMPING: Final = 1e-3
_WORTH: Final = 0.01
"""Steps go on while they take this share off the cost of the windows together."""
_IDLE: Final = 2
"""Or did so one step before."""
_PATIENCE: Final = 5
"""The same for windows that start from elsewhere: damping has to grow before they find a way."""


def window_cost(
    problem: Problem,
    evaluation: Evaluation,
    states: Floats,
    reference: Floats,
    variance: Floats,
    weights: Floats,
) -> Floats:
    """Cost of each window of a record.

    Parameters
    ----------
    problem : Problem
        What is fitted.
    evaluation : Evaluation
        Predictions with their derivatives.
    states : ndarray (w, states)
        Initial states.
    reference : ndarray (w, states)
        What the initial states of effects are tied to.
    variance : ndarray (3,)
        What the squared residuals of each axis are divided by.
    weights : ndarray (w,)
        Weights of the windows.

    Returns
    -------
    ndarray (w,)
        Weighted sums of squares, with what ties the states of effects; infinite where a prediction diverges.
    """
    assert evaluation.normal_matrix is not None
    cost = weights * (evaluation.normal_matrix[:, :, -1, -1] / variance).sum(axis=1)
    if problem.state_count > 6:
        cost = cost + (((states - reference)[:, 6:] / problem.state_std) ** 2).sum(axis=1)
    result: Floats = np.where(np.isfinite(cost), cost, np.inf)
    return result


def relax(
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
    """Improve the initial states of some windows, each by Levenberg and Marquardt's rule for itself.

    Parameters
    ----------
    problem : Problem
        What is fitted.
    index : int
        Which record.
    theta : ndarray (f,)
        Free parameters, which stay.
    states : ndarray (w, states)
        Initial states of all windows of the record.
    evaluation : Evaluation
        Predictions from them with their derivatives.
    reference : ndarray (w, states)
        What the initial states of effects are tied to.
    variance : ndarray (3,)
        What the squared residuals of each axis are divided by.
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
    some.descend(most, _IDLE)
    return some.among(states, evaluation)


def restart(
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
    """Start some windows from elsewhere, and keep what they come to where it is better.

    Parameters
    ----------
    problem, index, theta, states, look, reference, variance, which, fine, most
        As in `relax`.
    other : ndarray (w, states)
        Where to start.

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
    again.descend(most, _PATIENCE)
    some.take(again)
    return some.among(states, evaluation)


class _Windows:
    """The best states so far of some windows."""

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

    def offer(self, states: Floats) -> npt.NDArray[np.bool_]:
        """Take other states where they are better; say where."""
        measured, sigma = self.grid.measured_rad, self.grid.record.sigma_rad
        kernel = self.problem.kernel
        angles, normal_matrix = kernel.products(self.grid.inputs, states, self.parameters, measured, sigma)
        cost = self._cost(states, normal_matrix)
        better: npt.NDArray[np.bool_] = cost < self.cost
        self.states[better], self.normal_matrix[better], self.cost[better] = (
            states[better],
            normal_matrix[better],
            cost[better],
        )
        rows = np.repeat(better, self.grid.inputs.steps)
        self.residual[rows] = ((measured - angles) / sigma)[rows]
        return better

    def take(self, other: _Windows) -> None:
        """Take what other states of the same windows came to, where that is better."""
        better = other.cost < self.cost
        self.states[better], self.normal_matrix[better] = other.states[better], other.normal_matrix[better]
        self.cost[better] = other.cost[better]
        rows = np.repeat(better, self.grid.inputs.steps)
        self.residual[rows] = other.residual[rows]

    def descend(self, most: int, patience: int) -> None:
        """Take damped steps while they are worth it."""
        damping, idle = np.full(len(self.which), _FIRST_DAMPING), 0
        for _ in range(most):
            if not np.isfinite(self.cost).all() or idle == patience:
                break
            total = float(self.cost.sum())
            better = self.offer(self.step(damping))
            damping = np.where(better, 0.2 * damping, 30.0 * damping)
            idle = 0 if total - float(self.cost.sum()) > _WORTH * total else idle + 1

    def step(self, damping: Floats) -> Floats:
        """States after a damped Gauss-Newton step, each window's damping in units of its own diagonal."""
        nx = self.problem.state_count
        diagonal = np.arange(nx)
        state_prior = np.concatenate((np.zeros(6), 1.0 / self.problem.state_std**2))
        normal = np.einsum("a,waij->wij", 1.0 / self.variance, self.normal_matrix)
        own = normal[:, :nx, :nx] + np.diag(state_prior)
        pull = normal[:, :nx, -1] + state_prior * (self.reference - self.states)
        own_diagonal = own[:, diagonal, diagonal]
        own[:, diagonal, diagonal] += damping[:, None] * own_diagonal
        # A state that a window does not show at all must not make its block singular.
        own[:, diagonal, diagonal] += 1e-12 * own_diagonal.max(axis=1, keepdims=True)
        result: Floats = self.states + np.linalg.solve(own, pull[:, :, None])[:, :, 0]
        return result

    def among(self, states: Floats, evaluation: Evaluation) -> tuple[Floats, Evaluation]:
        """Put them back among all windows."""
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
