"""Solve normal equations of many flights, with unknowns that all flights share and unknowns of single
flights.

Unknowns of different flights are not coupled directly: the matrix is block diagonal except for a border (an
arrowhead matrix). Each block is eliminated separately, so that a solution costs one small system per flight,
not the cube of the number of all unknowns.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from heli_host.arrays import Floats, Integers

NO_BLOCKS: Final = np.zeros((0, 0), np.int64)
"""Value of `per_flight` if no unknown belongs to a single flight."""


def per_flight_columns(columns: Sequence[Integers], size: int) -> Integers:
    """Find the unknowns that only one flight depends on.

    Parameters
    ----------
    columns : sequence of ndarray
        For each flight, indices of the unknowns that it depends on.
    size : int
        Number of unknowns.

    Returns
    -------
    ndarray (flights, k)
        Indices of the k unknowns of each flight; k is 0 for a single flight.
    """
    flight_count = np.zeros(size, int)
    for unknowns in columns:
        flight_count[unknowns] += 1
    if len(columns) < 2:
        return np.zeros((len(columns), 0), np.int64)
    return np.array([unknowns[flight_count[unknowns] == 1] for unknowns in columns], np.int64)


def solve_arrowhead(matrix: Floats, right: Floats, per_flight: Integers) -> Floats:
    """Solve a positive definite arrowhead system.

    Parameters
    ----------
    matrix : ndarray (f, f)
        Matrix of the system; 0 between unknowns of different flights.
    right : ndarray (f,) or (f, r)
        Right-hand side, or several.
    per_flight : ndarray (flights, k)
        Unknowns of single flights, from `per_flight_columns`.

    Returns
    -------
    ndarray (f,) or (f, r)
        Solution, in the shape of the right-hand side.
    """
    columns = right[:, None] if right.ndim == 1 else right
    shared, gain, complement, blocks = _eliminate_per_flight(matrix, per_flight)
    solution = np.empty(columns.shape)
    flight_columns = columns[per_flight]
    without_shared = np.linalg.solve(blocks, flight_columns) if per_flight.size else flight_columns
    reduced = columns[shared] - np.einsum("nks,nkr->sr", gain, flight_columns)
    solution[shared] = np.linalg.solve(complement, reduced)
    solution[per_flight] = without_shared - gain @ solution[shared]
    return solution[:, 0] if right.ndim == 1 else solution


def invert_arrowhead(matrix: Floats, per_flight: Integers) -> Floats:
    """Invert a positive definite arrowhead matrix; return the full inverse, shape (f, f).

    Parameters
    ----------
    matrix : ndarray (f, f)
        0 between unknowns of different flights.
    per_flight : ndarray (flights, k)
        Unknowns of single flights, from `per_flight_columns`.
    """
    shared, gain, complement, blocks = _eliminate_per_flight(matrix, per_flight)
    inverse = np.empty(matrix.shape)
    shared_inverse = np.linalg.inv(complement)
    inverse[np.ix_(shared, shared)] = shared_inverse
    if per_flight.size:
        # Block inversion, with the unknowns of all flights in one list.
        flight_unknowns, stacked_gain = per_flight.ravel(), gain.reshape(per_flight.size, len(shared))
        product = stacked_gain @ shared_inverse
        inverse[np.ix_(flight_unknowns, shared)] = -product
        inverse[np.ix_(shared, flight_unknowns)] = -product.T
        inverse[np.ix_(flight_unknowns, flight_unknowns)] = product @ stacked_gain.T
        inverse[per_flight[:, :, None], per_flight[:, None, :]] += np.linalg.inv(blocks)
    return 0.5 * (inverse + inverse.T)


def _eliminate_per_flight(matrix: Floats, per_flight: Integers) -> tuple[Integers, Floats, Floats, Floats]:
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
