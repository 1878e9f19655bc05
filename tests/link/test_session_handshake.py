"""Greeting a board: with a deadline instead of a sleep, and with the right words when it is none."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from heli_host.declaration import LINK_HASH, LINK_VERSION, MessageId
from heli_host.errors import HandshakeTimeout, LinkVersionMismatch, WrongDevice
from heli_host.link.session import Session

from tests.link.fake_board import BATCH_TICKS, FakeBoard, FakeLine


def test_a_board_that_listens_is_met_within_a_tenth_of_a_second() -> None:
    line = FakeLine(FakeBoard())
    with Session(line) as session:
        welcome = session.connect()
    assert welcome.boot_id == 1
    assert line.now_s() < 0.1


def test_silence_ends_at_the_deadline_and_says_what_to_check() -> None:
    board = FakeBoard()
    board.answers_hello = False
    line = FakeLine(board)
    with Session(line, handshake_timeout_s=3.0) as session, pytest.raises(HandshakeTimeout) as caught:
        session.connect()
    assert 3.0 <= line.now_s() < 3.1
    assert "no data came" in str(caught.value)
    assert "check power and cable" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_hello_is_repeated_every_tenth_of_a_second() -> None:
    board = FakeBoard()
    board.answers_hello = False
    with Session(FakeLine(board), handshake_timeout_s=2.0) as session, pytest.raises(HandshakeTimeout):
        session.connect()
    assert 18 <= sum(frame.id == MessageId.HELLO for _, frame in board.heard) <= 21


@pytest.mark.parametrize(
    "sent", [b"Hello, I am a GPS!\r\n$GPGGA,1,2*33\r\n", b"\0\0\0\x05\x01", bytes(range(256))]
)
def test_bytes_that_are_not_ours_are_a_wrong_device_with_count_and_excerpt(sent: bytes) -> None:
    board = FakeBoard()
    board.answers_hello = False
    with Session(FakeLine(board, to_host=lambda _: sent)) as session, pytest.raises(WrongDevice) as caught:
        session.connect()
    assert caught.value.byte_count % len(sent) == 0
    assert str(caught.value.byte_count) in str(caught.value)
    assert caught.value.excerpt.hex(" ") in str(caught.value)
    assert caught.value.excerpt in (sent * 20).replace(b"\0", b"")


@pytest.mark.medium
def test_our_frames_without_an_answer_are_not_called_a_wrong_device() -> None:
    board = FakeBoard()
    board.answers_hello = False
    line = FakeLine(board)
    board.open = True
    with Session(line) as session, pytest.raises(HandshakeTimeout, match="sends data, but did not answer"):
        session.connect()


def test_a_version_mismatch_names_both_versions_and_hashes_at_once() -> None:
    board = FakeBoard()
    board.link_hash, board.link_version = 0xDEADBEEF, (2, 7)
    line = FakeLine(board)
    with Session(line) as session, pytest.raises(LinkVersionMismatch) as caught:
        session.connect()
    for part in (LINK_VERSION, "2.7", f"{LINK_HASH:08x}", "deadbeef", "firmware 0.1.2"):
        assert part in str(caught.value)
    assert line.now_s() < 0.5


def test_a_board_that_resets_for_three_seconds_and_sends_rubbish_meanwhile_is_met() -> None:
    board = FakeBoard()
    board.answers_hello = False
    line = FakeLine(board, to_host=_rubbish_until(board, 3000))
    with Session(line) as session:
        session.connect()
        assert 3.0 < line.now_s() < 3.3
        session.wait(1.0)
        assert (session.counters.frames_bad, session.counters.ticks_lost) == (0, 0)


@pytest.mark.medium
def test_telemetry_that_flows_already_does_not_disturb_and_is_not_counted() -> None:
    board = FakeBoard()
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
