"""Minimise a quadratic function within bounds, by an active-set method."""

from __future__ import annotations

from typing import Final

import numpy as np
from heli_host.data.arrays import Booleans, Floats, Integers

from heli_lab.fit.estimation.arrowhead import NO_BLOCKS, solve_arrowhead

_ROUNDING: Final = 1e-12
"""Share of the largest gain of any single unknown. If releasing an unknown gains less, the gain is
rounding."""


def bounded_solve(
    matrix: Floats, right: Floats, low: Floats, high: Floats, per_flight: Integers = NO_BLOCKS
) -> Floats:
    """Minimise xᵀ matrix x / 2 - rightᵀ x within bounds, for a positive definite matrix. Shapes: `matrix`
    (f, f), `right` (f,), `low, high` (f,), `per_flight` (flights, k); returns (f,).

    First, all unknowns that would leave their bounds are fixed on them, until none would leave. Then unknowns
    whose gradient points inside are released one by one (BVLS: Stark and Parker, Comput. Stat. 10 (1995)
    129).
    """

    def minimum(x: Floats, free: Booleans) -> Floats:
        """Minimise over the `free` unknowns; the others stay at `x`."""
        reduced_right = np.where(free, right - matrix[:, ~free] @ x[~free], 0.0)
        # Rows and columns of the identity replace those of the fixed unknowns, so that the size stays the
        # same.
        decoupled = np.where(free[:, None] & free, matrix, np.diag(np.where(free, 0.0, 1.0)))
        return np.where(free, solve_arrowhead(decoupled, reduced_right, per_flight), x)

    # First estimate: minimise, clip to the bounds, and fix what was clipped, until nothing is clipped.
    x, free = np.zeros(len(right)), np.ones(len(right), bool)
    while free.any():
        target = minimum(x, free)
        x = np.clip(target, low, high)
        if np.array_equal(x, target):
            break
        free &= x == target
    # Then release fixed unknowns one by one, as long as the quadratic decreases towards the inside.
    curvature = np.diag(matrix)
    # Each release reduces the quadratic, so that few are needed; the limit ends a cycle of rounding errors.
    for _ in range(3 * len(right)):
        descent = right - matrix @ x
        points_inside = np.where(x <= low, descent > 0.0, descent < 0.0)
        releasable = ~free & (low < high) & points_inside
        gain = np.where(releasable, descent**2 / curvature, 0.0)
        if not np.any(gain > _ROUNDING * np.max(right**2 / curvature)):
            break
        free[gain.argmax()] = True
        target = minimum(x, free)
        while np.any(outside := (target < low) | (target > high)):
            # Move towards the target up to the first bound on the way, and fix the unknowns that reach it.
            bound = np.where(target > high, high, low)
            share = (bound[outside] - x[outside]) / (target[outside] - x[outside])
            reached = np.flatnonzero(outside)[share <= share.min()]
            x = np.where(free, x + share.min() * (target - x), x)
            x[reached] = bound[reached]
            free[reached] = False
            target = minimum(x, free)
        x = target
    return x
