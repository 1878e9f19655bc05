"""The normal equations: windows' states eliminated, bounds kept."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from heli_lab.identify.functions import Floats
from heli_lab.identify.problem import Evaluation, Problem


def eliminate_states(
    problem: Problem,
    evaluations: Sequence[Evaluation],
    states: Sequence[Floats],
    reference: Sequence[Floats],
    variance: Sequence[Floats],
    weights: Sequence[Floats],
    *,
    damping: float = 0.0,
) -> tuple[Floats, Floats, list[tuple[Floats, Floats]]]:
    """Eliminate the windows' initial states from the normal equations.

    Parameters
    ----------
    problem : Problem
        What is fitted.
    evaluations : sequence of Evaluation
        Predictions of all records with their derivatives.
    states : sequence of ndarray (w, states)
        Initial states.
    reference : sequence of ndarray (w, states)
        What the initial states of effects are tied to.
    variance, weights : sequence of ndarray
        As in `Fit`.
    damping : float
        What the diagonal of the states grows by, as a share of itself.

    Returns
    -------
    information : ndarray (f, f)
        Of the free parameters, without priors.
    gradient : ndarray (f,)
        Negative gradient of half the sum of squares, without priors.
    follow : list of (ndarray (w, states), ndarray (w, states, k))
        For each record: the step of the states with the parameters fixed, and how the states follow the
        parameters that the record depends on.
    """
    nx, count = problem.state_count, len(problem.free)
    information, gradient = np.zeros((count, count)), np.zeros(count)
    follow = []
    for index, evaluation in enumerate(evaluations):
        assert evaluation.normal_matrix is not None
        scale = weights[index][:, None] / variance[index]
        normal = np.einsum("wa,waij->wij", scale, evaluation.normal_matrix)
        diagonal = np.arange(nx)
        own = normal[:, :nx, :nx].copy()
        coupling = normal[:, :nx, nx:].copy()  # to the parameters, and the gradient as last column
        if nx > 6:
            state_prior = 1.0 / problem.state_std**2
            own[:, diagonal[6:], diagonal[6:]] += state_prior
            coupling[:, 6:, -1] += state_prior * (reference[index] - states[index])[:, 6:]
        # A state that a window does not show at all must not make its block singular.
        own[:, diagonal, diagonal] *= 1.0 + damping
        own[:, diagonal, diagonal] += 1e-12 * own[:, diagonal, diagonal].max(axis=1, keepdims=True)
        answer = np.linalg.solve(own, coupling)
        schur = normal[:, nx:, nx:] - coupling.transpose(0, 2, 1) @ answer
        columns = problem.columns[index]
        information[np.ix_(columns, columns)] += schur[:, :-1, :-1].sum(axis=0)
        gradient[columns] += schur[:, :-1, -1].sum(axis=0)
        follow.append((answer[:, :, -1], answer[:, :, :-1]))
    return information, gradient, follow


def bounded_solve(matrix: Floats, right: Floats, low: Floats, high: Floats) -> Floats:
    """Solve a positive definite system within bounds.

    Parameters
    ----------
    matrix : ndarray (f, f)
        The system.
    right : ndarray (f,)
        Its right-hand side.
    low, high : ndarray (f,)
        Bounds of the solution.

    Returns
    -------
    ndarray (f,)
        The solution; what would leave its bounds is on them, and the rest is solved again.
    """
    move = np.zeros(len(right))
    fixed = np.zeros(len(right), bool)
    for _ in range(len(right) + 1):
        loose = ~fixed
        if not loose.any():
            break
        rest = right[loose] - matrix[np.ix_(loose, fixed)] @ move[fixed]
        move[loose] = np.linalg.solve(matrix[np.ix_(loose, loose)], rest)
        outside = loose & ((move < low) | (move > high))
        if not outside.any():
            break
        move[outside] = np.clip(move[outside], low[outside], high[outside])
        fixed |= outside
    return move
