"""A stop reaches the board whatever the line, the port and other threads do."""

import contextlib
import os
import random
import signal
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import heli_host
import pytest
from heli_host import declaration as d
from heli_host.errors import BadBaud, HeliError, LinkError, LinkLost, PortError
from heli_host.link.engine import Engine, RequestNumbers
from heli_host.link.events import LINK_LOST, LINK_RESTORED
from heli_host.link.frames import FrameParser
from heli_host.link.session import Driver, Session, Subscribers
from heli_host.link.telemetry import Ticks
from heli_host.link.transport import SerialTransport, open_transport

from tests.link.fake_board import FakeBoard, FakeLine, PtyBoard, ticks_of_received, truth


def test_stop_returns_before_its_answer_and_is_repeated_until_it_comes(
    board: FakeBoard, session: Session
) -> None:
    session.command(d.ArmMessage(0))
    board.lose_replies = 2
    session.stop_now()
    session.wait(1.0)
    assert len(ticks_of_received(board, d.MessageId.STOP)) == 3
    assert board.state == d.State.IDLE


def test_stop_goes_out_while_another_command_waits_for_an_answer_that_does_not_come(
    board: FakeBoard, session: Session
) -> None:
    session.command(d.ArmMessage(0))
    board.lose_replies = 10_000
    ended: list[LinkError] = []

    def set_parameter() -> None:
        with pytest.raises(LinkError, match="stop came before the board answered param_set") as caught:
            session.command(d.ParamSetMessage(0, d.Param.HOVER_V, 2.0), timeout_s=1000.0)
        ended.append(caught.value)

    # The first try of the parameter is heard while `set_parameter` waits; the stop comes from its callback.
    def stop_when_heard(_: object) -> None:
        if ticks_of_received(board, d.MessageId.PARAM_SET) and not ticks_of_received(board, d.MessageId.STOP):
            session.stop_now()
            board.lose_replies = 0

    session.subscribe_ticks(stop_when_heard)
    set_parameter()
    session.wait(0.2)
    assert ended
    assert ticks_of_received(board, d.MessageId.STOP)
    assert board.state == d.State.IDLE


def test_nothing_that_starts_motors_is_sent_after_a_stop_until_it_is_released(
    board: FakeBoard, session: Session
) -> None:
    session.stop_now()
    for command in (d.ArmMessage(0), d.ControlMessage(request=0, axes=7, front_V=0.0, back_V=0.0)):
        with pytest.raises(LinkError, match="a stop cancelled this command"):
            session.command(command)
    assert not ticks_of_received(board, d.MessageId.ARM)
    assert session.command(d.ParamSetMessage(0, d.Param.HOVER_V, 2.0)).value == 2.0
    assert session.release_stop(session.stops)
    session.command(d.ArmMessage(0))
    assert board.state == d.State.ARMED


def test_a_wish_from_before_the_stop_releases_nothing(session: Session) -> None:
    stops = session.stops
    session.stop_now()
    assert not session.release_stop(stops)
    with pytest.raises(LinkError, match="a stop cancelled this command"):
        session.command(d.ArmMessage(0))


def test_what_follows_a_stop_does_not_take_its_place_before_it_is_answered(
    board: FakeBoard, session: Session
) -> None:
    board.lose_replies = 2
    session.stop_now()
    session.command(d.ParamSetMessage(0, d.Param.HOVER_V, 2.0))
    stops, sets = ticks_of_received(board, d.MessageId.STOP), ticks_of_received(board, d.MessageId.PARAM_SET)
    assert len(stops) == 3
    assert min(sets) > max(stops)


def test_a_stop_forgets_the_setpoint_that_was_kept_alive(board: FakeBoard, session: Session) -> None:
    session.command(d.ArmMessage(0))
    session.command(d.ControlMessage(request=0, axes=7, front_V=0.0, back_V=0.0))
    session.keep_alive(d.SetpointMessage(apply_tick=0, elevation_rad=0.1, pitch_rad=0.0, travel_rad=0.0))
    session.wait(1.0)
    assert ticks_of_received(board, d.MessageId.SETPOINT)
    session.stop_now()
    session.wait(0.1)
    board.state = d.State.CLOSED_LOOP
    board.heard.clear()
    session.wait(1.0)
    assert not ticks_of_received(board, d.MessageId.SETPOINT)


def test_no_setpoint_is_sent_while_none_is_permitted_and_it_goes_on_after(
    board: FakeBoard, session: Session
) -> None:
    session.command(d.ArmMessage(0))
    session.command(d.ControlMessage(request=0, axes=7, front_V=0.0, back_V=0.0))
    session.keep_alive(d.SetpointMessage(apply_tick=0, elevation_rad=0.1, pitch_rad=0.0, travel_rad=0.0))
    session.wait(0.5)
    permitted = [False]
    session.permit_streams(lambda: permitted[0])
    session.wait(0.1)  # what is on the line arrives
    board.heard.clear()
    for _ in range(5):
        session.stream(d.SetpointMessage(apply_tick=0, elevation_rad=0.2, pitch_rad=0.0, travel_rad=0.0))
        session.wait(0.2)
    assert not ticks_of_received(board, d.MessageId.SETPOINT)
    permitted[0] = True
    session.wait(0.5)
    assert len(ticks_of_received(board, d.MessageId.SETPOINT)) >= 4


def test_many_threads_may_stop_at_once(board: FakeBoard, session: Session) -> None:
    session.command(d.ArmMessage(0))
    threads = [threading.Thread(target=session.stop_now) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    session.wait(1.0)
    assert board.state == d.State.IDLE
    assert session.stops == 8


def test_a_stop_passes_a_thread_that_keeps_the_lock_of_the_link(board: FakeBoard, session: Session) -> None:
    session.command(d.ArmMessage(0))
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
        while d.MessageId.STOP not in [frame.id for frame in FrameParser().feed(b"\0" + bytes(line.written))]:
            assert stopper.is_alive() and time.monotonic() < end_s, "no stop is written"
        # Read by the board while the lock is still kept.
        board.feed(bytes(line.written))
        assert board.state == d.State.IDLE
        assert keeper.is_alive() and session.stops == 0
    finally:
        may_release.set()
        keeper.join()
        stopper.join()
    session.wait(0.5)
    assert session.stops == 1
    assert not session._engine.commands.preempted
    with pytest.raises(LinkError, match="a stop cancelled this command"):
        session.command(d.ArmMessage(0))


def test_a_stop_past_the_lock_has_a_number_of_its_own() -> None:
    numbers = RequestNumbers(7)
    for _ in range(600):
        recent = {numbers.take() for _ in range(100)}
        assert numbers.distant() not in recent
        assert 1 <= numbers.distant() <= 255


posix = pytest.mark.skipif(os.name != "posix", reason="pseudo-terminals are a thing of Unix")


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[PtyBoard]:
    rig = PtyBoard(FakeBoard(), tmp_path)
    yield rig
    rig.close()


def open_session(rig: PtyBoard, **options: float) -> Session:
    session = Session(open_transport(str(rig.path)), **options)  # type: ignore[arg-type]
    session.connect()
    return session


@pytest.mark.parametrize("url", ["/dev/nothing-there", "sil://", "socket://localhost:1"])
def test_1200_baud_is_refused_by_name_before_anything_is_opened(url: str) -> None:
    with pytest.raises(BadBaud, match="1200 baud erases the flash of a Due"):
        open_transport(url, baud=1200)


def test_a_missing_port_is_one_line_that_says_which_exist() -> None:
    with pytest.raises(
        PortError, match=r"cannot open port /dev/nothing-there; (choose an existing|.*no USB port)"
    ):
        open_transport("/dev/nothing-there")


def test_an_unknown_scheme_is_one_line() -> None:
    with pytest.raises(LinkError, match="no installed package provides nosuch:// links"):
        open_transport("nosuch://x")


def test_a_page_is_no_board_and_the_line_says_what_joins_it() -> None:
    reason = r"page://127.0.0.1:80/ is a dashboard, not a board; join .*heli_host\.join"
    with pytest.raises(PortError, match=reason):
        heli_host.connect("page://127.0.0.1:80/?token=secret")


def test_nobody_listening_is_one_line() -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with pytest.raises(PortError, match=r"cannot open socket://.*check that its other end is running"):
        open_transport(f"socket://127.0.0.1:{port}")


@posix
def test_a_port_in_use_is_one_line_that_says_so(rig: PtyBoard) -> None:
    first = open_transport(str(rig.path))
    with pytest.raises(PortError, match="is in use by another program"):
        open_transport(str(rig.path))
    first.close()


@posix
@pytest.mark.skipif(os.name == "posix" and os.geteuid() == 0, reason="root may open everything")
def test_a_forbidden_port_says_how_to_get_permission(tmp_path: Path) -> None:
    port = tmp_path / "port"
    port.touch(mode=0o000)
    with pytest.raises(PortError, match="dialout"):
        open_transport(str(port))


def test_the_end_of_a_socket_is_a_lost_link() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        transport = open_transport(f"socket://127.0.0.1:{server.getsockname()[1]}")
        peer, _ = server.accept()
        peer.sendall(b"abc")
        assert transport.read(5.0) == b"abc"
        peer.close()
        with pytest.raises(LinkLost):
            transport.read(5.0)
    transport.close()


@posix
def test_the_end_of_a_terminal_is_a_lost_link() -> None:
    master, slave = os.openpty()
    transport = open_transport(os.ttyname(slave))
    os.close(slave)
    os.close(master)
    with pytest.raises(LinkLost, match=r"lost /dev/.*: it went away"):
        transport.read(5.0)
    transport.close()
    transport.close()


@posix
def test_reading_collects_bytes_and_times_out_empty() -> None:
    master, slave = os.openpty()
    transport = SerialTransport(os.ttyname(slave), min_read_interval_s=0.05)
    assert transport.read(0.01) == b""
    os.write(master, b"\x01\x02")
    assert transport.read(1.0) == b"\x01\x02"
    os.write(master, b"\x03")
    timer = threading.Timer(0.01, os.write, (master, b"\x04"))
    timer.start()
    # Four times the interval: the second write is collected however slow this machine is, or read on its own.
    collected = transport.read(0.2)
    timer.join()
    while len(collected) < 2:
        collected += transport.read(0.2)
    assert collected == b"\x03\x04"
    transport.write(b"out")
    assert os.read(master, 10) == b"out"
    transport.close()
    os.close(slave)
    os.close(master)


@pytest.mark.medium
@posix
def test_a_session_over_a_terminal_delivers_true_ticks_and_answers_commands(rig: PtyBoard) -> None:
    received: list[Ticks] = []
    with open_session(rig) as session:
        session.subscribe_ticks(received.append)
        for index in range(10):
            session.command(d.ParamSetMessage(0, d.Param.HOVER_V, index / 8))
        session.wait(0.5)
        counters = session.counters
    assert len(rig.board.executed) == 10
    for ticks in received:
        for tick, raw in zip(ticks.tick.tolist(), ticks.raw.tolist(), strict=True):
            assert raw == truth(tick)
    assert sum(map(len, received)) >= 500
    assert (counters.frames_bad, counters.ticks_lost) == (0, 0)


@pytest.mark.medium
@posix
def test_unplugged_and_plugged_in_again_the_session_goes_on_by_itself(rig: PtyBoard) -> None:
    received: list[Ticks] = []
    with open_session(rig, reconnect_timeout_s=60.0) as session:
        session.subscribe_ticks(received.append)
        session.wait(0.2)
        rig.unplug()
        assert session.wait_for(lambda: not session.connected, 30.0)
        missed_from = rig.board.tick
        assert session.wait_for(lambda: rig.board.tick > missed_from + 100, 30.0)
        rig.plug_in()
        assert session.wait_for(lambda: session.connected, 60.0)
        session.wait(0.2)
        assert [event.kind for event in session.events] == [LINK_LOST, LINK_RESTORED]
        counters = session.counters
    assert counters.reconnects == 1
    assert counters.ticks_lost > 0
    assert (
        sum(map(len, received)) + counters.ticks_lost
        >= int(received[-1].tick[-1]) - int(received[0].tick[0]) + 1
    )


@posix
def test_unplugged_for_good_a_waiting_user_gets_one_line(rig: PtyBoard) -> None:
    with open_session(rig, reconnect_timeout_s=0.3) as session:
        session.wait(0.1)
        rig.unplug()
        with pytest.raises(LinkLost, match="did not come back"):
            session.wait(600.0)


@posix
def test_closing_while_the_board_is_looked_for_does_not_wait_for_it(rig: PtyBoard) -> None:
    session = open_session(rig, reconnect_timeout_s=3600.0)
    rig.unplug()
    assert session.wait_for(lambda: not session.connected, 30.0)
    session.close()


@posix
def test_a_callback_that_commands_while_another_does_gets_an_error_not_a_deadlock(rig: PtyBoard) -> None:
    with open_session(rig) as session:
        rig.board.lose_replies = 3
        unsubscribe = session.subscribe_ticks(lambda _: (unsubscribe(), session.command(d.ArmMessage(0)))[0])
        with pytest.raises(
            HeliError, match="a callback cannot send a command while another command waits for its answer"
        ):
            session.command(d.ParamSetMessage(0, d.Param.HOVER_V, 1.0))
            session.wait(1.0)


@pytest.mark.medium
@posix
def test_commands_from_several_threads_take_their_turn(rig: PtyBoard) -> None:
    with open_session(rig) as session:

        def ask(number: int) -> None:
            for index in range(5):
                ack = session.command(d.ParamSetMessage(0, number, index + 0.5))
                assert ack.value == index + 0.5

        threads = [threading.Thread(target=ask, args=(number,)) for number in range(9, 13)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert len(rig.board.executed) == 20


@pytest.mark.medium
@posix
def test_waiting_keeps_to_device_time_not_to_this_computers(rig: PtyBoard) -> None:
    with open_session(rig) as session:
        session.wait(0.1)
        first = session.latest
        session.wait(0.5)
        last = session.latest
    assert first is not None
    assert last is not None
    assert last.tick - first.tick >= 500


INTERRUPTS = 200


def interrupted(*_: object) -> None:
    raise KeyboardInterrupt


@pytest.mark.medium
def test_an_interrupt_at_any_moment_leaves_the_driver_s_lock_free() -> None:
    moments = random.Random(1)
    before = signal.signal(signal.SIGALRM, interrupted)
    try:
        for _ in range(INTERRUPTS):
            driver = Driver(FakeLine(FakeBoard()), Engine(1), Subscribers(), 1.0)
            with contextlib.suppress(KeyboardInterrupt):
                signal.setitimer(signal.ITIMER_REAL, moments.uniform(50e-6, 150e-6))
                while True:
                    with driver.lock:
                        pass
            free: list[bool] = []
            other = threading.Thread(target=lambda: free.append(driver.lock.acquire(timeout=1.0)))  # noqa: B023
            other.start()
            other.join()
            assert free == [True]
    finally:
        signal.signal(signal.SIGALRM, before)
