"""The true course of a flight, at every half millisecond: what no log has."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from heli_host.arrays import Floats

from tests.blind.mujoco_rig import Hidden, Moment


@dataclass(frozen=True)
class ReferenceTrajectory:
    """A course as it was flown, at every half millisecond.

    Parameters
    ----------
    angles_rad, rates_rad_s : ndarray (n, 3)
        The true ones, of elevation, pitch and travel.
    volts_V : ndarray (n, 2)
        Voltages at the motors.
    up : ndarray (n, 3)
        Direction of the rotors' axes in the room.
    climb_m_s : ndarray (n, 2)
        Speed of each rotor along its own axis.
    time_s, flight_s : ndarray (n,)
        Time since the rig was switched on, and since the motors first ran.
    """

    angles_rad: Floats
    rates_rad_s: Floats
    volts_V: Floats
    up: Floats
    climb_m_s: Floats
    time_s: Floats
    flight_s: Floats

    def moved(self, state: int, by: float) -> ReferenceTrajectory:
        """The same course with one state off by so much: elevation, pitch, travel or their rates."""
        which, axis = ("angles_rad", "rates_rad_s")[state // 3], state % 3
        column = getattr(self, which).copy()
        column[:, axis] += by
        return replace(self, **{which: column})

    def moment(self, k: int) -> Moment:
        """The `k`-th half millisecond, as a hidden effect sees it before anything acts."""
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


class Watching(Hidden):
    """Looks on before anything is changed, and changes nothing."""

    def __init__(self) -> None:
        super().__init__(0.0, np.random.default_rng(0))
        self._rows: list[tuple[float, ...]] = []

    def volts(self, at: Moment) -> None:
        self._rows.append(
            (*at.angles_rad, *at.rates_rad_s, *at.volts_V, *at.up, *at.climb_m_s, at.time_s, at.flight_s)
        )

    def course(self) -> ReferenceTrajectory:
        """What was seen."""
        rows = np.array(self._rows)
        angles, rates, volts, up, climb = np.split(rows[:, :13], [3, 6, 8, 11], axis=1)
        return ReferenceTrajectory(angles, rates, volts, up, climb, rows[:, 13], rows[:, 14])
