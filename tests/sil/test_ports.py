"""A simulated port is opened, closed, pulled out and left unread as a real one; control lines and TCP."""

import contextlib
import math
import os
import re
import signal
import socket
import termios
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

import heli_host
import pytest
import serial
from heli_host.board.heli import Heli
from heli_host.declaration import MessageId, State
from heli_host.errors import BadBaud, HandshakeTimeout, WrongDevice
from heli_host.link.events import BOARD_RESTARTED
from heli_host.link.frames import Frame, FrameParser
from heli_host.link.session import Session
from heli_host.link.transport import SerialTransport, open_transport
from heli_sim.errors import EndpointError, OptionError
from heli_sim.sil.boards import EmulatedDue
from heli_sim.sil.options import SilOptions, parse_options
from heli_sim.sil.ports import (
    PATIENCE_S,
    SILENT_S,
    Endpoint,
    LineChange,
    Lines,
    Rfc2217Endpoint,
    Rfc2217Protocol,
    TcpEndpoint,
)
from heli_sim.sil.pty import PtyEndpoint
from heli_sim.sil.server import is_local, make_clock, run_server, serve
from heli_sim.sil.transport import SilProcess
from heli_sim.sil.world import SilWorld
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests.running.long import samples
from tests.sil.harness import PATIENT, Bench, Host, PtyHost, TcpHost, hello_frame, world

pytestmark = pytest.mark.medium


@pytest.fixture(params=["pty", "tcp"])
def port(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Endpoint]:
    endpoint: Endpoint = PtyEndpoint(tmp_path / "due") if request.param == "pty" else TcpEndpoint()
    yield endpoint
    endpoint.close()


@pytest.fixture
def bench(port: Endpoint) -> Bench:
    return Bench(port, world())


def greet(bench: Bench, host: PtyHost | TcpHost, seq: int = 0) -> None:
    """Open a session through the port."""
    parser = FrameParser()
    welcomed: list[Frame] = []

    def hear() -> bool:
        welcomed.extend(f for f in parser.feed(host.read()) if f.id == MessageId.WELCOME)
        return bool(welcomed)

    host.write(hello_frame(seq))
    bench.until(hear)


def test_a_host_opens_a_session(bench: Bench) -> None:
    greet(bench, bench.open())


def test_the_port_survives_hosts_that_come_and_go(bench: Bench) -> None:
    for seq in range(5):
        host = bench.open()
        bench.until(lambda: bench.endpoint.ready)
        greet(bench, host, seq)
        host.close()
        bench.until(lambda: not bench.endpoint.ready)
    assert bench.world.board.sim.boots == 1


def test_the_next_host_hears_nothing_that_was_meant_for_the_last(bench: Bench) -> None:
    first = bench.open()
    greet(bench, first)
    bench.turn(500)
    first.close()
    bench.until(lambda: not bench.endpoint.ready)
    bench.turn(500)
    second = bench.open()
    bench.until(lambda: bench.endpoint.ready)
    bench.turn(2)
    # The bridge's ring and what the line carried since; two seconds of telemetry would be 5,000 bytes.
    received = b""
    for _ in range(5):
        received += second.read()
    assert len(received) < 400


def test_time_passes_while_nobody_is_there(bench: Bench) -> None:
    bench.turn(100)
    assert bench.world.tick == pytest.approx(400, abs=8)


def test_an_unread_port_overflows_the_bridge_and_recovers(bench: Bench) -> None:
    host = bench.open()
    greet(bench, host)
    # The system's own buffers take tens of thousands of bytes, ten seconds of telemetry and more.
    bench.until(lambda: bench.turn_all(100) and not bench.endpoint.ready)
    before = bench.world.native.line_counters()["to_host_overflow"]
    bench.turn(100)
    assert bench.world.native.line_counters()["to_host_overflow"] > before
    bench.until(lambda: host.read() == b"" and bench.endpoint.ready)
    bench.until(host.read)


@pytest.mark.parametrize("reset", [False, True])
def test_opening_resets_the_board_only_when_asked_to(port: Endpoint, reset: bool) -> None:
    bench = Bench(port, world(reset_on_open="1" if reset else "0"))
    bench.turn(10)
    host = bench.open()
    bench.until(lambda: bench.endpoint.ready)
    bench.turn(80)
    assert bench.world.board.sim.boots == (2 if reset else 1)
    host.close()


def test_pulling_the_cable_takes_the_port_away_and_brings_it_back(port: Endpoint) -> None:
    bench = Bench(port, world(unplug="1:1"))
    url = port.url
    host = bench.open()
    greet(bench, host)
    bench.until(lambda: bench.world.tick >= 1010)
    bench.until(host.gone)
    with pytest.raises(OSError):
        bench.open()
    bench.until(lambda: bench.world.tick >= 2010)
    assert port.url == url
    again = bench.open()
    bench.until(lambda: bench.endpoint.ready)
    greet(bench, again, seq=1)
    assert bench.world.board.sim.boots == 1


def test_a_terminal_is_raw_before_any_host_sets_it_up(tmp_path: Path) -> None:
    endpoint = PtyEndpoint(tmp_path / "due")
    bench = Bench(endpoint, world())
    host = PtyHost(endpoint.url)
    bench.until(lambda: endpoint.ready)
    everything = bytes(range(256))
    endpoint.send(everything)
    received = b""

    def hear() -> bool:
        nonlocal received
        received += host.read()
        return len(received) >= 256

    bench.until(hear)
    assert received[:256] == everything
    assert endpoint.receive() == b""


def test_the_link_goes_with_the_terminal_and_a_stale_one_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "due"
    path.symlink_to("/dev/pts/no-such-terminal")
    endpoint = PtyEndpoint(path)
    assert str(path.readlink()) == endpoint.terminal
    endpoint.close()
    endpoint.close()
    assert not path.is_symlink()


def test_a_second_server_on_the_same_path_is_refused_and_takes_nothing(tmp_path: Path) -> None:
    path = tmp_path / "due"
    first = PtyEndpoint(path)
    with pytest.raises(EndpointError, match=f"another simulated board, process {os.getpid()}; end that"):
        PtyEndpoint(path)
    assert str(path.readlink()) == first.terminal
    # A pulled cable takes the link away, and the path is still this server's.
    first.unplug()
    with pytest.raises(EndpointError, match="another simulated board"):
        PtyEndpoint(path)
    first.plug()
    assert str(path.readlink()) == first.terminal
    first.close()
    assert list(tmp_path.iterdir()) == []
    PtyEndpoint(path).close()


def test_the_link_of_a_killed_server_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "due"
    killed = SilProcess(pty=path)
    os.kill(killed.pid, signal.SIGKILL)
    killed.stop()
    assert path.is_symlink()
    # Linux gives the number of the terminal to the next program, here to this endpoint.
    next_program = PtyEndpoint()
    assert str(path.readlink()) == next_program.terminal
    endpoint = PtyEndpoint(path)
    assert str(path.readlink()) == endpoint.terminal != next_program.terminal
    endpoint.close()
    next_program.close()
    assert list(tmp_path.iterdir()) == []


def test_the_link_of_another_program_is_neither_replaced_nor_removed(tmp_path: Path) -> None:
    path, other = tmp_path / "due", PtyEndpoint()
    for target in (other.terminal, "/dev/null", str(tmp_path), "nowhere"):
        path.symlink_to(target)
        with pytest.raises(EndpointError, match=f"a link to {target}, which no simulated board made"):
            PtyEndpoint(path)
        assert str(path.readlink()) == target
        path.unlink()
    endpoint = PtyEndpoint(path)
    path.unlink()
    path.symlink_to(other.terminal)
    endpoint.close()
    assert str(path.readlink()) == other.terminal
    other.close()


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_a_file_or_folder_in_the_links_place_is_not_replaced(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "due"
    text = path if kind == "file" else path / "homework.txt"
    text.parent.mkdir(exist_ok=True)
    text.write_text("a student's homework")
    with pytest.raises(EndpointError, match=f"is a {kind}, not a link"):
        PtyEndpoint(path)
    assert text.read_text() == "a student's homework"


def test_a_link_in_no_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(EndpointError, match="cannot make the port"):
        PtyEndpoint(tmp_path / "nowhere" / "due")


def test_a_tcp_port_in_use_is_refused() -> None:
    first = TcpEndpoint()
    with pytest.raises(EndpointError, match="give HOST:PORT another port, or 0 for a free one"):
        TcpEndpoint("127.0.0.1", int(first.url.rpartition(":")[2]))
    first.close()


@pytest.mark.parametrize("address", ["nohost", "127.0.0.1:", "127.0.0.1:http"])
def test_a_wrong_tcp_address_is_refused(address: str) -> None:
    with pytest.raises(OptionError, match="HOST:PORT"):
        run_server(SilOptions(), tcp=address)


def test_25_bytes_a_millisecond_reach_the_board() -> None:
    line = world()
    line.advance(1, bytes(1000))
    assert line.native.line_counters()["to_board_bytes"] == 25
    line.advance(20)
    assert line.native.line_counters()["to_board_bytes"] == 525
    line.advance(100)
    assert line.native.line_counters()["to_board_bytes"] == 1000
    assert line.native.line_counters()["to_board_overflow"] == 0


def test_bytes_for_the_board_wait_until_the_line_has_carried_the_ones_before() -> None:
    line = world()
    line.advance(1, bytes(100))
    assert line.native.to_board_waiting == 75


def test_a_host_that_writes_faster_than_the_line_for_seconds_loses_bytes_and_they_are_counted() -> None:
    line = world()
    line.advance(1, bytes(70_000))
    counters = line.native.line_counters()
    assert counters["to_board_overflow"] == 70_000 - 65_536


def test_bytes_reach_the_host_in_bursts_every_4_ms_or_when_96_wait() -> None:
    host = Host()
    host.hello()
    last_us, sizes, gaps_us = None, [], []
    for _ in range(2000):
        data = host.world.advance(1)
        if not data:
            continue
        sizes.append(len(data))
        now_us = host.world.tick * 1000
        if last_us is not None:
            gaps_us.append(now_us - last_us)
        last_us = now_us
    # 100 bytes are four milliseconds of line: every burst is at least three of them apart.
    assert min(gaps_us) >= 3000
    assert max(sizes) <= 128
    assert sum(sizes) <= 25 * 2000


def test_every_burst_falls_on_the_bridges_timer_when_little_is_sent() -> None:
    host = Host()
    ticks = []
    for tick in range(1, 400):
        if host.world.advance(1, hello_frame(tick) if tick % 50 == 1 else b""):
            ticks.append(tick)
        if len(ticks) == 3:
            break
    # Timer 0 of the 16U2 runs over every 4.096 ms; bytes show at the end of that millisecond.
    assert ticks
    ends_of_timer = {math.ceil(4.096 * k) for k in range(1, 120)}
    assert set(ticks) <= ends_of_timer


def test_a_host_that_does_not_read_loses_bytes_and_the_rest_arrives() -> None:
    host = Host()
    host.hello()
    host.wait(200)
    before = host.world.native.line_counters()
    host.world.host_reading = False
    assert host.world.advance(1000) == b""
    lost = host.world.native.line_counters()["to_host_overflow"] - before["to_host_overflow"]
    assert lost > 1000
    host.world.host_reading = True
    # The bytes in the ring of 128 come first.
    assert 0 < len(host.world.advance(5)) <= 128 + 5 * 25


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
        dtr(heli, level=False)
        dtr(heli, level=True)
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


def protocol_server() -> tuple[Rfc2217Protocol, Lines, Wire]:
    lines, wire = Lines([]), Wire()
    return Rfc2217Protocol(cast(Any, lines), cast(Any, wire)), lines, wire


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


GUARD_S = 60.0
"""How long a failing test waits."""


class FakeClock:
    """A clock that the test sets."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        """Return the time."""
        return self.now_s


@pytest.fixture
def clock() -> FakeClock:
    return FakeClock()


@pytest.fixture
def tcp(clock: FakeClock) -> Iterator[TcpEndpoint]:
    tcp = TcpEndpoint(now_s=clock)
    yield tcp
    tcp.close()


def connected(tcp: TcpEndpoint) -> socket.socket:
    """Return a connection that the board's side may hold, or let wait."""
    host, port = tcp.url.removeprefix("socket://").split(":")
    opened = socket.create_connection((host, int(port)), timeout=GUARD_S)
    opened.settimeout(GUARD_S)
    return opened


def until(tcp: TcpEndpoint, so: Callable[[bytes], bool]) -> None:
    """Let the board's side look at its port until something is so; the network may take a moment."""
    give_up_s = time.monotonic() + GUARD_S
    while not so(tcp.receive()):
        assert time.monotonic() < give_up_s, "it never came"
        time.sleep(0.0005)


def test_the_next_host_learns_which_host_has_the_board_and_waits(tcp: TcpEndpoint, clock: FakeClock) -> None:
    first = connected(tcp)
    first.send(b"first")
    until(tcp, lambda data: data == b"first")
    second = connected(tcp)
    until(tcp, lambda _: tcp._waiting is not None)
    clock.now_s += PATIENCE_S
    first.send(b"still here")
    until(tcp, lambda data: data == b"still here")
    until(tcp, lambda _: tcp._is_informed)
    host, port = first.getsockname()
    assert second.recv(200) == f"\r\nthis board is held by {host}:{port}\r\n\0".encode()
    second.send(b"second")
    first.close()
    until(tcp, lambda data: data == b"second")
    second.close()


def test_a_silent_host_gives_way_to_one_that_waits(tcp: TcpEndpoint, clock: FakeClock) -> None:
    silent = connected(tcp)
    until(tcp, lambda _: tcp.ready)
    clock.now_s += 100.0
    tcp.receive()
    assert tcp.ready, "nobody waits: it may stay"
    second = connected(tcp)
    second.send(b"second")
    until(tcp, lambda data: data == b"second")
    assert silent.recv(10) == b""
    second.close()


def test_a_host_that_sends_keeps_the_board(tcp: TcpEndpoint, clock: FakeClock) -> None:
    first, second = connected(tcp), connected(tcp)
    first.send(b"x")
    until(tcp, lambda data: data == b"x")
    until(tcp, lambda _: tcp._waiting is not None)
    for number in range(10):
        clock.now_s += SILENT_S * 0.9
        first.send(b"%d" % number)
        until(tcp, lambda data, wanted=b"%d" % number: data == wanted)  # type: ignore[misc]
    clock.now_s += SILENT_S
    second.send(b"second")
    until(tcp, lambda data: data == b"second")
    first.close()
    second.close()


def test_a_host_that_gave_up_waiting_makes_room_for_another(tcp: TcpEndpoint, clock: FakeClock) -> None:
    first = connected(tcp)
    first.send(b"x")
    until(tcp, lambda data: data == b"x")
    second = connected(tcp)
    until(tcp, lambda _: tcp._waiting is not None)
    second.close()
    until(tcp, lambda _: tcp._waiting is None)
    third = connected(tcp)
    third.send(b"third")
    first.close()
    until(tcp, lambda data: data == b"third")
    third.close()


def test_a_session_reports_the_waiting_message() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        transport = open_transport(f"socket://127.0.0.1:{port}")
        held, _ = server.accept()
        held.send(b"\r\nthis board is held by 127.0.0.1:4242\r\n\0")
        with held, pytest.raises(WrongDevice, match=r"in words 'this board is held by 127\.0\.0\.1:4242'"):
            Session(transport, handshake_timeout_s=0.3).connect()
        transport.close()


@pytest.mark.parametrize(
    ("url", "local"),
    [
        ("socket://127.0.0.1:5000", True),
        ("rfc2217://localhost:5000", True),
        ("/dev/pts/3", True),
        ("socket://0.0.0.0:5000", False),
        ("socket://192.168.1.7:5000", False),
        ("socket://bench-3:5000", False),
    ],
)
def test_an_address_that_others_can_reach_is_known(url: str, local: bool) -> None:
    assert is_local(url) is local


def test_an_address_that_others_can_reach_is_warned_about(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from heli_host.ui.cli import run
    from heli_sim.sil import server

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(server, "serve", stop)
    for address, warned in (("0.0.0.0:0", True), ("127.0.0.1:0", False)):
        assert run(["sil", "--tcp", address]) == 0
        output = capsys.readouterr().err
        assert bool(re.search("everybody on the network can fly this board", output)) is warned
