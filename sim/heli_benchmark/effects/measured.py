"""Effects that measured flights added to the catalogue, implemented in MuJoCo; only in disturbed cases."""

from __future__ import annotations

import numpy as np

from heli_benchmark.effects.listed import Maker, SpinningRotors
from heli_benchmark.engine.plant import STEP_S, HiddenEffect, Moment


class SpeedLag(HiddenEffect):
    """Thrust is the square of a rotor speed that lags; `size` is the time constant in s. It acts first.

    At 2 V the thrust equals that of the straight line with a dead zone of 1 V.
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
    """Rotors act as flywheels that lag by 0.1 s; `size` is the angular momentum in N m s per volt."""

    def __init__(self, size: float, rng: np.random.Generator) -> None:
        super().__init__(size, rng)
        self._both_V = 0.0

    def torque(self, at: Moment) -> None:
        self._both_V += (float(at.volts_V.sum()) - self._both_V) * (1.0 - np.exp(-STEP_S / 0.1))
        thrust_N, at.thrust_N = at.thrust_N, np.array([self._both_V, 0.0])
        super().torque(at)
        at.thrust_N = thrust_N


class SupplyFade(HiddenEffect):
    """The supply decreases steadily; `size` is the share of the voltage lost in a minute."""

    def volts(self, at: Moment) -> None:
        at.volts_V = at.volts_V * (1.0 - self.size * at.flight_s / 60.0)


class PitchDrag(HiddenEffect):
    """Air drag of the pitch axis; `size` is the torque in N m at 1 rad/s."""

    def torque(self, at: Moment) -> None:
        rate = at.rates_rad_s[1]
        at.torque_Nm[1] -= self.size * rate * abs(rate)


MEASURED_EFFECTS: dict[str, tuple[Maker, float]] = {
    "rotor_speed_lag": (SpeedLag, 0.11),
    "flywheel": (Flywheels, 0.015),
    "supply_fade": (SupplyFade, 0.08),
    "pitch_drag_quadratic": (PitchDrag, 0.08),
}
"""Factory of each, and its typical size."""
