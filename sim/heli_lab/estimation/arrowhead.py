"""Normal equations of many flights: unknowns that all flights share, and unknowns of single flights.

Unknowns of different flights are not coupled directly: the matrix is block diagonal except for a border. Each
block is eliminated separately, so that a solution costs one small system per flight, not the cube of the
number of all unknowns.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from heli_host.arrays import Floats, Integers

NO_BLOCKS: Final = np.zeros((0, 0), np.int64)
"""Value of `per_flight` if no unknown belongs to a single flight."""


def per_flight_columns(columns: Sequence[Integers], size: int) -> Integers:
    """Indices of the unknowns that only one flight has, shape (flights, k); k is 0 for a single flight.

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
    """Solution of a positive definite arrowhead system, of the shape of its right-hand side.

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
    """Inverse of a positive definite `matrix`, shape (f, f), 0 between unknowns of different flights;
    `per_flight` as `per_flight_columns` returns them.
    """
    shared, gain, complement, blocks = _eliminated(matrix, per_flight)
    inverse = np.empty(matrix.shape)
    of_shared = np.linalg.inv(complement)
    inverse[np.ix_(shared, shared)] = of_shared
    if per_flight.size:
        flat, border = per_flight.ravel(), gain.reshape(per_flight.size, len(shared))
        product = border @ of_shared
        inverse[np.ix_(flat, shared)] = -product
        inverse[np.ix_(shared, flat)] = -product.T
        inverse[np.ix_(flat, flat)] = product @ border.T
        inverse[per_flight[:, :, None], per_flight[:, None, :]] += np.linalg.inv(blocks)
    return 0.5 * (inverse + inverse.T)


def _eliminated(matrix: Floats, per_flight: Integers) -> tuple[Integers, Floats, Floats, Floats]:
    """Eliminate the unknowns of single flights.

    Returns
    -------
    shared : ndarray of int64 (s,)
        Indices of the shared unknowns.
    gain : ndarray (flights, k, s)
        Minus the change of each flight's unknowns per unit of the shared ones.
    complement : ndarray (s, s)
        Schur complement: the system of the shared unknowns alone.
    blocks : ndarray (flights, k, k)
        Systems of the unknowns of each flight.
    """
    shared = np.setdiff1d(np.arange(len(matrix)), per_flight.ravel())
    blocks = matrix[per_flight[:, :, None], per_flight[:, None, :]]
    border = matrix[per_flight[:, :, None], shared[None, None, :]]
    gain = border
    if per_flight.size:
        gain = np.asarray(np.linalg.solve(blocks, border), float)
    complement: Floats = matrix[np.ix_(shared, shared)] - np.einsum("nks,nkt->st", border, gain)
    return shared, gain, complement, blocks
