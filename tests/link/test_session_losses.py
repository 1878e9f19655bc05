"""A line that is cut, damaged or restarted: no wrong frame is accepted, and every loss is counted."""

from __future__ import annotations

import random
from collections.abc import Callable

import numpy as np
import pytest
from heli_host.declaration import ArmMessage, Param, ParamSetMessage, Result
from heli_host.errors import HeliError, LinkError, LinkLost
from heli_host.link.events import BOARD_RESTARTED, LINK_LOST, LINK_RESTORED, LINK_SILENT
from heli_host.link.session import Session
from heli_host.link.telemetry import Ticks

from tests.channels.groups import SIGNED
from tests.link.fake_board import FakeBoard, FakeLine, truth
from tests.running.long import samples

pytestmark = pytest.mark.medium


def collected(session: Session) -> list[Ticks]:
    received: list[Ticks] = []
    session.subscribe_ticks(received.append)
    return received


def assert_true(seen: list[Ticks]) -> None:
    for ticks in seen:
        for tick, raw in zip(ticks.tick.tolist(), ticks.raw.tolist(), strict=True):
            expected = truth(tick)
            assert [raw[channel] for channel in SIGNED] == [expected[channel] for channel in SIGNED]


def span(seen: list[Ticks]) -> int:
    return int(seen[-1].tick[-1]) - int(seen[0].tick[0]) + 1


def test_a_clean_line_loses_nothing() -> None:
    session = Session(FakeLine(FakeBoard()))
    seen = collected(session)
    session.connect()
    session.wait(20.0)
    assert_true(seen)
    assert sum(map(len, seen)) == span(seen) == session.counters.ticks_received
    assert (session.counters.ticks_lost, session.counters.frames_bad, session.counters.retries) == (0, 0, 0)


def test_an_unplugged_cable_is_an_event_and_the_gap_is_counted_exactly() -> None:
    line = FakeLine(FakeBoard())
    session = Session(line)
    seen = collected(session)
    session.connect()
    session.wait(1.0)
    line.out_at_s = (2.0, 4.0)
    session.wait(5.0)
    counters = session.counters
    assert [event.kind for event in session.events] == [LINK_LOST, LINK_RESTORED]
    assert counters.reconnects == 1
    assert counters.restarts == 0
    assert_true(seen)
    assert counters.ticks_received == sum(map(len, seen))
    assert counters.ticks_received + counters.ticks_lost == span(seen)
    assert 1990 <= counters.ticks_lost <= 2400


def test_a_command_under_way_when_the_cable_is_pulled_is_executed_once() -> None:
    board = FakeBoard()
    line = FakeLine(board)
    session = Session(line)
    session.connect()
    session.wait(0.5)
    board.lose_replies = 1
    line.out_at_s = (line.now_s() + 0.01, line.now_s() + 0.7)
    assert session.command(ParamSetMessage(0, Param.HOVER_V, 2.0)).value == 2.0
    assert len(board.executed) == 1


def test_a_cable_that_stays_out_ends_in_one_line_after_the_time_given() -> None:
    line = FakeLine(FakeBoard())
    session = Session(line, reconnect_timeout_s=3.0)
    session.connect()
    line.out_at_s = (line.now_s() + 1.0, 1e9)
    with pytest.raises(LinkLost, match=r"pulled out and did not come back; .*connect again"):
        session.wait(60.0)
    assert 4.0 <= line.now_s() < 4.3
    with pytest.raises(LinkLost):
        session.command(ArmMessage(0))


def test_a_board_that_falls_silent_is_greeted_and_goes_on() -> None:
    board = FakeBoard()
    session = Session(FakeLine(board))
    session.connect()
    session.wait(1.0)
    board.silent = True
    session.wait_for(lambda: False, 2.0)
    board.silent = False
    session.wait(1.0)
    assert [event.kind for event in session.events] == [LINK_SILENT, LINK_RESTORED]
    assert session.counters.reconnects == 1
    assert session.counters.ticks_lost > 1900


def test_a_board_silent_for_good_ends_the_wait() -> None:
    board = FakeBoard()
    session = Session(FakeLine(board), reconnect_timeout_s=2.0)
    session.connect()
    session.wait(0.5)
    board.silent = True
    with pytest.raises(LinkLost, match="does not answer any more"):
        session.wait(60.0)


def test_a_restart_of_the_board_is_distinguished_from_a_lost_cable() -> None:
    board = FakeBoard()
    session = Session(FakeLine(board))
    seen = collected(session)
    session.connect()
    session.wait(3.0)
    board.reboot()
    with pytest.raises(LinkLost, match="restarted"):
        session.wait(10.0)
    session.wait(1.0)
    assert session.welcome.boot_id == 2
    assert BOARD_RESTARTED in [event.kind for event in session.events]
    assert session.counters.restarts == 1
    assert_true(seen)
    latest = session.latest
    assert latest is not None
    assert 1000 <= latest[0] < 1300


def test_a_restart_that_only_the_ticks_show_is_noticed() -> None:
    board = FakeBoard()
    line = FakeLine(board)
    session = Session(line)
    session.connect()
    session.wait(3.0)
    board.reboot()
    board.advance(0)
    board.open = True
    with pytest.raises(LinkLost, match="restarted"):
        session.wait(10.0)
    assert line.now_s() < 3.6
    assert session.counters.restarts == 1


def test_a_restart_while_the_cable_is_out_is_noticed_although_the_tick_has_passed_the_old_one() -> None:
    board = FakeBoard()
    line = FakeLine(board)
    session = Session(line)
    session.connect()
    session.wait(1.0)
    line.out_at_s = (line.now_s(), line.now_s() + 6.0)
    board.reboot()
    with pytest.raises(LinkLost):
        session.wait(30.0)
    session.wait(0.5)
    assert session.counters.restarts == 1
    assert session.counters.ticks_lost == 0


def test_a_restart_under_the_same_id_is_noticed_by_the_tick() -> None:
    board = FakeBoard()
    session = Session(FakeLine(board))
    session.connect()
    session.wait(3.0)
    board.reboot()
    board.boot_id -= 1
    with pytest.raises(LinkLost, match="restarted"):
        session.wait(10.0)
    session.wait(1.0)
    assert session.counters.restarts == session.counters.reconnects == 1
    latest = session.latest
    assert latest is not None
    assert 1000 <= latest[0] < 1300


@pytest.mark.slow
@pytest.mark.parametrize("damage", ["flip", "drop", "double", "all"])
def test_a_damaged_line_delivers_no_wrong_tick_and_counts_what_is_missing(damage: str) -> None:
    board = FakeBoard()
    line = FakeLine(board, to_host=damaged(damage, 1), to_board=damaged(damage, 2))
    session = Session(line)
    seen = collected(session)
    session.connect()
    commands = samples(60, 15)
    for index in range(commands):
        value = index / 16
        assert session.command(ParamSetMessage(0, Param.HOVER_V, value), timeout_s=5.0).value == value
        session.wait(0.5)
    counters = session.counters
    assert_true(seen)
    tick = np.concatenate([ticks.tick for ticks in seen])
    assert (np.diff(tick) > 0).all()
    assert counters.frames_bad > 0
    assert counters.ticks_lost > 0
    assert counters.ticks_received == len(tick)
    assert counters.ticks_received + counters.ticks_lost == span(seen)
    assert [ParamSetMessage.unpack(b"\0" + done[1:]).value for done in board.executed] == [
        index / 16 for index in range(commands)
    ]


def test_what_a_callback_raises_reaches_the_user_once_and_the_session_lives() -> None:
    session = Session(FakeLine(FakeBoard()))
    calls = []

    def fail(ticks: Ticks) -> None:
        calls.append(ticks)
        raise ZeroDivisionError("by zero")

    session.connect()
    session.subscribe_ticks(fail)
    with pytest.raises(HeliError, match="callback failed: ZeroDivisionError: by zero") as caught:
        session.wait(1.0)
    assert isinstance(caught.value.__cause__, ZeroDivisionError)
    session.wait(1.0)
    assert len(calls) == 1
    assert session.command(ArmMessage(0)).result == Result.OK


def test_a_callback_may_send_commands_in_lockstep() -> None:
    board = FakeBoard()
    session = Session(FakeLine(board))
    session.connect()
    session.wait(0.1)
    unsubscribe = session.subscribe_ticks(lambda ticks: (unsubscribe(), session.command(ArmMessage(0)))[0])
    session.wait(0.5)
    assert len(board.executed) == 1


def test_a_closed_session_says_so() -> None:
    session = Session(FakeLine(FakeBoard()))
    session.connect()
    session.close()
    session.close()
    with pytest.raises(LinkError, match="closed; connect again"):
        session.wait(1.0)


def damaged(kind: str, seed: int) -> Callable[[bytes], bytes]:
    """1 bit in 10^4 flipped, or one byte in 10^3 dropped or doubled, or all of it."""
    chance = random.Random(seed)

    def damage(data: bytes) -> bytes:
        out = bytearray()
        for sent in data:
            byte, copies = sent, 1
            if kind in ("flip", "all"):
                for bit in range(8):
                    if chance.random() < 1e-4:
                        byte ^= 1 << bit
            if kind in ("drop", "all") and chance.random() < 1e-3:
                copies = 0
            if kind in ("double", "all") and chance.random() < 1e-3:
                copies = 2
            out += bytes([byte]) * copies
        return bytes(out)

    return damage
