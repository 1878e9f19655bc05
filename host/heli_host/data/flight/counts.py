"""The angle of one encoder count in a flight, from the board's parameters or the steps of the angles."""

from __future__ import annotations

import math

import numpy as np

from heli_host.arrays import Floats
from heli_host.data.flight.flight import Flight
from heli_host.declaration import AXES

_REST_rad = 1e-7
"""Moves below this are rounding of printed angles."""
_WHOLE_SHARE = 0.95
_WHOLE_ERROR = 0.05
"""Angles are in whole counts if this share of the moves are multiples of the smallest, within this error in
counts. By judgement. A smaller share: estimates and filtered angles pass. A larger: a log with a few
interpolated rows does not."""


def count_rad(flight: Flight) -> Floats:
    """Return the angle of one count of each encoder [rad], shape (3,).

    The counts per turn are the board's parameters if the flight has them. Otherwise they are measured, and
    nan for angles that are not in whole counts or do not move.
    """
    result = np.empty(len(AXES))
    for index, axis in enumerate(AXES):
        # A negative number reverses the direction on the board.
        counts = abs(flight.parameters.get(f"{axis}_counts_per_rev", 0.0))
        angle_rad = getattr(flight, f"{axis}_rad")
        result[index] = 2.0 * math.pi / counts if counts else measured_count_rad(angle_rad)
    return result


def measured_count_rad(angle_rad: Floats) -> float:
    """Measure one count of an encoder. Shapes: `angle_rad` (n,)."""
    moves = np.abs(np.diff(angle_rad))
    moves = moves[moves > _REST_rad]
    if not moves.size:
        return math.nan
    count = float(moves.min())
    # Printed angles are rounded to decimals; the mean over single counts is better than the least.
    count = float(moves[moves < 1.5 * count].mean())
    multiples = moves[moves < 50 * count] / count
    if np.mean(np.abs(multiples - np.round(multiples)) < _WHOLE_ERROR) < _WHOLE_SHARE:
        return math.nan
    turn = 2.0 * math.pi / count
    return 2.0 * math.pi / round(turn) if abs(turn / round(turn) - 1.0) < 1e-3 else count
