"""The path that the board makes of a step: its slew and acceleration limits, as in firmware/core/flight."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

_TICK_s: Final = 0.001
_CLOSE_IN: Final = 0.01  # of the distance, a tick
_SMOOTHING: Final = 0.01  # of the acceleration that is fed forward, a tick


def shaped_step(
    distance: float, slew: float, acceleration: float, duration_s: float, every_s: float
) -> npt.NDArray[np.float64]:
    """Setpoint after a step of the target, shape (n, 3): setpoint, its rate, and the smoothed acceleration
    that the control law is fed with.

    Parameters
    ----------
    distance : float
        The step, in degrees or any other unit.
    slew : float
        Fastest change of the setpoint, unit/s.
    acceleration : float
        Fastest change of its rate, unit/s2.
    duration_s : float
        Length of the path, s.
    every_s : float
        Time between two rows, s, a whole number of milliseconds.
    """
    step_max, change_max = slew * _TICK_s, acceleration * _TICK_s**2
    angle = step = smooth = 0.0
    rows = np.empty((round(duration_s / _TICK_s), 3))
    near = change_max / _CLOSE_IN**2
    for row in rows:
        row[:] = angle, step / _TICK_s, smooth / _TICK_s**2
        distance_left = abs(distance - angle)
        fastest = (
            distance_left * _CLOSE_IN
            if distance_left <= near
            else math.sqrt(2.0 * change_max * (distance_left - 0.5 * near))
        )
        wanted = math.copysign(min(fastest, step_max), distance - angle)
        change = max(-change_max, min(change_max, wanted - step))
        step += change
        angle += step
        smooth += _SMOOTHING * (change - smooth)
    return rows[:: round(every_s / _TICK_s)]
