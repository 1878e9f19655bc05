"""A simulated port may be opened, closed, opened again, pulled out and left unread, as a real one."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from heli_host.declaration import MessageId
from heli_host.link.frames import Frame, FrameParser
from heli_sim.errors import EndpointError, OptionError
from heli_sim.sil.endpoint import Endpoint
from heli_sim.sil.options import SilOptions
from heli_sim.sil.process import SilProcess
from heli_sim.sil.pty import PtyEndpoint
from heli_sim.sil.server import run_server
from heli_sim.sil.tcp import TcpEndpoint

from tests.sil.harness import hello_frame, world
from tests.sil.ports import Bench, PtyHost, TcpHost

pytestmark = pytest.mark.medium

Opener = Callable[[str], PtyHost | TcpHost]


@pytest.fixture(params=["pty", "tcp"])
def port(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[Endpoint, Opener]]:
    endpoint: Endpoint = PtyEndpoint(tmp_path / "due") if request.param == "pty" else TcpEndpoint()
    yield endpoint, (PtyHost if request.param == "pty" else TcpHost)
    endpoint.close()


def greet(bench: Bench, host: PtyHost | TcpHost, seq: int = 0) -> None:
    """Open a session through the port."""
    parser = FrameParser()
    welcomed: list[Frame] = []

    def hear() -> bool:
        welcomed.extend(f for f in parser.feed(host.read()) if f.id == MessageId.WELCOME)
        return bool(welcomed)

    host.write(hello_frame(seq))
    bench.until(hear)


def test_a_host_opens_a_session(port: tuple[Endpoint, Opener]) -> None:
    endpoint, open_port = port
    greet(Bench(endpoint, world()), open_port(endpoint.url))


def test_the_port_survives_hosts_that_come_and_go(port: tuple[Endpoint, Opener]) -> None:
    endpoint, open_port = port
    bench = Bench(endpoint, world())
    for seq in range(5):
        host = open_port(endpoint.url)
        bench.until(lambda: endpoint.ready)
        greet(bench, host, seq)
        host.close()
        bench.until(lambda: not endpoint.ready)
    assert bench.world.board.sim.boots == 1


def test_the_next_host_hears_nothing_that_was_meant_for_the_last(port: tuple[Endpoint, Opener]) -> None:
    endpoint, open_port = port
    bench = Bench(endpoint, world())
    first = open_port(endpoint.url)
    greet(bench, first)
    bench.turn(500)
    first.close()
    bench.until(lambda: not endpoint.ready)
    bench.turn(500)
    second = open_port(endpoint.url)
    bench.until(lambda: endpoint.ready)
    bench.turn(2)
    # The bridge's ring and what the line carried since; two seconds of telemetry would be 5,000 bytes.
    received = b""
    for _ in range(5):
        received += second.read()
    assert len(received) < 400


def test_time_passes_while_nobody_is_there(port: tuple[Endpoint, Opener]) -> None:
    endpoint, _ = port
    bench = Bench(endpoint, world())
    bench.turn(100)
    assert bench.world.tick == pytest.approx(400, abs=8)


def test_an_unread_port_overflows_the_bridge_and_recovers(port: tuple[Endpoint, Opener]) -> None:
    endpoint, open_port = port
    bench = Bench(endpoint, world())
    host = open_port(endpoint.url)
    greet(bench, host)
    # The system's own buffers take tens of thousands of bytes, ten seconds of telemetry and more.
    bench.until(lambda: bench.turn_all(100) and not endpoint.ready)
    before = bench.world.native.line_counters()["to_host_overflow"]
    bench.turn(100)
    assert bench.world.native.line_counters()["to_host_overflow"] > before
    bench.until(lambda: host.read() == b"" and endpoint.ready)
    bench.until(host.read)


@pytest.mark.parametrize("reset", [False, True])
def test_opening_resets_the_board_only_when_asked_to(port: tuple[Endpoint, Opener], reset: bool) -> None:
    endpoint, open_port = port
    bench = Bench(endpoint, world(reset_on_open="1" if reset else "0"))
    bench.turn(10)
    host = open_port(endpoint.url)
    bench.until(lambda: endpoint.ready)
    bench.turn(80)
    assert bench.world.board.sim.boots == (2 if reset else 1)
    host.close()


def test_pulling_the_cable_takes_the_port_away_and_brings_it_back(port: tuple[Endpoint, Opener]) -> None:
    endpoint, open_port = port
    bench = Bench(endpoint, world(unplug="1:1"))
    url = endpoint.url
    host = open_port(url)
    greet(bench, host)
    bench.until(lambda: bench.world.tick >= 1010)
    bench.until(host.gone)
    with pytest.raises(OSError):
        open_port(url)
    bench.until(lambda: bench.world.tick >= 2010)
    assert endpoint.url == url
    again = open_port(url)
    bench.until(lambda: endpoint.ready)
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
