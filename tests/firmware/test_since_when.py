"""Start of each count: late ticks from arming, rates from zeroing; and the place where a hold holds."""

from __future__ import annotations

import numpy as np
import pytest
from heli_host.declaration import PARAMS, Channel, Fault, Param, State
from heli_host.fly.heli import Heli

from tests.firmware.desk import Board
from tests.firmware.test_timing import tick_end
from tests.flight.harness import TRACKING

pytestmark = pytest.mark.emulated

pytest.importorskip("due_emulator._due", reason="the emulated Due is not built: make setup")
pytest.importorskip("elftools", reason="pyelftools is missing: make setup")


def make_late(board: Board, heli: Heli, ticks: int) -> None:
    """Let so many ticks run late."""
    for _ in range(ticks):
        tick_end(board)
        board.due.hold_processor(True)
        board.due.run_us(2500.0)
        board.due.hold_processor(False)
        heli.wait(0.004)


def test_late_ticks_from_before_arming_are_no_fault_and_later_ones_are(board: Board) -> None:
    heli = board.connect()
    most = int(heli.session.read_params()[Param.OVERRUN_MAX])
    make_late(board, heli, most + 1)
    assert heli.session.status().overruns == most + 1
    heli.arm()
    make_late(board, heli, most)
    assert heli.state is State.ARMED
    assert board.on()
    make_late(board, heli, 1)
    assert heli.fault is Fault.TICK_OVERRUN
    assert board.off()


def test_an_arm_that_was_zeroed_just_now_is_not_moving(board: Board) -> None:
    heli = board.connect()
    for axis in range(3):
        for k in range(400):
            board.due.schedule_step(axis, 1, board.due.now_us + 10.0 + 100.0 * k)
        heli.wait(0.05)
    heli.wait(0.2)
    heli.zero()
    heli.arm()
    assert board.on()


def test_a_hold_stays_where_it_began_on_every_axis_that_it_holds(board: Board) -> None:
    heli = board.connect()
    # An arm that does not move when it is driven would be a fault first.
    for spec in PARAMS:
        if spec.name.endswith(TRACKING):
            heli.params[spec.name] = spec.max
    heli.arm()
    heli.control()
    heli.setpoint(travel_deg=60.0, elevation_deg=0.0, lead_s=0.5)
    heli.wait(0.1)
    # No setpoint comes any more, and the arm stays where it is.
    heli.session.keep_alive(None)
    heli.wait(heli.session.read_params()[Param.SETPOINT_HOLD_S] + 0.1)
    assert heli.state is State.HOLD
    latest = heli.session.latest
    assert latest is not None
    setpoints_deg = np.degrees(1e-5 * latest[1][[Channel.ELEVATION_SETPOINT, Channel.TRAVEL_SETPOINT]])
    assert setpoints_deg == pytest.approx([-25.0, 0.0], abs=0.2)
