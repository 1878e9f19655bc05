"""Stop from any thread: before all other commands, repeated until answered; what was begun stays stopped."""

from __future__ import annotations

import threading
import time

import pytest
from heli_host.declaration import (
    ArmMessage,
    ControlMessage,
    MessageId,
    Param,
    ParamSetMessage,
    SetpointMessage,
    State,
)
from heli_host.errors import LinkError
from heli_host.link.engine import RequestNumbers
from heli_host.link.frames import FrameParser

from tests.link.fake_board import FakeBoard, FakeLine, connected_session, ticks_of_received


def test_stop_returns_before_its_answer_and_is_repeated_until_it_comes() -> None:
    board = FakeBoard()
    session = connected_session(board)
    session.command(ArmMessage(0))
    board.lose_replies = 2
    session.stop_now()
    session.wait(1.0)
    assert len(ticks_of_received(board, MessageId.STOP)) == 3
    assert board.state == State.IDLE


def test_stop_goes_out_while_another_command_waits_for_an_answer_that_does_not_come() -> None:
    board = FakeBoard()
    session = connected_session(board)
    session.command(ArmMessage(0))
    board.lose_replies = 10_000
    ended: list[LinkError] = []

    def set_parameter() -> None:
        with pytest.raises(LinkError, match="stop came before the board answered param_set") as caught:
            session.command(ParamSetMessage(0, Param.HOVER_V, 2.0), timeout_s=1000.0)
        ended.append(caught.value)

    # The first try of the parameter is heard while `set_parameter` waits; the stop comes from its callback.
    def stop_when_heard(_: object) -> None:
        if ticks_of_received(board, MessageId.PARAM_SET) and not ticks_of_received(board, MessageId.STOP):
            session.stop_now()
            board.lose_replies = 0

    session.subscribe_ticks(stop_when_heard)
    set_parameter()
    session.wait(0.2)
    assert ended
    assert ticks_of_received(board, MessageId.STOP)
    assert board.state == State.IDLE


def test_nothing_that_starts_motors_is_sent_after_a_stop_until_it_is_released() -> None:
    board = FakeBoard()
    session = connected_session(board)
    session.stop_now()
    for command in (ArmMessage(0), ControlMessage(0, 7, 0.0, 0.0)):
        with pytest.raises(LinkError, match="a stop cancelled this command"):
            session.command(command)
    assert not ticks_of_received(board, MessageId.ARM)
    assert session.command(ParamSetMessage(0, Param.HOVER_V, 2.0)).value == 2.0
    assert session.release_stop(session.stops)
    session.command(ArmMessage(0))
    assert board.state == State.ARMED


def test_a_wish_from_before_the_stop_releases_nothing() -> None:
    board = FakeBoard()
    session = connected_session(board)
    stops = session.stops
    session.stop_now()
    assert not session.release_stop(stops)
    with pytest.raises(LinkError, match="a stop cancelled this command"):
        session.command(ArmMessage(0))


def test_what_follows_a_stop_does_not_take_its_place_before_it_is_answered() -> None:
    board = FakeBoard()
    session = connected_session(board)
    board.lose_replies = 2
    session.stop_now()
    session.command(ParamSetMessage(0, Param.HOVER_V, 2.0))
    stops, sets = ticks_of_received(board, MessageId.STOP), ticks_of_received(board, MessageId.PARAM_SET)
    assert len(stops) == 3
    assert min(sets) > max(stops)


def test_a_stop_forgets_the_setpoint_that_was_kept_alive() -> None:
    board = FakeBoard()
    session = connected_session(board)
    session.command(ArmMessage(0))
    session.command(ControlMessage(0, 7, 0.0, 0.0))
    session.keep_alive(SetpointMessage(0, 0.1, 0.0, 0.0))
    session.wait(1.0)
    assert ticks_of_received(board, MessageId.SETPOINT)
    session.stop_now()
    session.wait(0.1)
    board.state = State.CLOSED_LOOP
    board.heard.clear()
    session.wait(1.0)
    assert not ticks_of_received(board, MessageId.SETPOINT)


def test_no_setpoint_is_sent_while_none_is_permitted_and_it_goes_on_after() -> None:
    board = FakeBoard()
    session = connected_session(board)
    session.command(ArmMessage(0))
    session.command(ControlMessage(0, 7, 0.0, 0.0))
    session.keep_alive(SetpointMessage(0, 0.1, 0.0, 0.0))
    session.wait(0.5)
    permitted = [False]
    session.permit_streams(lambda: permitted[0])
    session.wait(0.1)  # what is on the line arrives
    board.heard.clear()
    for _ in range(5):
        session.stream(SetpointMessage(0, 0.2, 0.0, 0.0))
        session.wait(0.2)
    assert not ticks_of_received(board, MessageId.SETPOINT)
    permitted[0] = True
    session.wait(0.5)
    assert len(ticks_of_received(board, MessageId.SETPOINT)) >= 4


def test_many_threads_may_stop_at_once() -> None:
    board = FakeBoard()
    session = connected_session(board)
    session.command(ArmMessage(0))
    threads = [threading.Thread(target=session.stop_now) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    session.wait(1.0)
    assert board.state == State.IDLE
    assert session.stops == 8


def test_a_stop_passes_a_thread_that_keeps_the_lock_of_the_link() -> None:
    board = FakeBoard()
    session = connected_session(board)
    session.command(ArmMessage(0))
    line = session.transport
    assert isinstance(line, FakeLine)
    line.written.clear()
    is_kept, may_release = threading.Event(), threading.Event()

    def keep_the_lock() -> None:
        with session._driver.lock:
            # Half a frame, as of a thread that is interrupted while it writes.
            line.write(b"\x05half")
            is_kept.set()
            may_release.wait()

    keeper = threading.Thread(target=keep_the_lock)
    stopper = threading.Thread(target=session.stop_now)
    end_s = time.monotonic() + 60.0
    keeper.start()
    is_kept.wait()
    stopper.start()
    try:
        while MessageId.STOP not in [frame.id for frame in FrameParser().feed(b"\0" + bytes(line.written))]:
            assert stopper.is_alive() and time.monotonic() < end_s, "no stop is written"
        # Read by the board while the lock is still kept.
        board.feed(bytes(line.written))
        assert board.state == State.IDLE
        assert keeper.is_alive() and session.stops == 0
    finally:
        may_release.set()
        keeper.join()
        stopper.join()
    session.wait(0.5)
    assert session.stops == 1
    assert not session._engine.commands.preempted
    with pytest.raises(LinkError, match="a stop cancelled this command"):
        session.command(ArmMessage(0))


def test_a_stop_past_the_lock_has_a_number_of_its_own() -> None:
    numbers = RequestNumbers(7)
    for _ in range(600):
        recent = {numbers.take() for _ in range(100)}
        assert numbers.distant() not in recent
        assert 1 <= numbers.distant() <= 255
