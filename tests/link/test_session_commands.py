"""Commands: answered once, executed once, refused in words; streams: bounded, and kept fresh."""

from __future__ import annotations

import itertools
import math

import pytest
from heli_host.declaration import (
    AckMessage,
    ArmMessage,
    ControlMessage,
    Fault,
    MessageId,
    Param,
    ParamSetMessage,
    Result,
    SetpointMessage,
    State,
    StatusMessage,
    VoltagesMessage,
)
from heli_host.errors import CommandRefused, CommandTimeout, LinkLost

from tests.link.fake_board import FakeBoard, FakeLine, connected_session, ticks_of_received


def test_a_command_whose_acks_are_lost_is_repeated_and_executed_once() -> None:
    board = FakeBoard()
    session = connected_session(board)
    board.lose_replies = 3
    ack = session.command(ParamSetMessage(0, Param.HOVER_V, 2.5))
    assert ack.value == 2.5
    assert len(board.executed) == 1
    assert session.counters.retries == 3
    assert len(ticks_of_received(board, MessageId.PARAM_SET)) == 4
    assert len({frame.payload for _, frame in board.heard if frame.id == MessageId.PARAM_SET}) == 1


def test_a_command_that_is_lost_on_its_way_is_repeated() -> None:
    board = FakeBoard()
    session = connected_session(board)
    line = session.transport
    assert isinstance(line, FakeLine)
    lost = [2]

    def lose_two(data: bytes) -> bytes:
        if data and lost[0]:
            lost[0] -= 1
            return b""
        return data

    line._to_board = lose_two
    session.command(ArmMessage(0))
    assert len(board.executed) == 1
    assert session.counters.retries == 2


def test_repeated_acks_are_not_taken_for_answers_to_later_commands() -> None:
    board = FakeBoard()
    session = connected_session(board)
    board.repeat_replies = 3
    for index in range(20):
        assert session.command(ParamSetMessage(0, Param.HOVER_V, index / 8)).value == index / 8
    assert len(board.executed) == 20
    assert session.counters.retries == 0


def test_a_late_ack_of_the_same_command_is_not_taken_for_the_answer_to_a_new_one() -> None:
    board = FakeBoard()
    session = connected_session(board)
    session.command(ParamSetMessage(0, Param.HOVER_V, 1.0))
    late = ParamSetMessage.unpack(
        next(frame for _, frame in board.heard if frame.id == MessageId.PARAM_SET).payload
    )
    board.lose_replies = 1
    board.send(AckMessage(late.request, MessageId.PARAM_SET, Result.OK, 0, 1.0))
    assert session.command(ParamSetMessage(0, Param.HOVER_V, 2.0)).value == 2.0
    assert session.counters.retries == 1


@pytest.mark.medium
def test_a_command_without_any_answer_times_out_at_its_deadline() -> None:
    board = FakeBoard()
    session = connected_session(board)
    board.lose_replies = 10**6
    began_s = session.transport.now_s()
    with pytest.raises(CommandTimeout, match=r"did not answer arm in [0-9]+ tries"):
        session.command(ArmMessage(0), timeout_s=1.5)
    assert 1.5 <= session.transport.now_s() - began_s < 1.52
    assert len(board.executed) == 1


@pytest.mark.medium
def test_three_hundred_commands_wrap_the_request_number_without_confusion() -> None:
    board = FakeBoard()
    session = connected_session(board)
    for index in range(300):
        session.command(ParamSetMessage(0, Param.ELEVATION_KP, index / 64))
    assert [ParamSetMessage.unpack(b"\0" + done[1:]).value for done in board.executed] == [
        index / 64 for index in range(300)
    ]


def test_a_failed_check_names_the_fault_its_limit_and_the_remedy() -> None:
    board = FakeBoard()
    board.refusals[MessageId.ARM] = (Result.CHECK_FAILED, Fault.NOT_AT_REST, -17.5)
    with pytest.raises(CommandRefused) as caught:
        connected_session(board).command(ArmMessage(0))
    assert caught.value.fault is Fault.NOT_AT_REST
    assert caught.value.parameter == "arm_elevation_tolerance_deg"
    for part in ("arm", "not_at_rest", "does not rest on the table", "-17.5", "let it rest on the table"):
        assert part in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_wrong_state_names_the_state_and_what_to_do_first() -> None:
    board = FakeBoard()
    board.refusals[MessageId.CONTROL] = (Result.BAD_STATE, State.FAULT, 0.0)
    with pytest.raises(
        CommandRefused, match=r"control: not allowed in state fault; .*clear the fault"
    ) as caught:
        connected_session(board).command(ControlMessage(0, 7, 0.0, 0.0))
    assert caught.value.state is State.FAULT


@pytest.mark.parametrize("result", [result for result in range(14) if result])
@pytest.mark.parametrize("detail", [0, 3, 22, 255])
def test_every_refusal_is_one_line_with_a_remedy(result: int, detail: int) -> None:
    error = CommandRefused(MessageId.PARAM_SET, result, detail, 1.0)
    assert "\n" not in str(error)
    assert error.cause
    assert error.remedy


def test_all_parameters_arrive_over_several_replies() -> None:
    board = FakeBoard()
    board.params = [index / 4 for index in range(len(Param))]
    assert list(connected_session(board).read_params()) == board.params


@pytest.mark.medium
def test_status_is_read_and_also_comes_by_itself() -> None:
    board = FakeBoard()
    session = connected_session(board)
    received: list[StatusMessage] = []
    session.subscribe_status(received.append)
    assert session.status().illegal_travel == 11
    received.clear()
    session.wait(3.0)
    assert len(received) == 3
    assert session.counters.board == received[-1]


def test_a_board_that_forgot_the_session_is_greeted_again_and_the_command_executed_once() -> None:
    board = FakeBoard()
    session = connected_session(board)
    board.open = False
    assert session.command(ArmMessage(0)).result == Result.OK
    assert len(board.executed) == 1
    assert session.counters.reconnects == 1


def test_a_command_is_not_repeated_to_a_board_that_restarted() -> None:
    board = FakeBoard()
    session = connected_session(board)
    session.wait(0.5)
    board.lose_replies = 1
    execute = board._execute

    def execute_then_die(frame: object) -> bytes:
        reply = execute(frame)  # type: ignore[arg-type]
        board.reboot()
        return reply

    board._execute = execute_then_die  # type: ignore[method-assign]
    with pytest.raises(LinkLost, match="the board restarted \\(watchdog\\) before it answered"):
        session.command(ArmMessage(0))
    assert len(board.executed) == 1
    assert session.counters.restarts == 1


@pytest.mark.medium
def test_the_board_hears_something_at_least_five_times_a_second() -> None:
    board = FakeBoard()
    session = connected_session(board)
    session.wait(10.0)
    ticks = [tick for tick, _ in board.heard]
    assert max(later - sooner for sooner, later in itertools.pairwise(ticks)) <= 220


@pytest.mark.medium
def test_setpoints_go_out_at_200_Hz_at_most_and_the_latest_wins() -> None:
    board = FakeBoard()
    session = connected_session(board)
    first_tick = board.tick
    for index in range(1000):
        session.stream(SetpointMessage(0, index * 1e-3, 0.0, 0.0))
        if index % 10 == 9:
            session.wait_for(lambda: False, 0.01)
    session.wait_for(lambda: False, 0.05)
    ticks = ticks_of_received(board, MessageId.SETPOINT)
    counters = session.counters
    assert len(ticks) <= (board.tick - first_tick) / 5 + 1
    assert len(ticks) == counters.setpoints_sent
    assert counters.setpoints_sent + counters.setpoints_skipped == 1000
    last = [frame for _, frame in board.heard if frame.id == MessageId.SETPOINT][-1]
    assert math.isclose(SetpointMessage.unpack(last.payload).elevation_rad, 0.999, rel_tol=1e-6)


def test_voltages_go_out_at_500_Hz_at_most() -> None:
    board = FakeBoard()
    session = connected_session(board)
    first_tick = board.tick
    for _ in range(500):
        session.stream(VoltagesMessage(1.0, 2.0, 50))
        session.wait_for(lambda: False, 0.001)
    assert 200 <= len(ticks_of_received(board, MessageId.VOLTAGES)) <= (board.tick - first_tick) / 2 + 1
    assert session.counters.voltages_skipped > 0


@pytest.mark.medium
def test_the_last_setpoint_is_kept_fresh_only_while_the_board_flies_on_setpoints() -> None:
    board = FakeBoard()
    session = connected_session(board)
    session.keep_alive(SetpointMessage(0, 0.1, 0.0, 0.0))
    session.wait(1.0)
    assert ticks_of_received(board, MessageId.SETPOINT) == []
    session.command(ArmMessage(0))
    session.command(ControlMessage(0, 7, 0.0, 0.0))
    session.wait(0.2)
    began = len(ticks_of_received(board, MessageId.SETPOINT))
    session.wait(5.0)
    ticks = ticks_of_received(board, MessageId.SETPOINT)[began:]
    assert max(later - sooner for sooner, later in itertools.pairwise(ticks)) <= 120
    session.keep_alive(None)
    session.wait(0.1)
    before = len(ticks_of_received(board, MessageId.SETPOINT))
    session.wait(1.0)
    assert len(ticks_of_received(board, MessageId.SETPOINT)) == before


def test_an_ack_for_another_command_with_the_same_number_is_no_answer() -> None:
    board = FakeBoard()
    session = connected_session(board)
    board.lose_replies = 1
    request = session._engine.commands.ask(ArmMessage(0), session.transport.now_s(), 1.0)
    board.send(AckMessage(request.command.request, MessageId.STOP, Result.OK, 0, 0.0))
    session.wait_for(lambda: False, 0.01)
    assert not request.done
    session.wait_for(lambda: request.done, 0.5)
    assert request.answer().payload[1] == MessageId.ARM
