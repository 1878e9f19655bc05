"""Emulates the operator who supports the arm on its table until take-off.

The real arm rests on its table. The point masses of Table 2 balance 2.9 degrees above it, for want of
0.07 N m that their tolerances easily hold: without support the arm drifts up, and the board rightly refuses
to arm.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from heli_sim import _native
from heli_sim.plant import Plant

PERIOD_TICKS: Final = 5
"""How often the support is decided on, simulated ms: it must not depend on how often anybody reads."""
_SUPPORTED: Final = [True, False, False]
_FREE: Final = [False, False, False]
_TOUCH_RAD: Final = np.deg2rad(0.2)


class ArmSupport:
    """Locks the elevation on the table while the motors are off, and frees it when they turn.

    It leaves alone a rig whose arm rests by itself, and axes that somebody else has locked.
    """

    def __init__(self, plant: Plant) -> None:
        rest = plant.rest_state()
        self._table_rad = float(rest[0])
        self._locked = _FREE
        after, _ = plant.step(rest, (0.0, 0.0))
        self._needed = float(after[3]) > 0.0

    def update(self, native: _native.World, ticks: int) -> int:
        """Lock or free the elevation of the arm in a world, `native`, that is going to pass `ticks`
        milliseconds; return those after which to ask again: all of them, for a rig that needs no support.
        """
        if not self._needed or list(native.locked) != self._locked:
            return ticks
        late = native.tick % PERIOD_TICKS
        if late:
            return min(ticks, PERIOD_TICKS - late)
        on_table = native.state[0] <= self._table_rad + _TOUCH_RAD
        off = not any(volts > 0.0 for volts in native.volts_V)
        self._locked = _SUPPORTED if off and on_table else _FREE
        native.locked = self._locked
        return min(ticks, PERIOD_TICKS)
