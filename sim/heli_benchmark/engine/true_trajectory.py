"""The true trajectory of a flight, which no log has, every half millisecond."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from heli_host.data.arrays import Floats

from heli_benchmark.engine.plant import HiddenEffect, Moment


@dataclass(frozen=True)
class TrueTrajectory:
    """States and inputs of a flight every half millisecond."""

    angles_rad: Floats
    """angles_rad, rates_rad_s: (n, 3): True angles and rates of elevation, pitch and travel."""
    rates_rad_s: Floats
    volts_V: Floats  # (n, 2): Voltages at the motors
    up: Floats  # (n, 3): Direction of the rotors' axes in the room
    climb_m_s: Floats  # (n, 2): Speed of each rotor along its own axis
    time_s: Floats
    """time_s, flight_s: (n,): Time since the rig was switched on, and since the motors first ran."""
    flight_s: Floats

    def perturbed(self, state: int, by: float) -> TrueTrajectory:
        """Return the trajectory with one `state` (0 to 2 angles, 3 to 5 rates) shifted `by` rad or rad/s."""
        name, axis = ("angles_rad", "rates_rad_s")[state // 3], state % 3
        values = getattr(self, name).copy()
        values[:, axis] += by
        return replace(self, **{name: values})

    def moment(self, k: int) -> Moment:
        """Return the `k`-th half millisecond as a hidden effect sees it before anything acts."""
        return Moment(
            float(self.time_s[k]),
            float(self.flight_s[k]),
            self.volts_V[k].copy(),
            np.zeros(2),
            self.angles_rad[k],
            self.rates_rad_s[k],
            up=self.up[k],
            climb_m_s=self.climb_m_s[k],
        )


class TrajectoryRecorder(HiddenEffect):
    """Records the trajectory before any effect acts, and changes nothing."""

    def __init__(self) -> None:
        super().__init__(0.0, np.random.default_rng(0))
        self._rows: list[tuple[float, ...]] = []

    def volts(self, at: Moment) -> None:
        self._rows.append(
            (*at.angles_rad, *at.rates_rad_s, *at.volts_V, *at.up, *at.climb_m_s, at.time_s, at.flight_s)
        )

    def trajectory(self) -> TrueTrajectory:
        """Return the recorded trajectory."""
        rows = np.array(self._rows)
        angles, rates, volts, up, climb = np.split(rows[:, :13], [3, 6, 8, 11], axis=1)
        return TrueTrajectory(angles, rates, volts, up, climb, rows[:, 13], rows[:, 14])
