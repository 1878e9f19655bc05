"""Compute the shaped setpoint of a step, with the limits of rate and acceleration of firmware/core/flight."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats

_TICK_s: Final = 0.001
_APPROACH_RATE: Final = 0.01
"""Share of the remaining distance per tick at the end of the path."""
_SMOOTHING: Final = 0.01
"""Coefficient per tick of the low-pass filter of the acceleration feed-forward."""


def shaped_step(
    distance: float, slew: float, acceleration: float, duration_s: float, every_s: float
) -> Floats:
    """Return the shaped setpoint after a step of the target, as the board computes it. Returns shape (n,
    3).
    """
    # All changes are per tick: `step` of the setpoint, `change` of the step.
    max_step, max_change = slew * _TICK_s, acceleration * _TICK_s**2
    setpoint = step = smooth_change = 0.0
    rows = np.empty((round(duration_s / _TICK_s), 3))
    approach_distance = max_change / _APPROACH_RATE**2
    for row in rows:
        row[:] = setpoint, step / _TICK_s, smooth_change / _TICK_s**2
        remaining = abs(distance - setpoint)
        # Near its end, the path approaches the target exponentially; before that, it brakes evenly.
        fastest = (
            remaining * _APPROACH_RATE
            if remaining <= approach_distance
            else math.sqrt(2.0 * max_change * (remaining - 0.5 * approach_distance))
        )
        target_step = math.copysign(min(fastest, max_step), distance - setpoint)
        change = max(-max_change, min(max_change, target_step - step))
        step += change
        setpoint += step
        smooth_change += _SMOOTHING * (change - smooth_change)
    return rows[:: round(every_s / _TICK_s)]
