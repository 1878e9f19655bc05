"""Emulates the operator who supports the arm on its table until take-off.

The real arm rests on its table. With the nominal masses in Table 2 of the paper, the arm would balance 2.9
degrees above the table; an error of 0.07 N m, well within their tolerances, makes the difference. Without
support the simulated arm would drift up, and the board would refuse to arm.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from heli_sim import _native
from heli_sim.plant import Plant

_TOUCH_RAD: Final = np.deg2rad(0.2)


def support_arm(plant: Plant, native: _native.World) -> None:
    """Lock the elevation of the arm in a world, `native`, while it is on its table with the motors off.

    The world checks this condition every 5 ms. If the arm of the `plant` stays on the table without support,
    or if the axis is locked for another reason, nothing changes.
    """
    rest = plant.rest_state()
    after, _ = plant.step(rest, (0.0, 0.0))
    if float(after[3]) > 0.0:
        native.support_below(float(rest[0] + _TOUCH_RAD))
