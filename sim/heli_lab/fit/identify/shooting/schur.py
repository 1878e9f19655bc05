"""Eliminate the initial states from the normal equations of multiple shooting, by the Schur complement."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats

from heli_lab.fit.identify.estimation_problem import Problem
from heli_lab.fit.identify.estimation_problem.problem import RIGID_STATES
from heli_lab.fit.identify.shooting.shooting_cost import Iterate, ShootingCost

SINGULAR_GUARD: Final = 1e-12
"""Added to the diagonal of a block, as a share of its largest entry. It keeps the block regular if a
state has no influence on the measured angles. It is far above the rounding of doubles, and far below any
information."""


def eliminate(matrices: Floats, count: int, guard: float = 0.0) -> tuple[Floats, Floats]:
    """Eliminate the leading unknowns of symmetric systems [[A, B], [B', C]] by the Schur complement. Shapes:
    `matrices` (..., m, m); returns `complement` (..., m - count, m - count), `gain` (..., count, m -
    count).

    The right-hand side may be appended to a system as its last row and column. The last column of the
    complement is then the right-hand side of the reduced system. The last column of the gain is A^-1 times
    the first part of the right-hand side.
    """
    leading = matrices[..., :count, :count].copy()
    coupling = matrices[..., :count, count:]
    diagonal = np.arange(count)
    if guard:
        leading[..., diagonal, diagonal] += guard * leading[..., diagonal, diagonal].max(
            axis=-1, keepdims=True
        )
    gain: Floats = np.linalg.solve(leading, coupling).astype(np.float64, copy=False)
    return matrices[..., count:, count:] - np.swapaxes(coupling, -1, -2) @ gain, gain


def add_state_prior(
    problem: Problem, normal: Floats, states: Floats, reference: Floats, damping: float | Floats = 0.0
) -> None:
    """Add the prior of the effects' initial states to the windows' normal equations, and damp the states.
    Shapes: `normal` (w, m, m), `states` (w, states), `reference` (w, states), `damping` (w,).
    """
    state_count = problem.state_count
    diagonal, effect_rows = np.arange(state_count), np.arange(RIGID_STATES, state_count)
    precision = 1.0 / problem.state_std**2
    normal[:, effect_rows, effect_rows] += precision
    prior_gradient = precision * (reference - states)[:, RIGID_STATES:]
    # The last row and the last column of the normal equations are the right-hand side.
    normal[:, effect_rows, -1] += prior_gradient
    normal[:, -1, effect_rows] += prior_gradient
    normal[:, diagonal, diagonal] *= 1.0 + np.reshape(damping, (-1, 1))


@dataclass(frozen=True)
class ReducedSystem:
    """Normal equations of the free parameters, from which the windows' initial states are eliminated."""

    information: Floats  # (f, f): Normal matrix of the free parameters, without priors
    gradient: Floats  # (f,): Negative gradient of half the sum of squares, without priors
    state_steps: list[Floats]
    """(w, states): For each record, the step of the initial states if the parameters stay fixed."""
    state_responses: list[Floats]
    """(w, states, k): For each record, minus the change of the initial states per unit of each of the k
    parameters that the record depends on."""
    predicted_reduction: float  # Reduction of the sum of squares by `state_steps`, if the sum were quadratic


def eliminate_states(cost: ShootingCost, iterate: Iterate, damping: float = 0.0) -> ReducedSystem:
    """Eliminate the windows' initial states from the normal equations of all records."""
    problem = cost.problem
    state_count, free_count = problem.state_count, len(problem.free)
    information, gradient = np.zeros((free_count, free_count)), np.zeros(free_count)
    state_steps, state_responses, predicted_reduction = [], [], 0.0
    for index, evaluation in enumerate(iterate.evaluations):
        # Sum over the axes a, each divided by its variance: shape (w, z + 1, z + 1).
        scale = cost.weights[index][:, None] / cost.variance[index]
        normal = np.einsum("wa,waij->wij", scale, evaluation.normal_matrix)
        add_state_prior(problem, normal, iterate.states[index], cost.state_prior[index], damping)
        complement, gain = eliminate(normal, state_count, SINGULAR_GUARD)
        columns = problem.columns[index]
        information[np.ix_(columns, columns)] += complement[:, :-1, :-1].sum(axis=0)
        gradient[columns] += complement[:, :-1, -1].sum(axis=0)
        predicted_reduction += float(np.sum(normal[:, :state_count, -1] * gain[:, :, -1]))
        state_steps.append(gain[:, :, -1])
        state_responses.append(gain[:, :, :-1])
    return ReducedSystem(information, gradient, state_steps, state_responses, predicted_reduction)
