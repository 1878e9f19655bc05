"""Compute the exponentials of small matrices, with which linear equations are discretised exactly."""

from __future__ import annotations

import numpy as np
from heli_host.arrays import Floats


def matrix_exponentials(matrices: Floats) -> Floats:
    """Compute the exponentials of `matrices`, shape (n, m, m), by scaling and squaring of a Taylor series.

    scipy.linalg.expm uses a threaded solver for each matrix, and takes 3 ms instead of 0.1 ms for fifteen
    matrices on a busy computer.
    """
    # Halve the matrices until the largest norm is at most 0.25, where nine terms of the series are exact.
    halvings = max(0, int(np.ceil(np.log2(np.abs(matrices).sum(axis=2).max() / 0.25))))
    halved = matrices / 2.0**halvings
    result = unit = np.broadcast_to(np.eye(matrices.shape[1]), matrices.shape)
    # Horner's scheme: 1 + x (1 + x / 2 (1 + x / 3 (...))).
    for order in range(9, 0, -1):
        result = unit + halved @ result / order
    for _ in range(halvings):
        result = result @ result
    return np.asarray(result)
