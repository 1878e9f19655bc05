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

_TOUCH_RAD: Final = np.deg2rad(0.2)


def support_arm(plant: Plant, native: _native.World) -> None:
    """Lock the elevation of a world's arm, `native`, while the arm is on its table and the motors are off.
    The condition is checked every 5 ms. If the arm of the `plant` rests by itself, or the axis is locked for
    another reason, nothing changes.
    """
    rest = plant.rest_state()
    after, _ = plant.step(rest, (0.0, 0.0))
    if float(after[3]) > 0.0:
        native.support_below(float(rest[0] + _TOUCH_RAD))
