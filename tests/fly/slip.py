"""Let an encoder lose counts slowly, as a loose coupling does: no step that a board could notice."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from heli_host.board.heli import Heli
from heli_sim.sil.inprocess import InProcessTransport

PITCH = 1
_STEP_DEG = 0.25


def slipping(heli: Heli, axis: int, shift_deg: float) -> Callable[[], None]:
    """Return a function that shifts a measured angle a little in each call, until it is shifted by
    `shift_deg`.
    """
    transport = heli.session.transport
    assert isinstance(transport, InProcessTransport)
    world = transport.world
    steps = [float(np.sign(shift_deg)) * _STEP_DEG] * round(abs(shift_deg) / _STEP_DEG)

    def slip() -> None:
        if not steps:
            return
        step_rad = np.radians(steps.pop())
        # Without its plug the encoder does not see the arm turn back, and then counts the way there.
        for is_out, turn_rad in ((True, -step_rad), (False, step_rad)):
            world.native.encoders_out = [is_out and index == axis for index in range(3)]
            state = world.state
            state[axis] += turn_rad
            world.state = state
            heli.wait(0.001)

    return slip
