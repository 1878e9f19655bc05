"""Disturbances: random torques about all three axes, as on each real rig: gusts and a slow drift."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from heli_host.data.arrays import Floats

from heli_benchmark.engine.plant import STEP_S, HiddenEffect, Moment

STRENGTHS_Nm = ((0.006, 0.002, 0.004), (0.012, 0.004, 0.008), (0.02, 0.006, 0.012))
"""Standard deviations about elevation, pitch and travel: weak, moderate, strong."""
CORRELATION_TIMES_s = (0.3, 0.6, 1.2)
"""Correlation times of the gusts; on measured flights they are 0.1 to 1.2 s."""
LONGEST_s = 130.0


@dataclass(frozen=True)
class DisturbanceModel:
    """Size and correlation of random torques."""

    gusts_Nm: tuple[float, float, float]  # Standard deviations of the gusts about elevation, pitch and travel
    correlation_time_s: float  # Correlation time of the gusts
    slow_std_Nm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Standard deviations of an additional slow drift; zeros without one."""
    drift_s: float = 30.0  # Correlation time of the drift


class DisturbanceTorques(HiddenEffect):
    """Independent Ornstein-Uhlenbeck torques about the three axes; they are no cause to be named."""

    def __init__(self, disturbances: DisturbanceModel, rng: np.random.Generator) -> None:
        super().__init__(1.0, rng)
        steps = round(LONGEST_s / STEP_S)
        gusts = wander(disturbances.correlation_time_s, steps, rng) * disturbances.gusts_Nm
        drift = wander(disturbances.drift_s, steps, rng) * disturbances.slow_std_Nm
        self._torque_Nm = gusts + drift

    def torque(self, at: Moment) -> None:
        at.torque_Nm += self._torque_Nm[round(at.flight_s / STEP_S)]


def wander(correlation_time_s: float, steps: int, rng: np.random.Generator) -> Floats:
    """Draw three stationary Ornstein-Uhlenbeck processes of unit variance, shape (`steps`, 3), by `rng`."""
    from scipy.signal import lfilter

    decay = np.exp(-STEP_S / correlation_time_s)
    innovations = np.sqrt(1.0 - decay**2) * rng.standard_normal((steps, 3))
    innovations[0] = rng.standard_normal(3)
    return np.asarray(lfilter([1.0], [1.0, -decay], innovations, axis=0))
