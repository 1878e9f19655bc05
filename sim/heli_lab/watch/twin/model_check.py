"""Checks at the beginning of a flight whether its innovations are as large as the model states."""

from __future__ import annotations

from typing import Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.model.parts import AXES

FILTER_SETTLING_s: Final = 1.0
"""Time for which the filter estimates state, encoder zeros and torques before it looks for changes, s."""
CALIBRATION_s: Final = 8.0
"""Time in which the filter estimates what differs between days, s: supply, encoder zeros, constant torques,
and the parameters within their covariance. `diagnose` uses the same time. A model that is contradicted so
early was wrong from the start. Longer: an early change is not named. Shorter: another day's supply is taken
for a change."""
MAX_MEAN_SQUARE: Final = 2.0
"""Mean square of an axis' innovations in `CALIBRATION_s` above which the model is not this
rig's; 1 is what the model states. 175 innovations with the outliers of real flights (kurtosis 6) have a
standard error of 0.17, so chance needs six of them. Larger: flights that no model here explains raise alarms
later. Smaller: a day with gusts 1.4 times as large contradicts the rig."""
MIN_SCALE_ERROR: Final = 0.25
"""Error of an encoder's scale that is named even if a flight begins with it: a decoder that counts half the
edges. Larger: such a decoder is not named. Smaller: a model of another day's rig is taken for one."""


class ModelCheck:
    """Mean square of the innovations of each axis since the filter began."""

    def __init__(self) -> None:
        self._squares: Floats = np.zeros(3)
        self._count = 0

    def add(self, innovation: Floats) -> None:
        """Add an `innovation`, (3,), in standard deviations."""
        self._squares += innovation**2
        self._count += 1

    def contradiction(self) -> str:
        """Describe the axis whose innovations are too large; empty if none are, or none were added."""
        if not self._count:
            return ""
        mean_square = self._squares / self._count
        worst_axis = int(np.argmax(mean_square))
        if not mean_square[worst_axis] > MAX_MEAN_SQUARE:
            return ""
        rms = mean_square[worst_axis] ** 0.5
        return f"{AXES[worst_axis]} differs from its predictions by {rms:.1f} times the stated deviation"
