"""Hosts at one TCP port: a silent host gives way, and a waiting host learns which host has the board."""

from __future__ import annotations

import re
import socket
import time
from collections.abc import Callable, Iterator

import pytest
from heli_host.errors import WrongDevice
from heli_host.link.session import Session
from heli_host.link.transport import open_transport
from heli_sim.sil.server import is_local
from heli_sim.sil.tcp import PATIENCE_S, SILENT_S, TcpEndpoint

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
def endpoint(clock: FakeClock) -> Iterator[TcpEndpoint]:
    endpoint = TcpEndpoint(now_s=clock)
    yield endpoint
    endpoint.close()


def connected(endpoint: TcpEndpoint) -> socket.socket:
    """Return a connection that the board's side may hold, or let wait."""
    host, port = endpoint.url.removeprefix("socket://").split(":")
    opened = socket.create_connection((host, int(port)), timeout=GUARD_S)
    opened.settimeout(GUARD_S)
    return opened


def until(endpoint: TcpEndpoint, so: Callable[[bytes], bool]) -> None:
    """Let the board's side look at its port until something is so; the network may take a moment."""
    give_up_s = time.monotonic() + GUARD_S
    while not so(endpoint.receive()):
        assert time.monotonic() < give_up_s, "it never came"
        time.sleep(0.0005)


def test_the_next_host_learns_which_host_has_the_board_and_waits(
    endpoint: TcpEndpoint, clock: FakeClock
) -> None:
    first = connected(endpoint)
    first.send(b"first")
    until(endpoint, lambda data: data == b"first")
    second = connected(endpoint)
    until(endpoint, lambda _: endpoint._waiting is not None)
    clock.now_s += PATIENCE_S
    first.send(b"still here")
    until(endpoint, lambda data: data == b"still here")
    until(endpoint, lambda _: endpoint._is_informed)
    host, port = first.getsockname()
    assert second.recv(200) == f"\r\nthis board is held by {host}:{port}\r\n\0".encode()
    second.send(b"second")
    first.close()
    until(endpoint, lambda data: data == b"second")
    second.close()


def test_a_silent_host_gives_way_to_one_that_waits(endpoint: TcpEndpoint, clock: FakeClock) -> None:
    silent = connected(endpoint)
    until(endpoint, lambda _: endpoint.ready)
    clock.now_s += 100.0
    endpoint.receive()
    assert endpoint.ready, "nobody waits: it may stay"
    second = connected(endpoint)
    second.send(b"second")
    until(endpoint, lambda data: data == b"second")
    assert silent.recv(10) == b""
    second.close()


def test_a_host_that_sends_keeps_the_board(endpoint: TcpEndpoint, clock: FakeClock) -> None:
    first, second = connected(endpoint), connected(endpoint)
    first.send(b"x")
    until(endpoint, lambda data: data == b"x")
    until(endpoint, lambda _: endpoint._waiting is not None)
    for number in range(10):
        clock.now_s += SILENT_S * 0.9
        first.send(b"%d" % number)
        until(endpoint, lambda data, wanted=b"%d" % number: data == wanted)  # type: ignore[misc]
    clock.now_s += SILENT_S
    second.send(b"second")
    until(endpoint, lambda data: data == b"second")
    first.close()
    second.close()


def test_a_host_that_gave_up_waiting_makes_room_for_another(endpoint: TcpEndpoint, clock: FakeClock) -> None:
    first = connected(endpoint)
    first.send(b"x")
    until(endpoint, lambda data: data == b"x")
    second = connected(endpoint)
    until(endpoint, lambda _: endpoint._waiting is not None)
    second.close()
    until(endpoint, lambda _: endpoint._waiting is None)
    third = connected(endpoint)
    third.send(b"third")
    first.close()
    until(endpoint, lambda data: data == b"third")
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


@pytest.mark.medium
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
