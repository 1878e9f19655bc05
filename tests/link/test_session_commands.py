"""A session: greeting with a deadline, commands executed once, streams kept fresh, losses counted."""

import itertools
import math
import random
from collections.abc import Callable

import numpy as np
import pytest
from heli_host import declaration as d
from heli_host.errors import (
    CommandRefused,
    CommandTimeout,
    HandshakeTimeout,
    HeliError,
    LinkError,
    LinkLost,
    LinkVersionMismatch,
    WrongDevice,
)
from heli_host.link.events import BOARD_RESTARTED, LINK_LOST, LINK_RESTORED, LINK_SILENT
from heli_host.link.session import Session
from heli_host.link.telemetry import Ticks

from tests.channels.groups import SIGNED
from tests.link.fake_board import BATCH_TICKS, ILLEGAL_TRAVEL, FakeBoard, FakeLine, ticks_of_received, truth
from tests.running.long import samples


def test_a_board_that_listens_is_met_within_a_tenth_of_a_second(line: FakeLine) -> None:
    with Session(line) as session:
        welcome = session.connect()
    assert welcome.boot_id == 1
    assert line.now_s() < 0.1


def test_silence_ends_at_the_deadline_and_says_what_to_check(board: FakeBoard) -> None:
    board.answers_hello = False
    line = FakeLine(board)
    with Session(line, handshake_timeout_s=3.0) as session, pytest.raises(HandshakeTimeout) as caught:
        session.connect()
    assert 3.0 <= line.now_s() < 3.1
    assert "no data came" in str(caught.value)
    assert "check power and cable" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_hello_is_repeated_every_tenth_of_a_second(board: FakeBoard) -> None:
    board.answers_hello = False
    with Session(FakeLine(board), handshake_timeout_s=2.0) as session, pytest.raises(HandshakeTimeout):
        session.connect()
    assert 18 <= sum(frame.id == d.MessageId.HELLO for _, frame in board.heard) <= 21


@pytest.mark.parametrize(
    "sent", [b"Hello, I am a GPS!\r\n$GPGGA,1,2*33\r\n", b"\0\0\0\x05\x01", bytes(range(256))]
)
def test_bytes_that_are_not_ours_are_a_wrong_device_with_count_and_excerpt(
    board: FakeBoard, sent: bytes
) -> None:
    board.answers_hello = False
    with Session(FakeLine(board, to_host=lambda _: sent)) as session, pytest.raises(WrongDevice) as caught:
        session.connect()
    assert caught.value.byte_count % len(sent) == 0
    assert str(caught.value.byte_count) in str(caught.value)
    assert caught.value.excerpt.hex(" ") in str(caught.value)
    assert caught.value.excerpt in (sent * 20).replace(b"\0", b"")


@pytest.mark.medium
def test_our_frames_without_an_answer_are_not_called_a_wrong_device(board: FakeBoard) -> None:
    board.answers_hello = False
    line = FakeLine(board)
    board.open = True
    with Session(line) as session, pytest.raises(HandshakeTimeout, match="sends data, but did not answer"):
        session.connect()


def test_a_version_mismatch_names_both_versions_and_hashes_at_once(board: FakeBoard) -> None:
    board.link_hash, board.link_version = 0xDEADBEEF, (2, 7)
    line = FakeLine(board)
    with Session(line) as session, pytest.raises(LinkVersionMismatch) as caught:
        session.connect()
    for part in (d.LINK_VERSION, "2.7", f"{d.LINK_HASH:08x}", "deadbeef", "firmware 0.1.2"):
        assert part in str(caught.value)
    assert line.now_s() < 0.5


def test_a_board_that_resets_for_three_seconds_and_sends_rubbish_meanwhile_is_met(board: FakeBoard) -> None:
    board.answers_hello = False
    line = FakeLine(board, to_host=_rubbish_until(board, 3000))
    with Session(line) as session:
        session.connect()
        assert 3.0 < line.now_s() < 3.3
        session.wait(1.0)
        assert (session.counters.frames_bad, session.counters.ticks_lost) == (0, 0)


@pytest.mark.medium
def test_telemetry_that_flows_already_does_not_disturb_and_is_not_counted(board: FakeBoard) -> None:
    board.open = True
    board.answers_hello = False
    line = FakeLine(board, to_host=_tail_first())
    board.advance(5)

    def answer_later(data: bytes) -> bytes:
        board.answers_hello = line.now_s() > 1.0
        return data

    line._to_board = answer_later
    with Session(line) as session:
        received: list[int] = []
        session.subscribe_ticks(lambda ticks: received.append(int(ticks.tick[0])))
        session.connect()
        session.wait(1.0)
        counters = session.counters
    assert received[0] > session.welcome.tick - BATCH_TICKS
    assert (counters.frames_bad, counters.frames_lost, counters.ticks_lost) == (0, 0, 0)
    assert counters.ticks_received >= 1000


@pytest.mark.medium
def test_the_same_lockstep_session_twice_sends_the_same_bytes() -> None:
    received = []
    for _ in range(2):
        board = FakeBoard()
        with Session(FakeLine(board)) as session:
            session.connect()
            session.wait(2.0)
        received.append(board.heard)
    assert received[0] == received[1]
    assert len(received[0]) > 5


def _rubbish_until(board: FakeBoard, tick: int) -> Callable[[bytes], bytes]:
    def damage(data: bytes) -> bytes:
        board.answers_hello = board.tick >= tick
        return data if board.answers_hello else bytes([board.tick % 256, 0xFF, 0x00])

    return damage


def _tail_first() -> Callable[[bytes], bytes]:
    """A host that opens a port in the middle of a frame sees its tail first."""
    parts: list[bytes] = []

    def damage(data: bytes) -> bytes:
        if data and not parts:
            parts.append(data)
            return data[7:]
        return data

    return damage


def test_a_command_whose_acks_are_lost_is_repeated_and_executed_once(
    board: FakeBoard, session: Session
) -> None:
    board.lose_replies = 3
    ack = session.command(d.ParamSetMessage(0, d.Param.HOVER_V, 2.5))
    assert ack.value == 2.5
    assert len(board.executed) == 1
    assert session.counters.retries == 3
    assert len(ticks_of_received(board, d.MessageId.PARAM_SET)) == 4
    assert len({frame.payload for _, frame in board.heard if frame.id == d.MessageId.PARAM_SET}) == 1


def test_a_command_that_is_lost_on_its_way_is_repeated(
    board: FakeBoard, line: FakeLine, session: Session
) -> None:
    lost = [2]

    def lose_two(data: bytes) -> bytes:
        if data and lost[0]:
            lost[0] -= 1
            return b""
        return data

    line._to_board = lose_two
    session.command(d.ArmMessage(0))
    assert len(board.executed) == 1
    assert session.counters.retries == 2


def test_repeated_acks_are_not_taken_for_answers_to_later_commands(
    board: FakeBoard, session: Session
) -> None:
    board.repeat_replies = 3
    for index in range(20):
        assert session.command(d.ParamSetMessage(0, d.Param.HOVER_V, index / 8)).value == index / 8
    assert len(board.executed) == 20
    assert session.counters.retries == 0


def test_a_late_ack_of_the_same_command_is_not_taken_for_the_answer_to_a_new_one(
    board: FakeBoard, session: Session
) -> None:
    session.command(d.ParamSetMessage(0, d.Param.HOVER_V, 1.0))
    late = d.ParamSetMessage.unpack(
        next(frame for _, frame in board.heard if frame.id == d.MessageId.PARAM_SET).payload
    )
    board.lose_replies = 1
    board.send(
        d.AckMessage(
            request=late.request, command=d.MessageId.PARAM_SET, result=d.Result.OK, detail=0, value=1.0
        )
    )
    assert session.command(d.ParamSetMessage(0, d.Param.HOVER_V, 2.0)).value == 2.0
    assert session.counters.retries == 1


@pytest.mark.medium
def test_a_command_without_any_answer_times_out_at_its_deadline(board: FakeBoard, session: Session) -> None:
    board.lose_replies = 10**6
    began_s = session.transport.now_s()
    with pytest.raises(CommandTimeout, match=r"did not answer arm in [0-9]+ tries"):
        session.command(d.ArmMessage(0), timeout_s=1.5)
    assert 1.5 <= session.transport.now_s() - began_s < 1.52
    assert len(board.executed) == 1


@pytest.mark.medium
def test_three_hundred_commands_wrap_the_request_number_without_confusion(
    board: FakeBoard, session: Session
) -> None:
    for index in range(300):
        session.command(d.ParamSetMessage(0, d.Param.ELEVATION_KP, index / 64))
    assert [d.ParamSetMessage.unpack(b"\0" + done[1:]).value for done in board.executed] == [
        index / 64 for index in range(300)
    ]


def test_a_failed_check_names_the_fault_its_limit_and_the_remedy(session: Session, board: FakeBoard) -> None:
    board.refusals[d.MessageId.ARM] = (d.Result.CHECK_FAILED, d.Fault.NOT_AT_REST, -17.5)
    with pytest.raises(CommandRefused) as caught:
        session.command(d.ArmMessage(0))
    assert caught.value.fault is d.Fault.NOT_AT_REST
    assert caught.value.parameter == "arm_elevation_tolerance_deg"
    for part in ("arm", "not_at_rest", "does not rest on the table", "-17.5", "let it rest on the table"):
        assert part in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_wrong_state_names_the_state_and_what_to_do_first(session: Session, board: FakeBoard) -> None:
    board.refusals[d.MessageId.CONTROL] = (d.Result.BAD_STATE, d.State.FAULT, 0.0)
    with pytest.raises(
        CommandRefused, match=r"control: not allowed in state fault; .*clear the fault"
    ) as caught:
        session.command(d.ControlMessage(request=0, axes=7, front_V=0.0, back_V=0.0))
    assert caught.value.state is d.State.FAULT


@pytest.mark.parametrize("result", [result for result in range(14) if result])
@pytest.mark.parametrize("detail", [0, 3, 22, 255])
def test_every_refusal_is_one_line_with_a_remedy(result: int, detail: int) -> None:
    error = CommandRefused(d.MessageId.PARAM_SET, result, detail, 1.0)
    assert "\n" not in str(error)
    assert error.cause
    assert error.remedy


def test_all_parameters_arrive_over_several_replies(session: Session, board: FakeBoard) -> None:
    board.params = [index / 4 for index in range(len(d.Param))]
    assert list(session.read_params()) == board.params


@pytest.mark.medium
def test_status_is_read_and_also_comes_by_itself(session: Session) -> None:
    received: list[d.StatusMessage] = []
    session.subscribe_status(received.append)
    assert session.status().illegal_travel == ILLEGAL_TRAVEL
    received.clear()
    session.wait(3.0)
    assert len(received) == 3
    assert session.counters.board == received[-1]


def test_a_board_that_forgot_the_session_is_greeted_again_and_the_command_executed_once(
    board: FakeBoard, session: Session
) -> None:
    board.open = False
    assert session.command(d.ArmMessage(0)).result == d.Result.OK
    assert len(board.executed) == 1
    assert session.counters.reconnects == 1


def test_a_command_is_not_repeated_to_a_board_that_restarted(board: FakeBoard, session: Session) -> None:
    session.wait(0.5)
    board.lose_replies = 1
    execute = board._execute

    def execute_then_die(frame: object) -> bytes:
        reply = execute(frame)  # type: ignore[arg-type]
        board.reboot()
        return reply

    board._execute = execute_then_die  # type: ignore[method-assign]
    with pytest.raises(LinkLost, match="the board restarted \\(watchdog\\) before it answered"):
        session.command(d.ArmMessage(0))
    assert len(board.executed) == 1
    assert session.counters.restarts == 1


@pytest.mark.medium
def test_the_board_hears_something_at_least_five_times_a_second(board: FakeBoard, session: Session) -> None:
    session.wait(10.0)
    ticks = [tick for tick, _ in board.heard]
    assert max(later - sooner for sooner, later in itertools.pairwise(ticks)) <= 220


@pytest.mark.medium
def test_setpoints_go_out_at_200_Hz_at_most_and_the_latest_wins(board: FakeBoard, session: Session) -> None:
    first_tick = board.tick
    for index in range(1000):
        session.stream(
            d.SetpointMessage(apply_tick=0, elevation_rad=index * 1e-3, pitch_rad=0.0, travel_rad=0.0)
        )
        if index % 10 == 9:
            session.wait_for(lambda: False, 0.01)
    session.wait_for(lambda: False, 0.05)
    ticks = ticks_of_received(board, d.MessageId.SETPOINT)
    counters = session.counters
    assert len(ticks) <= (board.tick - first_tick) / 5 + 1
    assert len(ticks) == counters.setpoints_sent
    assert counters.setpoints_sent + counters.setpoints_skipped == 1000
    last = [frame for _, frame in board.heard if frame.id == d.MessageId.SETPOINT][-1]
    assert math.isclose(d.SetpointMessage.unpack(last.payload).elevation_rad, 0.999, rel_tol=1e-6)


def test_voltages_go_out_at_500_Hz_at_most(board: FakeBoard, session: Session) -> None:
    first_tick = board.tick
    for _ in range(500):
        session.stream(d.VoltagesMessage(front_V=1.0, back_V=2.0, valid_ms=50))
        session.wait_for(lambda: False, 0.001)
    assert 200 <= len(ticks_of_received(board, d.MessageId.VOLTAGES)) <= (board.tick - first_tick) / 2 + 1
    assert session.counters.voltages_skipped > 0


@pytest.mark.medium
def test_the_last_setpoint_is_kept_fresh_only_while_the_board_flies_on_setpoints(
    board: FakeBoard, session: Session
) -> None:
    session.keep_alive(d.SetpointMessage(apply_tick=0, elevation_rad=0.1, pitch_rad=0.0, travel_rad=0.0))
    session.wait(1.0)
    assert ticks_of_received(board, d.MessageId.SETPOINT) == []
    session.command(d.ArmMessage(0))
    session.command(d.ControlMessage(request=0, axes=7, front_V=0.0, back_V=0.0))
    session.wait(0.2)
    began = len(ticks_of_received(board, d.MessageId.SETPOINT))
    session.wait(5.0)
    ticks = ticks_of_received(board, d.MessageId.SETPOINT)[began:]
    assert max(later - sooner for sooner, later in itertools.pairwise(ticks)) <= 120
    session.keep_alive(None)
    session.wait(0.1)
    before = len(ticks_of_received(board, d.MessageId.SETPOINT))
    session.wait(1.0)
    assert len(ticks_of_received(board, d.MessageId.SETPOINT)) == before


def test_an_ack_for_another_command_with_the_same_number_is_no_answer(
    board: FakeBoard, session: Session
) -> None:
    board.lose_replies = 1
    request = session._engine.commands.ask(d.ArmMessage(0), session.transport.now_s(), 1.0)
    board.send(
        d.AckMessage(
            request=request.command.request, command=d.MessageId.STOP, result=d.Result.OK, detail=0, value=0.0
        )
    )
    session.wait_for(lambda: False, 0.01)
    assert not request.done
    session.wait_for(lambda: request.done, 0.5)
    assert request.answer().payload[1] == d.MessageId.ARM


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


@pytest.mark.medium
def test_a_clean_line_loses_nothing() -> None:
    session = Session(FakeLine(FakeBoard()))
    seen = collected(session)
    session.connect()
    session.wait(20.0)
    assert_true(seen)
    assert sum(map(len, seen)) == span(seen) == session.counters.ticks_received
    assert (session.counters.ticks_lost, session.counters.frames_bad, session.counters.retries) == (0, 0, 0)


@pytest.mark.medium
def test_an_unplugged_cable_is_an_event_and_the_gap_is_counted_exactly(line: FakeLine) -> None:
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


@pytest.mark.medium
def test_a_command_under_way_when_the_cable_is_pulled_is_executed_once(
    board: FakeBoard, line: FakeLine, session: Session
) -> None:
    session.wait(0.5)
    board.lose_replies = 1
    line.out_at_s = (line.now_s() + 0.01, line.now_s() + 0.7)
    assert session.command(d.ParamSetMessage(0, d.Param.HOVER_V, 2.0)).value == 2.0
    assert len(board.executed) == 1


@pytest.mark.medium
def test_a_cable_that_stays_out_ends_in_one_line_after_the_time_given(line: FakeLine) -> None:
    session = Session(line, reconnect_timeout_s=3.0)
    session.connect()
    line.out_at_s = (line.now_s() + 1.0, 1e9)
    with pytest.raises(LinkLost, match=r"pulled out and did not come back; .*connect again"):
        session.wait(60.0)
    assert 4.0 <= line.now_s() < 4.3
    with pytest.raises(LinkLost):
        session.command(d.ArmMessage(0))


@pytest.mark.medium
def test_a_board_that_falls_silent_is_greeted_and_goes_on(board: FakeBoard, session: Session) -> None:
    session.wait(1.0)
    board.silent = True
    session.wait_for(lambda: False, 2.0)
    board.silent = False
    session.wait(1.0)
    assert [event.kind for event in session.events] == [LINK_SILENT, LINK_RESTORED]
    assert session.counters.reconnects == 1
    assert session.counters.ticks_lost > 1900


@pytest.mark.medium
def test_a_board_silent_for_good_ends_the_wait(board: FakeBoard) -> None:
    session = Session(FakeLine(board), reconnect_timeout_s=2.0)
    session.connect()
    session.wait(0.5)
    board.silent = True
    with pytest.raises(LinkLost, match="does not answer any more"):
        session.wait(60.0)


@pytest.mark.medium
def test_a_restart_of_the_board_is_distinguished_from_a_lost_cable(board: FakeBoard) -> None:
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
    assert 1000 <= latest.tick < 1300


@pytest.mark.medium
def test_a_restart_that_only_the_ticks_show_is_noticed(
    board: FakeBoard, line: FakeLine, session: Session
) -> None:
    session.wait(3.0)
    board.reboot()
    board.advance(0)
    board.open = True
    with pytest.raises(LinkLost, match="restarted"):
        session.wait(10.0)
    assert line.now_s() < 3.6
    assert session.counters.restarts == 1


@pytest.mark.medium
def test_a_restart_while_the_cable_is_out_is_noticed_although_the_tick_has_passed_the_old_one(
    board: FakeBoard, line: FakeLine, session: Session
) -> None:
    session.wait(1.0)
    line.out_at_s = (line.now_s(), line.now_s() + 6.0)
    board.reboot()
    with pytest.raises(LinkLost):
        session.wait(30.0)
    session.wait(0.5)
    assert session.counters.restarts == 1
    assert session.counters.ticks_lost == 0


@pytest.mark.medium
def test_a_restart_under_the_same_id_is_noticed_by_the_tick(board: FakeBoard, session: Session) -> None:
    session.wait(3.0)
    board.reboot()
    board.boot_id -= 1
    with pytest.raises(LinkLost, match="restarted"):
        session.wait(10.0)
    session.wait(1.0)
    assert session.counters.restarts == session.counters.reconnects == 1
    latest = session.latest
    assert latest is not None
    assert 1000 <= latest.tick < 1300


@pytest.mark.medium
@pytest.mark.slow
@pytest.mark.parametrize("damage", ["flip", "drop", "double", "all"])
def test_a_damaged_line_delivers_no_wrong_tick_and_counts_what_is_missing(
    board: FakeBoard, damage: str
) -> None:
    line = FakeLine(board, to_host=damaged(damage, 1), to_board=damaged(damage, 2))
    session = Session(line)
    seen = collected(session)
    session.connect()
    commands = samples(60, 15)
    for index in range(commands):
        value = index / 16
        assert session.command(d.ParamSetMessage(0, d.Param.HOVER_V, value), timeout_s=5.0).value == value
        session.wait(0.5)
    counters = session.counters
    assert_true(seen)
    tick = np.concatenate([ticks.tick for ticks in seen])
    assert (np.diff(tick) > 0).all()
    assert counters.frames_bad > 0
    assert counters.ticks_lost > 0
    assert counters.ticks_received == len(tick)
    assert counters.ticks_received + counters.ticks_lost == span(seen)
    assert [d.ParamSetMessage.unpack(b"\0" + done[1:]).value for done in board.executed] == [
        index / 16 for index in range(commands)
    ]


@pytest.mark.medium
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
    assert session.command(d.ArmMessage(0)).result == d.Result.OK


@pytest.mark.medium
def test_a_callback_may_send_commands_in_lockstep(board: FakeBoard, session: Session) -> None:
    session.wait(0.1)
    unsubscribe = session.subscribe_ticks(lambda ticks: (unsubscribe(), session.command(d.ArmMessage(0)))[0])
    session.wait(0.5)
    assert len(board.executed) == 1


@pytest.mark.medium
def test_a_closed_session_says_so(session: Session) -> None:
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
