"""What measured flights brought to the list, by other means than the catalogue's; hidden in weather only."""

from __future__ import annotations

import numpy as np

from tests.blind.hidden import Maker, SpinningRotors
from tests.blind.mujoco_rig import STEP_S, Hidden, Moment


class SpeedLag(Hidden):
    """Size: time constant of the rotors' speed, of which the thrust is the square; comes before all else.

    At 2 V the thrust is that of the straight line behind a dead zone of 1 V.
    """

    def __init__(self, size: float, rng: np.random.Generator) -> None:
        super().__init__(size, rng)
        self._speed_V = np.zeros(2)
        self._rho = np.exp(-STEP_S / size)

    def thrust(self, at: Moment) -> None:
        before = self._speed_V
        self._speed_V = at.volts_V + (before - at.volts_V) * self._rho
        speed_V = 0.5 * (before + self._speed_V)
        at.thrust_N = at.gain_N_per_V * speed_V * np.abs(speed_V) / 4.0


class Flywheels(SpinningRotors):
    """Size: angular momentum for each volt of speed, which lags the voltage by a tenth of a second."""

    def __init__(self, size: float, rng: np.random.Generator) -> None:
        super().__init__(size, rng)
        self._both_V = 0.0

    def torque(self, at: Moment) -> None:
        self._both_V += (float(at.volts_V.sum()) - self._both_V) * (1.0 - np.exp(-STEP_S / 0.1))
        thrust_N, at.thrust_N = at.thrust_N, np.array([self._both_V, 0.0])
        super().torque(at)
        at.thrust_N = thrust_N


class SupplyFade(Hidden):
    """Size: share of the voltage lost in a minute."""

    def volts(self, at: Moment) -> None:
        at.volts_V = at.volts_V * (1.0 - self.size * at.flight_s / 60.0)


class PitchDrag(Hidden):
    """Size: torque against pitch at 1 rad/s, which goes with the square of its rate."""

    def torque(self, at: Moment) -> None:
        rate = at.rates_rad_s[1]
        at.torque_Nm[1] -= self.size * rate * abs(rate)


MEASURED_EFFECTS: dict[str, tuple[Maker, float]] = {
    "rotor_speed_lag": (SpeedLag, 0.11),
    "flywheel": (Flywheels, 0.015),
    "supply_fade": (SupplyFade, 0.08),
    "pitch_drag_quadratic": (PitchDrag, 0.08),
}
"""Maker of each, and its typical size."""
