"""Detects free flight from the samples so far: off the table, off the stops, motors on."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.rig import Rig

from heli_lab.fit import thresholds

SETTLE_s: Final = 1.5
"""Time off the table before a flight counts as free, s: the ground effect and the thrust of the take-off have
then decayed. Compare `identify.thresholds.SETTLED_S`. Longer: damage at take-off is detected late.
Shorter: the ground effect is taken for a change."""


class FreeFlight:
    """Decides for successive steps whether the flight is free."""

    def __init__(self, rig: Rig, step_s: float) -> None:
        self._settling_steps = round(SETTLE_s / step_s)
        # Number of successive steps off the table and the stops.
        self._clear_steps = 0
        uncertainty_deg = min(rig["elevation_min"].tolerance, thresholds.MAX_UNSURE_DEG)
        self._table_deg = rig["elevation_min"].value
        self._low_deg = self._table_deg + uncertainty_deg + thresholds.TABLE_MARGIN_DEG
        # Distance of a rotor's edge from the arm, as a share of the arm's length.
        self._rotor_reach = (rig["L_h"].value + thresholds.ROTOR_m) / rig["L_a"].value
        stops = [rig[name] for name in ("elevation_max", "pitch_max", "travel_max")]
        self._stop_deg = [
            stop.value - min(stop.tolerance, thresholds.MAX_UNSURE_DEG) - thresholds.STOP_MARGIN_DEG
            for stop in stops
        ]

    def update(self, angles_rad: Floats | None, flying: bool) -> bool:
        """Return whether a step is free. Shapes: `angles_rad` (3,)."""
        if not flying:
            self._clear_steps = 0
        elif angles_rad is not None:
            self._clear_steps = 0 if self._touches(angles_rad) else self._clear_steps + 1
        return self._clear_steps > self._settling_steps

    def _touches(self, angles_rad: Floats) -> bool:
        """Whether the arm or a rotor may touch the table, or an axis a stop, at angles [rad]."""
        elevation_rad, pitch_rad, _ = angles_rad
        elevation_deg, pitch_deg, travel_deg = np.rad2deg(angles_rad)
        if elevation_deg < self._low_deg:
            return True
        # If the arm is pitched, its lower rotor reaches the table before the arm does. Heights are above the
        # pivot, in lengths of the arm.
        depth = self._rotor_reach * abs(math.sin(pitch_rad)) * math.cos(elevation_rad)
        lowest_height = math.sin(elevation_rad) - depth
        if lowest_height < math.sin(math.radians(self._table_deg)):
            return True
        elevation_max_deg, pitch_max_deg, travel_max_deg = self._stop_deg
        return bool(
            elevation_deg > elevation_max_deg
            or abs(pitch_deg) > pitch_max_deg
            or abs(travel_deg) > travel_max_deg
        )
