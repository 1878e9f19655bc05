"""Shaped setpoint of a step, with the slew and acceleration limits of firmware/core/flight."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from heli_host.arrays import Floats

_TICK_s: Final = 0.001
_APPROACH_RATE: Final = 0.01
"""Share of the remaining distance per tick at the end of the path."""
_SMOOTHING: Final = 0.01
"""Coefficient per tick of the low-pass filter of the acceleration feed-forward."""


def shaped_step(
    distance: float, slew: float, acceleration: float, duration_s: float, every_s: float
) -> Floats:
    """Return the shaped setpoint after a step of the target, as the board computes it.

    Parameters
    ----------
    distance : float
        Size of the step, in degrees or any other unit.
    slew : float
        Largest rate of the setpoint [unit/s].
    acceleration : float
        Largest acceleration of the setpoint [unit/s^2].
    duration_s : float
        Length of the path.
    every_s : float
        Time between two rows, a whole number of milliseconds.

    Returns
    -------
    ndarray (n, 3)
        Setpoint, its rate, and the smoothed acceleration for the feed-forward.
    """
    step_max, change_max = slew * _TICK_s, acceleration * _TICK_s**2
    angle = step = smooth = 0.0
    rows = np.empty((round(duration_s / _TICK_s), 3))
    approach_distance = change_max / _APPROACH_RATE**2
    for row in rows:
        row[:] = angle, step / _TICK_s, smooth / _TICK_s**2
        remaining = abs(distance - angle)
        fastest = (
            remaining * _APPROACH_RATE
            if remaining <= approach_distance
            else math.sqrt(2.0 * change_max * (remaining - 0.5 * approach_distance))
        )
        target_step = math.copysign(min(fastest, step_max), distance - angle)
        change = max(-change_max, min(change_max, target_step - step))
        step += change
        angle += step
        smooth += _SMOOTHING * (change - smooth)
    return rows[:: round(every_s / _TICK_s)]
