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
        self._settle = round(SETTLE_s / step_s)
        self._clear = 0
        unsure = min(rig["elevation_min"].tolerance, thresholds.MAX_UNSURE_DEG)
        self._table_deg = rig["elevation_min"].value
        self._low_deg = self._table_deg + unsure + thresholds.TABLE_MARGIN_DEG
        self._share = (rig["L_h"].value + thresholds.ROTOR_m) / rig["L_a"].value
        stops = [rig[name] for name in ("elevation_max", "pitch_max", "travel_max")]
        self._most_deg = [
            stop.value - min(stop.tolerance, thresholds.MAX_UNSURE_DEG) - thresholds.STOP_MARGIN_DEG
            for stop in stops
        ]

    def update(self, angles_rad: Floats | None, flying: bool) -> bool:
        """Return whether the step that begins at `angles_rad` [rad], (3,), is free; `flying` states whether
        the motors may run.
        """
        if not flying:
            self._clear = 0
        elif angles_rad is not None:
            self._clear = 0 if self._touches(angles_rad) else self._clear + 1
        return self._clear > self._settle

    def _touches(self, angles_rad: Floats) -> bool:
        """Whether the arm touches its table or a stop at these angles, shape (3,)."""
        elevation_deg, pitch_deg, travel_deg = np.rad2deg(angles_rad)
        if elevation_deg < self._low_deg:
            return True
        # An arm that leans far reaches the table with its lower rotor long before it stands on it.
        reach = self._share * abs(math.sin(angles_rad[1])) * math.cos(angles_rad[0])
        if math.sin(angles_rad[0]) - reach < math.sin(math.radians(self._table_deg)):
            return True
        elevation_most, pitch_most, travel_most = self._most_deg
        return bool(
            elevation_deg > elevation_most or abs(pitch_deg) > pitch_most or abs(travel_deg) > travel_most
        )
