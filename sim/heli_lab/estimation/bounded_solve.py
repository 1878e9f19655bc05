"""A quadratic minimised within bounds, by an active set."""

from __future__ import annotations

import numpy as np
from heli_host.arrays import Floats, Integers

from heli_lab.estimation.arrowhead import NO_BLOCKS, solve_arrowhead


def bounded_solve(
    matrix: Floats, right: Floats, low: Floats, high: Floats, per_flight: Integers = NO_BLOCKS
) -> Floats:
    """Solve a positive definite system within bounds.

    An unknown that would leave its bounds is set on the bound, and the others are solved again. This is
    Nocedal and Wright, Numerical Optimization, section 16.5, without the release of constraints.

    Parameters
    ----------
    matrix : ndarray (f, f)
        Matrix of the system.
    right : ndarray (f,)
        Its right-hand side.
    low, high : ndarray (f,)
        Bounds of the solution.
    per_flight : ndarray (flights, k), optional
        Unknowns that belong to a single flight, as `arrowhead.per_flight_columns` returns them.

    Returns
    -------
    ndarray (f,)
    """
    move = np.zeros(len(right))
    free = np.ones(len(right), bool)
    while free.any():
        rest = right - matrix[:, ~free] @ move[~free]
        # An unknown on its bound is decoupled from the others and does not move.
        held = np.where(free[:, None] & free, matrix, np.diag(np.where(free, 0.0, 1.0)))
        move[free] = solve_arrowhead(held, np.where(free, rest, 0.0), per_flight)[free]
        outside = free & ((move < low) | (move > high))
        if not outside.any():
            break
        move[outside] = np.clip(move, low, high)[outside]
        free &= ~outside
    return move
