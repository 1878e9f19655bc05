"""A quadratic minimised within bounds, by an active set."""

from __future__ import annotations

from typing import Final

import numpy as np
from heli_host.arrays import Booleans, Floats, Integers

from heli_lab.estimation.arrowhead import NO_BLOCKS, solve_arrowhead

_ROUNDING: Final = 1e-12
"""Share of the greatest gain of any unknown alone; a release that gains less is rounding."""


def bounded_solve(
    matrix: Floats, right: Floats, low: Floats, high: Floats, per_flight: Integers = NO_BLOCKS
) -> Floats:
    """Minimise the quadratic of a positive definite system, xᵀ matrix x / 2 - rightᵀ x, within bounds.

    First all unknowns that would leave their bounds are set on them, until none would. Then those that the
    gradient pulls inside are released singly (BVLS: Stark and Parker, Comput. Stat. 10 (1995) 129).

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

    def minimum(x: Floats, free: Booleans) -> Floats:
        """Minimum over the `free` unknowns; the others stay at `x`."""
        rest = np.where(free, right - matrix[:, ~free] @ x[~free], 0.0)
        decoupled = np.where(free[:, None] & free, matrix, np.diag(np.where(free, 0.0, 1.0)))
        return np.where(free, solve_arrowhead(decoupled, rest, per_flight), x)

    x, free = np.zeros(len(right)), np.ones(len(right), bool)
    while free.any():
        target = minimum(x, free)
        x = np.clip(target, low, high)
        if np.array_equal(x, target):
            break
        free &= x == target
    curvature = np.diag(matrix)
    # Each release reduces the quadratic, so that few are needed; the limit ends a cycle of rounding errors.
    for _ in range(3 * len(right)):
        gradient = right - matrix @ x
        pulled = ~free & (low < high) & np.where(x <= low, gradient > 0.0, gradient < 0.0)
        gain = np.where(pulled, gradient**2 / curvature, 0.0)
        if not np.any(gain > _ROUNDING * np.max(right**2 / curvature)):
            break
        free[gain.argmax()] = True
        target = minimum(x, free)
        while np.any(outside := (target < low) | (target > high)):
            # As far as the first bound on the way, where these unknowns stay.
            bound = np.where(target > high, high, low)
            share = (bound[outside] - x[outside]) / (target[outside] - x[outside])
            first = np.flatnonzero(outside)[share <= share.min()]
            x = np.where(free, x + share.min() * (target - x), x)
            x[first] = bound[first]
            free[first] = False
            target = minimum(x, free)
        x = target
    return x
