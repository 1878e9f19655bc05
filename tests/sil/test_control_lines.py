"""DTR resets a Due and erases it at 1200 baud: by the line over RFC 2217, by opening where there is none."""

from __future__ import annotations

import contextlib
import os
import socket
import termios
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

import heli_host
import pytest
import serial
from heli_host.board.heli import Heli
from heli_host.declaration import State
from heli_host.errors import BadBaud, HandshakeTimeout
from heli_host.link.events import BOARD_RESTARTED
from heli_host.link.transport import SerialTransport
from heli_sim.sil.boards import EmulatedDue
from heli_sim.sil.clock import make_clock
from heli_sim.sil.endpoint import LineChange
from heli_sim.sil.options import parse_options
from heli_sim.sil.process import SilProcess
from heli_sim.sil.pty import PtyEndpoint
from heli_sim.sil.rfc2217 import Lines, Protocol, Rfc2217Endpoint
from heli_sim.sil.server import serve
from heli_sim.sil.world import SilWorld
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests.running.long import samples
from tests.sil.harness import world
from tests.sil.patient import PATIENT
from tests.sil.ports import Bench, PtyHost

pytestmark = pytest.mark.medium

Board = dict[str, str]


class Terminal(PtyHost):
    """A host that sets the port up."""

    def set(self, *, hupcl: bool, speed: int = termios.B115200) -> None:
        settings = termios.tcgetattr(self._fd)
        settings[2] = settings[2] | termios.HUPCL if hupcl else settings[2] & ~termios.HUPCL
        settings[4] = settings[5] = speed
        termios.tcsetattr(self._fd, termios.TCSANOW, settings)


@pytest.fixture
def endpoint(tmp_path: Path) -> Iterator[PtyEndpoint]:
    endpoint = PtyEndpoint(tmp_path / "due")
    yield endpoint
    endpoint.close()


def open_terminal(bench: Bench) -> Terminal:
    host = Terminal(bench.endpoint.url)
    bench.until(lambda: bench.endpoint.ready)
    bench.turn(80)
    return host


def closed(bench: Bench, host: Terminal) -> None:
    host.close()
    bench.until(lambda: not bench.endpoint.ready)
    bench.turn(80)


def boots(bench: Bench) -> int:
    return bench.world.board.sim.boots


def test_every_opening_of_a_terminal_resets_an_emulated_due(endpoint: PtyEndpoint, elf: Path) -> None:
    bench = Bench(endpoint, world(board="due", elf=str(elf)))
    bench.turn(10)
    for count in (2, 3, 4):
        host = open_terminal(bench)
        assert boots(bench) == count
        closed(bench, host)
        assert boots(bench) == count


def test_a_host_that_clears_the_hang_up_flag_spares_the_next_one_the_reset(endpoint: PtyEndpoint) -> None:
    bench = Bench(endpoint, world(reset_on_open="1"))
    bench.turn(10)
    host = open_terminal(bench)
    assert boots(bench) == 2
    host.set(hupcl=False)
    closed(bench, host)
    host = open_terminal(bench)
    assert boots(bench) == 2
    host.set(hupcl=True)
    closed(bench, host)
    open_terminal(bench)
    assert boots(bench) == 3


def test_opening_a_native_board_resets_nothing_unless_asked_to(endpoint: PtyEndpoint) -> None:
    bench = Bench(endpoint, world())
    bench.turn(10)
    open_terminal(bench)
    assert boots(bench) == 1


def test_a_terminal_closed_at_1200_baud_erases_the_flash(endpoint: PtyEndpoint, elf: Path) -> None:
    bench = Bench(endpoint, world(board="due", elf=str(elf)))
    host = open_terminal(bench)
    host.set(hupcl=True, speed=termios.B1200)
    closed(bench, host)
    board = bench.world.board
    assert isinstance(board, EmulatedDue)
    assert board.sim.due.in_rom
    assert set(board.sim.due.flash()) == {0xFF}


def test_an_erased_native_board_is_silent_too() -> None:
    erased = world()
    erased.control_lines(dtr=False, baud=1200)
    assert erased.advance(500) == b""
    assert erased.board.sim.boots == 0


def test_a_flight_survives_a_host_that_dies_where_opening_resets_nothing(elf: Path) -> None:
    options = {"board": "due", "elf": str(elf), "reset_on_open": "0"}
    with SilProcess(speed=None, options=options) as board:
        first = heli_host.connect(board.url, land_on_exit=False)
        first.params.restore(PATIENT)
        first.take_off(0.0)
        # As a host that is killed: the port is closed, nothing is said.
        first.session.close()
        with heli_host.connect(board.url) as second:
            assert second.info.boot_id == first.info.boot_id
            assert second.state in (State.CLOSED_LOOP, State.HOLD, State.LANDING)
            second.land()


def test_lines_report_only_changes() -> None:
    changes: list[LineChange] = []
    lines = Lines(changes)
    lines.baudrate = 250_000
    for level in (False, True, True, False):
        lines.dtr = level
    assert changes == [LineChange(True, 250_000), LineChange(False, 250_000)]


class Served:
    """A world behind RFC 2217, served by a thread."""

    def __init__(self, options: Board) -> None:
        self.world = SilWorld(parse_options(options))
        self.endpoint = Rfc2217Endpoint()
        self.url = self.endpoint.url


@contextmanager
def served(options: Board) -> Iterator[Served]:
    board = Served(options)
    stop, stopper = os.pipe()
    thread = threading.Thread(target=serve, args=(board.endpoint, board.world, make_clock(None), stop))
    thread.start()
    try:
        yield board
    finally:
        os.close(stopper)
        thread.join()
        os.close(stop)
        board.endpoint.close()


def test_a_flight_over_rfc2217_begins_with_a_reset(elf: Path) -> None:
    with served({"board": "due", "elf": str(elf)}) as due, heli_host.connect(due.url) as heli:
        assert due.url.startswith("rfc2217://")
        assert heli.info.reset == "user"
        assert due.world.board.sim.boots == 2
        heli.take_off(0.0)
        heli.land()
        assert heli.state is State.IDLE
        assert heli.counters.ticks_lost == 0


def dtr(heli: Heli, level: bool) -> None:
    transport = heli.session.transport
    assert isinstance(transport, SerialTransport)
    transport._serial.dtr = level


def test_a_session_survives_a_reset_by_the_line(elf: Path) -> None:
    with served({"board": "due", "elf": str(elf)}) as due, heli_host.connect(due.url) as heli:
        dtr(heli, False)
        dtr(heli, True)
        assert heli.session.wait_for(lambda: heli.counters.restarts == 1, 30.0)
        (restart,) = [event for event in heli.session.events if event.kind == BOARD_RESTARTED]
        assert "user" in restart.text
        heli.take_off(0.0)
        heli.land()
        assert heli.state is State.IDLE


def test_1200_baud_is_refused_by_the_host_and_would_have_erased_the_flash(elf: Path) -> None:
    with served({"board": "due", "elf": str(elf)}) as due:
        with pytest.raises(BadBaud):
            heli_host.connect(due.url, baud=1200)
        with heli_host.connect(due.url) as heli:
            assert heli.info.board == "Arduino Due"
        # Request that the host refuses.
        serial.serial_for_url(due.url, 1200).close()
        with pytest.raises(HandshakeTimeout):
            heli_host.connect(due.url, handshake_timeout_s=1.0)
        board = due.world.board
        assert isinstance(board, EmulatedDue)
        assert board.sim.due.in_rom
        assert set(board.sim.due.flash()) == {0xFF}


def test_bytes_that_mean_something_to_telnet_pass_unchanged() -> None:
    everything = bytes(range(256)) + b"\xff\xff\xf0\xfa"
    endpoint = Rfc2217Endpoint()
    received = bytearray()
    stop = threading.Event()

    def echo() -> None:
        while not stop.wait(0.001):
            data = endpoint.receive()
            received.extend(data)
            endpoint.send(data)

    thread = threading.Thread(target=echo)
    thread.start()
    try:
        with serial.serial_for_url(endpoint.url, 250_000, timeout=30.0) as port:
            port.write(everything)
            assert port.read(len(everything)) == everything
    finally:
        stop.set()
        thread.join()
        endpoint.close()
    assert bytes(received) == everything


class Wire:
    """The network side of a server of the protocol: it keeps what is sent."""

    def __init__(self) -> None:
        self.sent = bytearray()

    def write(self, data: bytes) -> None:
        self.sent += data


def protocol_server() -> tuple[Protocol, Lines, Wire]:
    lines, wire = Lines([]), Wire()
    return Protocol(cast(Any, lines), cast(Any, wire)), lines, wire


IAC, SB, SE, COM_PORT = b"\xff", b"\xfa", b"\xf0", b"\x2c"
BYTE = st.integers(0, 255).map(lambda number: bytes((number,)))
REQUEST = st.builds(
    lambda option, value, end: IAC + SB + COM_PORT + option + value.replace(IAC, IAC + IAC) + end,
    st.integers(0, 13).map(lambda number: bytes((number,))),
    st.binary(max_size=6),
    st.sampled_from((IAC + SE, IAC + SE, b"", IAC, SE, IAC + SB)),
)
NEGOTIATION = st.builds(
    lambda command, option: IAC + command + option,
    st.sampled_from((b"\xfb", b"\xfc", b"\xfd", b"\xfe")),
    BYTE,
)
TRAFFIC = st.lists(st.one_of(st.binary(max_size=20), BYTE.map(lambda byte: IAC + byte), REQUEST, NEGOTIATION))


@settings(max_examples=samples(5000, 300), deadline=None)
@given(pieces=TRAFFIC, cuts=st.lists(st.integers(1, 7), min_size=1, max_size=5))
@example(pieces=[IAC + SE], cuts=[1])
@example(pieces=[IAC + SB + COM_PORT + b"\x01\x00" + IAC + SE], cuts=[9])
@example(pieces=[IAC + SB + COM_PORT + b"\x03\x09" + IAC + SE], cuts=[9])
@example(pieces=[IAC + SB + COM_PORT + b"\x0a" + IAC + SE], cuts=[9])
def test_no_bytes_of_a_host_end_the_server_or_fill_its_memory(pieces: list[bytes], cuts: list[int]) -> None:
    server, lines, wire = protocol_server()
    traffic = b"".join(pieces)
    at, passed = 0, b""
    while at < len(traffic):
        size = cuts[at % len(cuts)]
        passed += b"".join(server.filter(traffic[at : at + size]))
        at += size
    assert len(passed) <= len(traffic)
    assert len(server.suboption or b"") <= 64
    # Whatever came before, a host that ends it and asks for a rate gets it.
    request = IAC + SE + IAC + SE + IAC + SB + COM_PORT + b"\x01" + (250_000).to_bytes(4) + IAC + SE
    assert len(b"".join(server.filter(request))) <= 2
    assert lines.baudrate == 250_000
    assert wire.sent.endswith(IAC + SB + COM_PORT + b"\x65" + (250_000).to_bytes(4) + IAC + SE)


def test_a_request_without_end_keeps_a_few_bytes_only() -> None:
    server, _, _ = protocol_server()
    assert b"".join(server.filter(IAC + SB + bytes(1_000_000))) == b""
    assert len(server.suboption or b"") == 64


def test_a_host_that_asks_and_never_reads_is_disconnected() -> None:
    endpoint = Rfc2217Endpoint()
    ask = (IAC + SB + COM_PORT + b"\x07" + IAC + SE) * 5000
    with socket.socket() as host:
        host.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        host.connect(("127.0.0.1", int(endpoint.url.rpartition(":")[2])))
        host.setblocking(False)
        while endpoint._peer is None:
            endpoint.receive()
        try:
            while endpoint._peer is not None:
                with contextlib.suppress(BlockingIOError, ConnectionError):
                    host.send(ask)
                endpoint.receive()
                assert len(endpoint._unsent) < 100_000
        finally:
            endpoint.close()
