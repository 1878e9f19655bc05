"""Detects free flight from the samples so far: off the table, off the stops, motors on."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from heli_host.arrays import Floats
from heli_sim.rig import Rig

from heli_lab.identify import thresholds

SETTLE_s: Final = 1.5
"""Time off the table before a flight counts as free, s: the ground effect and the thrust of the take-off have
then decayed. Compare `identify.thresholds.SETTLED_S`. Longer: damage at take-off is detected late.
Shorter: the ground effect is taken for a change."""


class FreeFlight:
    """Decides for successive steps whether the flight is free.

    Parameters
    ----------
    rig : Rig
        Rig with the angles of its table and stops.
    step_s : float
        Length of a step [s].
    """

    def __init__(self, rig: Rig, step_s: float) -> None:
        self._settling_steps = round(SETTLE_s / step_s)
        self._clear_steps = 0
        uncertainty_deg = min(rig["elevation_min"].tolerance, thresholds.MAX_UNSURE_DEG)
        self._table_deg = rig["elevation_min"].value
        self._low_deg = self._table_deg + uncertainty_deg + thresholds.TABLE_MARGIN_DEG
        self._rotor_reach = (rig["L_h"].value + thresholds.ROTOR_m) / rig["L_a"].value
        stops = [rig[name] for name in ("elevation_max", "pitch_max", "travel_max")]
        self._stop_deg = [
            stop.value - min(stop.tolerance, thresholds.MAX_UNSURE_DEG) - thresholds.STOP_MARGIN_DEG
            for stop in stops
        ]

    def update(self, angles_rad: Floats | None, flying: bool) -> bool:
        """Return whether the step that begins at `angles_rad` [rad], (3,), is free; `flying` states whether
        the motors may run.
        """
        if not flying:
            self._clear_steps = 0
        elif angles_rad is not None:
            self._clear_steps = 0 if self._touches(angles_rad) else self._clear_steps + 1
        return self._clear_steps > self._settling_steps

    def _touches(self, angles_rad: Floats) -> bool:
        """Whether the arm or a rotor may touch the table, or an axis a stop, at angles [rad]."""
        elevation_deg, pitch_deg, travel_deg = np.rad2deg(angles_rad)
        if elevation_deg < self._low_deg:
            return True
        # An arm that leans far reaches the table with its lower rotor long before it stands on it.
        reach = self._rotor_reach * abs(math.sin(angles_rad[1])) * math.cos(angles_rad[0])
        if math.sin(angles_rad[0]) - reach < math.sin(math.radians(self._table_deg)):
            return True
        elevation_max_deg, pitch_max_deg, travel_max_deg = self._stop_deg
        return bool(
            elevation_deg > elevation_max_deg
            or abs(pitch_deg) > pitch_max_deg
            or abs(travel_deg) > travel_max_deg
        )
