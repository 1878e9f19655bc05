"""Recover windows that diverged in a joint step, or that converged to a wrong local minimum."""

from __future__ import annotations

import numpy as np

from heli_lab.fit.identify import thresholds
from heli_lab.fit.identify.estimation_problem.initial_states import alternative_states
from heli_lab.fit.identify.shooting.shooting_cost import Iterate, ShootingCost
from heli_lab.fit.identify.shooting.window_states import refine_states, restart_states


def recover_windows(cost: ShootingCost, iterate: Iterate, before: Iterate) -> None:
    """Optimise the diverged windows of an `iterate` separately; the others stay unchanged."""
    for index in range(len(iterate.evaluations)):
        old_cost, new_cost = cost.window_cost(before, index), cost.window_cost(iterate, index)
        with np.errstate(invalid="ignore"):
            is_raised = new_cost - old_cost > thresholds.DIVERGED_SHARE * before.cost
        diverged = np.flatnonzero(is_raised & (new_cost > thresholds.DIVERGED_FACTOR * old_cost))
        if len(diverged):
            refine_states(cost, iterate, index, diverged, before=before.states[index])


def reoptimise_states(cost: ShootingCost, iterate: Iterate) -> Iterate | None:
    """Optimise all initial states of an `iterate`, with its parameters fixed."""
    refined = Iterate(iterate.theta, list(iterate.states), list(iterate.evaluations), iterate.cost)
    for index, states in enumerate(iterate.states):
        refine_states(cost, refined, index, np.arange(len(states)), max_steps=6)
    return refined if refined.cost < (1.0 - thresholds.WORTHWHILE_GAIN) * iterate.cost else None


def restart_outliers(cost: ShootingCost, iterate: Iterate) -> bool:
    """Optimise the outlying windows of an `iterate` from alternative initial states; change it in place."""
    problem, cost_before = cost.problem, iterate.cost
    for index in range(len(iterate.evaluations)):
        for turn in range(thresholds.RESTARTS):
            steps = problem.grid(index, cost.fine, iterate.theta).inputs.steps
            # Mean over the three angles and the steps of each window.
            mean_square = iterate.evaluations[index].squares.sum(axis=1) / (3 * steps)
            median = float(np.median(mean_square))
            outlying = np.flatnonzero(mean_square > thresholds.RESTART_OUTLIER * median)
            if not len(outlying) or median > thresholds.MAX_RESTART_MEDIAN:
                break
            alternatives = alternative_states(problem, index, iterate.theta, iterate.states[index])
            # In later turns only the first alternative is new: the end of the previous window, which may have
            # left its own wrong minimum.
            for start in alternatives if turn == 0 else alternatives[:1]:
                restart_states(cost, iterate, index, outlying, start)
    return iterate.cost < (1.0 - thresholds.WORTHWHILE_GAIN) * cost_before
