"""Exponentials of small matrices, which discretise linear equations exactly."""

from __future__ import annotations

import numpy as np
from heli_host.arrays import Floats


def matrix_exponentials(matrices: Floats) -> Floats:
    """Return the exponentials of `matrices`, shape (n, m, m), by scaling and squaring of a Taylor series.

    scipy.linalg.expm uses a threaded solver for each matrix: 3 ms instead of 0.1 ms for fifteen matrices on a
    busy machine.
    """
    halvings = max(0, int(np.ceil(np.log2(np.abs(matrices).sum(axis=2).max() / 0.25))))
    small = matrices / 2.0**halvings
    result = unit = np.broadcast_to(np.eye(matrices.shape[1]), matrices.shape)
    for order in range(9, 0, -1):
        result = unit + small @ result / order
    for _ in range(halvings):
        result = result @ result
    return np.asarray(result)
