"""Optimise the initial states of single windows, with the free parameters fixed.

A joint Gauss-Newton step of all windows and parameters is accepted or rejected as a whole. If the model has
kinks, as with dry friction and backlash, a single window may diverge, and every joint step would be rejected.
A few damped steps of that window alone correct this.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from heli_host.data.arrays import Booleans, Floats, Integers

from heli_lab.fit.identify import thresholds
from heli_lab.fit.identify.estimation_problem import Evaluation
from heli_lab.fit.identify.shooting.schur import SINGULAR_GUARD, add_state_prior, eliminate
from heli_lab.fit.identify.shooting.shooting_cost import Iterate, ShootingCost, window_cost

_DAMPING: Final = 1e-3
"""Damping of a window's first step, as a share of the diagonal of its normal matrix."""
_RESTART_STEPS: Final = 12
"""Largest number of steps from another start: three times those of a refinement, because the start is far."""


def refine_states(
    cost: ShootingCost,
    iterate: Iterate,
    index: int,
    windows: Integers,
    *,
    before: Floats | None = None,
    max_steps: int = 4,
) -> None:
    """Improve the initial states of some windows of an `iterate`, each by its own Levenberg-Marquardt steps.
    Shapes: `windows` (k,), `before` (w, states).
    """
    search = _WindowSearch(cost, iterate, index, windows)
    if before is not None:
        search.replace_if_better(before[windows])
    search.descend(max_steps, thresholds.WINDOW_PATIENCE)
    search.write_back(cost, iterate, index)


def restart_states(
    cost: ShootingCost, iterate: Iterate, index: int, windows: Integers, start: Floats
) -> None:
    """Optimise some windows of an `iterate` from other initial states, and keep the result if it is better.
    Shapes: `start` (w, states).
    """
    present = _WindowSearch(cost, iterate, index, windows)
    restarted = _WindowSearch(cost, iterate, index, windows)
    # An infinite cost makes the search accept the other states, even if they are worse at first.
    restarted.cost[:] = np.inf
    restarted.replace_if_better(start[windows])
    restarted.descend(_RESTART_STEPS, thresholds.RESTART_PATIENCE)
    present.merge_better(restarted)
    present.write_back(cost, iterate, index)


class _WindowSearch:
    """Best initial states so far of some windows of a record, each window with its own cost. `steps` has
    shape (m,). `variance` has shape (3,). `parameters` has shape (p,). `prior_mean` has shape (k,
    states). `normal_matrix` has shape (k, 3, z + 1, z + 1). `residual` has shape (m, 3).
    """

    def __init__(self, cost: ShootingCost, iterate: Iterate, index: int, windows: Integers) -> None:
        problem, evaluation = cost.problem, iterate.evaluations[index]
        record_grid = problem.grid(index, cost.fine, iterate.theta)
        self._problem, self.windows, self.variance = problem, windows, cost.variance[index]
        self.grid, self.steps = record_grid.only(windows), record_grid.steps_of(windows)
        self.parameters = problem.parameters(iterate.theta, index)
        self.prior_mean = cost.state_prior[index][windows]
        self.states = iterate.states[index][windows].copy()
        self.normal_matrix = evaluation.normal_matrix[windows].copy()
        self.residual = evaluation.residual[self.steps].copy()
        self.cost = self._window_costs(self.states, evaluation.squares[windows])

    def replace_if_better(self, states: Floats) -> Booleans:
        """Replace the states of those windows for which other `states`, shape (k, states), cost less.
        Returns shape (k,).
        """
        evaluation = self._problem.evaluate_grid(self.grid, states, self.parameters)
        cost = self._window_costs(states, evaluation.squares)
        is_better: Booleans = cost < self.cost
        self._replace(is_better, states, evaluation.normal_matrix, cost, evaluation.residual)
        return is_better

    def merge_better(self, other: _WindowSearch) -> None:
        """Replace the states of those windows for which an `other` search of the same windows costs less."""
        is_better = other.cost < self.cost
        self._replace(is_better, other.states, other.normal_matrix, other.cost, other.residual)

    def _replace(
        self, is_better: Booleans, states: Floats, normal_matrix: Floats, cost: Floats, residual: Floats
    ) -> None:
        """Replace the states of the windows `is_better`, shape (k,), with all that depends on them."""
        self.states[is_better] = states[is_better]
        self.normal_matrix[is_better] = normal_matrix[is_better]
        self.cost[is_better] = cost[is_better]
        steps = np.repeat(is_better, self.grid.inputs.steps)
        self.residual[steps] = residual[steps]

    def descend(self, max_steps: int, patience: int) -> None:
        """Take damped steps until `patience` steps in a row reduced the cost too little."""
        damping, idle_steps = np.full(len(self.windows), _DAMPING), 0
        for _ in range(max_steps):
            if not np.isfinite(self.cost).all() or idle_steps == patience:
                break
            cost_before = float(self.cost.sum())
            is_better = self.replace_if_better(self._states_after_step(damping))
            damping = np.where(is_better, 0.2 * damping, 30.0 * damping)
            reduction = cost_before - float(self.cost.sum())
            idle_steps = 0 if reduction > thresholds.WORTHWHILE_GAIN * cost_before else idle_steps + 1

    def _states_after_step(self, damping: Floats) -> Floats:
        """Return the states after a Levenberg-Marquardt step of each window, shape (k, states). Shapes:
        `damping` (k,).
        """
        state_count = self._problem.state_count
        normal = np.einsum("a,waij->wij", 1.0 / self.variance, self.normal_matrix)
        add_state_prior(self._problem, normal, self.states, self.prior_mean, damping)
        # The parameters are fixed: keep the rows and columns of the states and of the right-hand side.
        kept_rows = [*range(state_count), normal.shape[1] - 1]
        _, gain = eliminate(normal[:, kept_rows][:, :, kept_rows], state_count, SINGULAR_GUARD)
        return self.states + gain[:, :, 0]

    def write_back(self, cost: ShootingCost, iterate: Iterate, index: int) -> None:
        """Write these windows into record `index` of an `iterate`, and update the cost of the iterate."""
        evaluation = iterate.evaluations[index]
        states = iterate.states[index].copy()
        residual, normal_matrix = evaluation.residual.copy(), evaluation.normal_matrix.copy()
        states[self.windows] = self.states
        residual[self.steps] = self.residual
        normal_matrix[self.windows] = self.normal_matrix
        # New arrays, because other iterates may share the old ones.
        iterate.states[index] = states
        iterate.evaluations[index] = Evaluation(residual, normal_matrix)
        iterate.cost = cost.cost(iterate)

    def _window_costs(self, states: Floats, squares: Floats) -> Floats:
        """Cost of each window, shape (k,), from its initial states and its sum of squares per axis."""
        return window_cost(self._problem, squares, states, self.prior_mean, self.variance)
