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
from heli_host.data.arrays import Floats, Integers

NO_BLOCKS: Final = np.zeros((0, 0), np.int64)
"""Value of `per_flight` if no unknown belongs to a single flight."""


def per_flight_columns(columns: Sequence[Integers], size: int) -> Integers:
    """Find the unknowns that only one flight depends on. Returns shape (flights, k)."""
    flight_count = np.zeros(size, int)
    for unknowns in columns:
        flight_count[unknowns] += 1
    if len(columns) < 2:
        return np.zeros((len(columns), 0), np.int64)
    return np.array([unknowns[flight_count[unknowns] == 1] for unknowns in columns], np.int64)


def solve_arrowhead(matrix: Floats, right: Floats, per_flight: Integers) -> Floats:
    """Solve a positive definite arrowhead system. Shapes: `matrix` (f, f), `right` (f,), `per_flight`
    (flights, k); returns (f,).
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
    """Invert a positive definite arrowhead matrix; return the full inverse, shape (f, f). Shapes: `matrix`
    (f, f), `per_flight` (flights, k).
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
    """Eliminate the unknowns of single flights. Returns shape `shared` (s,), `gain` (flights, k, s),
    `complement` (s, s), `blocks` (flights, k, k).
    """
    shared = np.setdiff1d(np.arange(len(matrix)), per_flight.ravel())
    blocks = matrix[per_flight[:, :, None], per_flight[:, None, :]]
    border = matrix[per_flight[:, :, None], shared[None, None, :]]
    gain = border
    if per_flight.size:
        gain = np.asarray(np.linalg.solve(blocks, border), float)
    complement: Floats = matrix[np.ix_(shared, shared)] - np.einsum("nks,nkt->st", border, gain)
    return shared, gain, complement, blocks
