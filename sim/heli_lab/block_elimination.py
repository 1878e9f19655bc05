"""Block elimination: the Schur complement that is left of normal equations without their leading unknowns."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

_RIDGE: Final = 1e-12
"""Share of a block's largest diagonal entry that is added to its diagonal: an unknown that a block's data do
not determine at all must not make the block singular. A hundred times the rounding of a double; what data
determine changes by less than their own rounding."""

Floats = NDArray[np.floating[Any]]


def eliminate_leading(normal: Floats, count: int) -> tuple[Floats, Floats]:
    """Eliminate the leading unknowns of each of many blocks of normal equations.

    With a block [[A, B], [B', D]] this is A^-1 B and the Schur complement D - B' A^-1 B.

    Parameters
    ----------
    normal : ndarray (b, n, n)
        Symmetric positive semi-definite blocks; the gradient may stand in the last row and column.
    count : int
        How many leading unknowns each block has of its own, below n.

    Returns
    -------
    schur : ndarray (b, n - count, n - count)
        What each block says of the other unknowns.
    follow : ndarray (b, count, n - count)
        How the eliminated unknowns follow the others.
    """
    own, coupling = normal[:, :count, :count].copy(), normal[:, :count, count:]
    diagonal = np.arange(count)
    own[:, diagonal, diagonal] += _RIDGE * own[:, diagonal, diagonal].max(axis=1, keepdims=True)
    follow: Floats = np.linalg.solve(own, coupling)
    schur: Floats = normal[:, count:, count:] - coupling.transpose(0, 2, 1) @ follow
    return schur, follow
