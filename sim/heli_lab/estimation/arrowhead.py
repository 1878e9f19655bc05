"""Normal equations of many flights: unknowns that all share, and each flight's own.

A flight's own unknowns meet those of no other flight: the matrix is block diagonal but for a border. Each
block is eliminated by itself, so that a solution costs as many small systems as there are flights, and not
the cube of all unknowns.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from heli_host.arrays import Floats, Integers

NO_BLOCKS: Final = np.zeros((0, 0), np.int64)
"""Blocks of a system without unknowns of one flight alone."""


def per_flight_columns(columns: Sequence[Integers], size: int) -> Integers:
    """Find the unknowns that each flight has of its own, shape (flights, k); k is 0 for one flight alone.

    Parameters
    ----------
    columns : sequence of ndarray
        For each flight, which unknowns it depends on.
    size : int
        Number of unknowns.
    """
    used = np.zeros(size, int)
    for column in columns:
        used[column] += 1
    if len(columns) < 2:
        return np.zeros((len(columns), 0), np.int64)
    return np.array([column[used[column] == 1] for column in columns], np.int64)


def solve_arrowhead(matrix: Floats, right: Floats, per_flight: Integers) -> Floats:
    """Solve a positive definite system, shape (f,) or (f, s) as its right-hand side.

    Parameters
    ----------
    matrix : ndarray (f, f)
        Zero between unknowns of different flights.
    right : ndarray (f,) or (f, s)
        Right-hand side.
    per_flight : ndarray (flights, k)
        As `per_flight_columns` finds them.
    """
    columns = right[:, None] if right.ndim == 1 else right
    shared, gain, complement, blocks = _eliminated(matrix, per_flight)
    solution = np.empty(columns.shape)
    local = np.linalg.solve(blocks, columns[per_flight]) if per_flight.size else columns[per_flight]
    reduced = columns[shared] - np.einsum("nks,nkr->sr", gain, columns[per_flight])
    solution[shared] = np.linalg.solve(complement, reduced)
    solution[per_flight] = local - gain @ solution[shared]
    return solution[:, 0] if right.ndim == 1 else solution


def invert_arrowhead(matrix: Floats, per_flight: Integers) -> Floats:
    """Invert a positive definite `matrix`, shape (f, f), zero between unknowns of different flights;
    `per_flight` as `per_flight_columns` finds them.
    """
    shared, gain, complement, blocks = _eliminated(matrix, per_flight)
    inverse = np.empty(matrix.shape)
    of_shared = np.linalg.inv(complement)
    inverse[np.ix_(shared, shared)] = of_shared
    if per_flight.size:
        flat, border = per_flight.ravel(), gain.reshape(per_flight.size, len(shared))
        beside = border @ of_shared
        inverse[np.ix_(flat, shared)] = -beside
        inverse[np.ix_(shared, flat)] = -beside.T
        inverse[np.ix_(flat, flat)] = beside @ border.T
        inverse[per_flight[:, :, None], per_flight[:, None, :]] += np.linalg.inv(blocks)
    result: Floats = 0.5 * (inverse + inverse.T)
    return result


def _eliminated(matrix: Floats, per_flight: Integers) -> tuple[Integers, Floats, Floats, Floats]:
    """Shared unknowns; for each flight what its own change for each unit of them; the shared ones' Schur
    complement; the blocks.
    """
    shared = np.setdiff1d(np.arange(len(matrix)), per_flight.ravel())
    blocks = matrix[per_flight[:, :, None], per_flight[:, None, :]]
    border = matrix[per_flight[:, :, None], shared[None, None, :]]
    gain = border
    if per_flight.size:
        gain = np.asarray(np.linalg.solve(blocks, border), float)
    complement: Floats = matrix[np.ix_(shared, shared)] - np.einsum("nks,nkt->st", border, gain)
    return shared, gain, complement, blocks
