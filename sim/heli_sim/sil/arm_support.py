"""A hand that holds the arm on its table where the masses would not.

The real arm rests on its table. The point masses of Table 2 balance 2.9 degrees above it, for the want of
0.07 N m that their tolerances easily hold: without a hand the arm drifts up, and the board rightly refuses to
arm. So does a person help such a rig.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from heli_sim import _native
from heli_sim.plant import Plant

LOOKS_EVERY_TICKS: Final = 5
"""How often the hand looks, ms, by the world's clock: it must not depend on how often anybody reads."""
_HOLDING: Final = [True, False, False]
_AWAY: Final = [False, False, False]
_TOUCH_RAD: Final = np.deg2rad(0.2)


class Hand:
    """Holds the elevation on the table while the motors are off, and lets go when they turn.

    It keeps away from a rig whose arm rests by itself, and from pins that somebody else has set.

    Parameters
    ----------
    plant : Plant
        The rig.
    """

    def __init__(self, plant: Plant) -> None:
        rest = plant.rest_state()
        self._table_rad = float(rest[0])
        self._pins = _AWAY
        after, _ = plant.step(rest, (0.0, 0.0))
        self._needed = float(after[3]) > 0.0

    def tend(self, native: _native.World, ticks: int) -> int:
        """Hold or let go.

        Parameters
        ----------
        native : _native.World
            The world that the arm is in.
        ticks : int
            Milliseconds that are going to pass.

        Returns
        -------
        int
            Milliseconds after which to ask again: all of them, for a rig that needs no hand.
        """
        if not self._needed or list(native.locked) != self._pins:
            return ticks
        late = native.tick % LOOKS_EVERY_TICKS
        if late:
            return min(ticks, LOOKS_EVERY_TICKS - late)
        lying = native.state[0] <= self._table_rad + _TOUCH_RAD
        off = not any(volts > 0.0 for volts in native.volts_V)
        self._pins = _HOLDING if off and lying else _AWAY
        native.locked = self._pins
        return min(ticks, LOOKS_EVERY_TICKS)
