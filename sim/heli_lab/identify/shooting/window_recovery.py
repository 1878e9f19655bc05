"""Recovery of windows that a joint step lost, or that are in a wrong basin of attraction."""

from __future__ import annotations

import numpy as np

from heli_lab.identify import thresholds
from heli_lab.identify.estimation_problem.initial_states import alternative_states
from heli_lab.identify.shooting.shooting_cost import Iterate, ShootingCost
from heli_lab.identify.shooting.window_states import refine_states, restart_states


def recover_windows(cost: ShootingCost, iterate: Iterate, before: Iterate) -> None:
    """Optimise alone those windows of an `iterate` whose cost a joint step raised over that `before`."""
    for index in range(len(iterate.evaluations)):
        old, new = cost.window_cost(before, index), cost.window_cost(iterate, index)
        with np.errstate(invalid="ignore"):
            is_raised = new - old > thresholds.DIVERGED_SHARE * before.cost
        lost = np.flatnonzero(is_raised & (new > thresholds.DIVERGED_FACTOR * old))
        if len(lost):
            refine_states(cost, iterate, index, lost, before=before.states[index])


def reoptimise_states(cost: ShootingCost, iterate: Iterate) -> Iterate | None:
    """Optimise all initial states with the parameters of an `iterate` fixed; None if they have converged."""
    other = Iterate(iterate.theta, list(iterate.states), list(iterate.evaluations), iterate.cost)
    for index, states in enumerate(iterate.states):
        refine_states(cost, other, index, np.arange(len(states)), max_steps=6)
    return other if other.cost < (1.0 - thresholds.WORTHWHILE_GAIN) * iterate.cost else None


def restart_outliers(cost: ShootingCost, iterate: Iterate) -> bool:
    """Optimise the outlying windows of an `iterate` from alternative initial states; return whether the cost
    fell by more than `thresholds.WORTHWHILE_GAIN` requires.
    """
    problem, before = cost.problem, iterate.cost
    for index in range(len(iterate.evaluations)):
        # In the second turn the window before may have left its own wrong basin.
        for turn in range(thresholds.RESTARTS):
            steps = problem.grid(index, cost.fine, iterate.theta).inputs.steps
            mean_square = iterate.evaluations[index].squares.sum(axis=1) / (3 * steps)
            typical = float(np.median(mean_square))
            lost = np.flatnonzero(mean_square > thresholds.RESTART_OUTLIER * typical)
            if not len(lost) or typical > thresholds.TOO_WRONG:
                break
            others = alternative_states(problem, index, iterate.theta, iterate.states[index])
            for other in others if turn == 0 else others[:1]:
                restart_states(cost, iterate, index, lost, other)
    return iterate.cost < (1.0 - thresholds.WORTHWHILE_GAIN) * before
