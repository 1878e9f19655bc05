"""Initial states of single windows, optimised one by one with the free parameters fixed.

A joint Gauss-Newton step of all windows and parameters is accepted or rejected as a whole. Where the model
has kinks, as with dry friction and backlash, it may leave the basin of attraction of a window, and every
joint step would be rejected. Such a window returns in a few damped steps of its own.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from heli_host.arrays import Booleans, Floats, Integers

from heli_lab.identify import thresholds
from heli_lab.identify.estimation_problem import Evaluation
from heli_lab.identify.shooting.schur import SINGULAR_GUARD, add_state_prior, eliminate
from heli_lab.identify.shooting.shooting_cost import Iterate, ShootingCost, window_cost

_DAMPING: Final = 1e-3
"""First damping of a window, as a share of its diagonal."""
_RESTART_STEPS: Final = 12
"""Most steps of a window from another start, which is far: three times those of a refinement."""


def refine_states(
    cost: ShootingCost,
    iterate: Iterate,
    index: int,
    which: Integers,
    *,
    before: Floats | None = None,
    most: int = 4,
) -> None:
    """Improve the initial states of some windows of an `iterate`, each by its own Levenberg-Marquardt steps.

    Parameters
    ----------
    cost : ShootingCost
        Its variances apply; weights of windows do not.
    index : int
        Which record.
    which : ndarray of int64 (k,)
        Windows to improve.
    before : ndarray (w, states), optional
        Other states to start from, for windows in which they are better.
    most : int
        Most steps.
    """
    windows = _Windows(cost, iterate, index, which)
    if before is not None:
        windows.offer(before[which])
    windows.descend(most, thresholds.WINDOW_PATIENCE)
    windows.insert(cost, iterate, index)


def restart_states(cost: ShootingCost, iterate: Iterate, index: int, which: Integers, other: Floats) -> None:
    """Optimise some windows of an `iterate` from other initial states, and keep the result if it is better.

    Parameters
    ----------
    cost, index, which
        As in `refine_states`.
    other : ndarray (w, states)
        Initial states to start from, of all windows of the record.
    """
    windows, again = (_Windows(cost, iterate, index, which) for _ in range(2))
    again.cost[:] = np.inf
    again.offer(other[which])
    again.descend(_RESTART_STEPS, thresholds.RESTART_PATIENCE)
    windows.take(again)
    windows.insert(cost, iterate, index)


class _Windows:
    """The best states so far of some windows, with their cost."""

    def __init__(self, cost: ShootingCost, iterate: Iterate, index: int, which: Integers) -> None:
        problem, evaluation = cost.problem, iterate.evaluations[index]
        assert evaluation.normal_matrix is not None
        whole = problem.grid(index, cost.fine, iterate.theta)
        self.problem, self.which, self.variance = problem, which, cost.variance[index]
        self.grid = whole.only(which)
        self.rows = np.concatenate([np.arange(whole.slices[i].start, whole.slices[i].stop) for i in which])
        self.parameters = problem.parameters(iterate.theta, index)
        self.reference = cost.state_prior[index][which]
        self.states = iterate.states[index][which].copy()
        self.normal_matrix = evaluation.normal_matrix[which].copy()
        self.residual = evaluation.residual[self.rows].copy()
        self.cost = self._cost(self.states, self.normal_matrix)

    def offer(self, states: Floats) -> Booleans:
        """Replace states by other `states` if these are better; return for each window whether they are."""
        measured, sigma = self.grid.measured_rad, self.grid.record.sigma_rad
        kernel = self.problem.kernel
        angles, normal_matrix = kernel.products(self.grid.inputs, states, self.parameters, measured, sigma)
        cost = self._cost(states, normal_matrix)
        better: Booleans = cost < self.cost
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

    def insert(self, cost: ShootingCost, iterate: Iterate, index: int) -> None:
        """Replace these windows of a record in an `iterate`, and update its cost."""
        evaluation = iterate.evaluations[index]
        assert evaluation.normal_matrix is not None
        states, residual = iterate.states[index].copy(), evaluation.residual.copy()
        normal_matrix = evaluation.normal_matrix.copy()
        states[self.which], residual[self.rows] = self.states, self.residual
        normal_matrix[self.which] = self.normal_matrix
        iterate.states[index], iterate.evaluations[index] = states, Evaluation(residual, normal_matrix)
        iterate.cost = cost.cost(iterate)

    def _cost(self, states: Floats, normal_matrix: Floats) -> Floats:
        ones = np.ones(len(self.which))
        return window_cost(self.problem, normal_matrix, states, self.reference, self.variance, ones)
