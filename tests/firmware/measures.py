"""Numbers promised of the firmware, measured on the emulated board; tests and bench both ask here."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from heli_host.declaration import (
    LINK_HASH,
    Axis,
    Channel,
    HelloMessage,
    MessageId,
    PingMessage,
    StatusMessage,
    StatusReadMessage,
)
from heli_host.link.frames import Frame, FrameParser, encode_frame

from firmware.due.report import Image
from tests.firmware.desk import TRAVEL_INTERRUPT, Board
from tests.firmware.hangs import HANGS, KICK_INTERVAL_MS, FASTEST_Hz, SLOWEST_Hz, off_after_ms

RX_BYTES: Final = 20_000
EDGES: Final = 20_000
EDGE_INTERVAL_US: Final = 5.0
"""200,000 edges a second."""
EDGES_ONE_WAY: Final = 10
HELLO_INTERVAL_MS: Final = 2
PATIENCE_MS: Final = 1000


def boot_to_first_frame_ms(board: Board) -> float:
    """Switch the power off and on; how long until a host that greets has the first frame [ms]."""
    board.cut_power()
    board.restore_power()
    start_us = board.due.now_us
    parser = FrameParser()
    for k in range(PATIENCE_MS):
        if k % HELLO_INTERVAL_MS == 0:
            board.write(encode_frame(MessageId.HELLO, k & 0xFF, HelloMessage(1, LINK_HASH, 1).pack()))
        if parser.feed(board.advance(1)):
            return 1e-3 * (board.due.now_us - start_us)
    raise AssertionError("the board sends nothing")


def _exchange(board: Board, sent: bytes, wanted: MessageId) -> Frame:
    board.write(sent)
    parser = FrameParser()
    for _ in range(PATIENCE_MS):
        for frame in parser.feed(board.advance(1)):
            if frame.id == wanted:
                return frame
    raise AssertionError(f"the board does not answer with {wanted.name}")


def _frames_ok(board: Board) -> int:
    request = encode_frame(MessageId.STATUS_READ, 0, StatusReadMessage(1).pack())
    return StatusMessage.unpack(_exchange(board, request, MessageId.STATUS).payload).frames_ok


def rx_lost_bytes(board: Board) -> int:
    """Send 20,000 bytes in a row under full telemetry; how many of them the firmware did not get."""
    board.advance(20)
    hello = encode_frame(MessageId.HELLO, 0, HelloMessage(1, LINK_HASH, 1).pack())
    _exchange(board, hello, MessageId.WELCOME)
    before = _frames_ok(board)
    size = len(encode_frame(MessageId.PING, 0, PingMessage(0, 0).pack()))
    frames = [
        encode_frame(MessageId.PING, k % 256, PingMessage(0, k).pack()) for k in range(RX_BYTES // size + 1)
    ]
    board.write(b"".join(frames))
    board.advance(round(sum(map(len, frames)) / 25) + 50)
    # The second question for the count is a frame too.
    received = _frames_ok(board) - before - 1
    return (len(frames) - received) * size + board.due.uart_overruns


def travel_counts_lost(board: Board) -> int:
    """Turn the travel encoder to and fro at 200,000 edges a second while the law flies; edges not counted."""
    heli = board.connect()
    heli.arm()
    heli.control()
    board.due.clear_stats()
    # To and fro, so that no limit on rate or angle ends the flight meanwhile.
    start_us = board.due.now_us
    net = 0
    for k in range(EDGES):
        direction = 1 if k // EDGES_ONE_WAY % 2 == 0 else -1
        net += direction
        board.due.schedule_step(Axis.TRAVEL, direction, start_us + 10.0 + EDGE_INTERVAL_US * k)
    heli.wait(1e-6 * EDGES * EDGE_INTERVAL_US + 0.02)
    assert heli.motors_may_run, "the flight ended while edges came"
    handled = board.due.exception_stats(TRAVEL_INTERRUPT)[0]
    latest = heli.session.latest
    assert latest is not None
    miscounted = abs(int(latest[1][Channel.TRAVEL_COUNT]) - net)
    return EDGES - handled + miscounted + heli.session.status().illegal_travel


def longest_off_after_hang_ms(elf: Path, image: Image) -> float:
    """Return the longest time [ms] that motors stay on after a hang, over all hangs, slow clocks and phases."""
    return max(
        off_after_ms(elf, image, hang, slow_Hz, phase_ms)
        for hang in HANGS
        for slow_Hz in (SLOWEST_Hz, FASTEST_Hz)
        for phase_ms in range(KICK_INTERVAL_MS)
    )
