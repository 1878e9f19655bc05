"""Thrust against voltage from a scale under each rotor, and the straight line through the readings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats

from heli_sim.errors import RigError

SCALE_N: Final = 0.00981
"""Smallest step of the scale that thrust is read from: a gram."""


@dataclass(frozen=True)
class Line:
    """Thrust = gain (V - dead zone)."""

    gain_N_per_V: float  # gain_N_per_V, gain_half: Slope, and half its 95 % interval
    gain_half: float
    dead_zone_V: float
    """dead_zone_V, dead_zone_half: Voltage at which the line is zero, and half its 95 % interval."""
    dead_zone_half: float


@dataclass(frozen=True)
class ThrustCurve:
    """Readings of a thrust stand: `thrust_N` of the front and the back rotor at `volts_V`, both
    shape (n, 2).
    """

    volts_V: Floats
    thrust_N: Floats

    def line(self) -> Line:
        """Fit the straight line to the readings above zero. The intervals come from the scatter of the
        readings, or from the step of the scale if that is larger. A RigError when there are fewer than three
        readings.
        """
        is_above_zero = self.thrust_N > 0.0
        volts_V, thrust_N = self.volts_V[is_above_zero], self.thrust_N[is_above_zero]
        if volts_V.size < 3:
            raise RigError(
                f"{volts_V.size} readings of thrust above zero are too few for a line",
                "read the scale at three voltages or more above the dead zone",
            )
        design = np.column_stack((volts_V, np.ones_like(volts_V)))
        (slope_N_per_V, intercept_N), *_ = np.linalg.lstsq(design, thrust_N, rcond=None)
        scatter_N = np.std(thrust_N - design @ (slope_N_per_V, intercept_N), ddof=2)
        noise_N = max(float(scatter_N), SCALE_N / np.sqrt(12.0))
        covariance = noise_N**2 * np.linalg.inv(design.T @ design)
        dead_zone_V = -intercept_N / slope_N_per_V
        # Derivatives of the dead zone by slope and intercept, by which their covariance becomes its variance.
        zero_gradient = np.array([-dead_zone_V / slope_N_per_V, -1.0 / slope_N_per_V])
        return Line(
            float(slope_N_per_V),
            2.0 * float(np.sqrt(covariance[0, 0])),
            float(dead_zone_V),
            2.0 * float(np.sqrt(zero_gradient @ covariance @ zero_gradient)),
        )
