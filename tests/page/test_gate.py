"""The stop has a thread of its own, and what clients send is limited before it is decoded or queued."""

import contextlib
import json
import random
import socket
import time
from collections.abc import Iterator

import pytest

pytest.importorskip("starlette", reason="the extra 'page' is not installed: make setup")

from heli_host.ui.page import gate as gates
from heli_host.ui.page import gate as stops
from heli_host.ui.page import guard, serve, service
from heli_host.ui.page.guard import FrameCounter, Guard, Meter, Notes, RateLimit
from heli_host.ui.page.serve import Address, serving
from hypothesis import given, settings
from hypothesis import strategies as st
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.frames import Frame, Opcode
from websockets.sync.client import ClientConnection, connect

from tests.page.hostile_requests import status_of_request
from tests.page.page_server import PATIENCE_S, Desk

pytestmark = pytest.mark.medium


@pytest.fixture
def desk() -> Desk:
    return Desk()


@pytest.fixture
def address(desk: Desk) -> Iterator[Address]:
    with serving(desk) as served:
        yield served
        desk.status_may_return.set()
        desk.action_may_return.set()


def opened(address: Address, path: str = "/ws", **more: str) -> ClientConnection:
    query = "".join(f"&{name}={value}" for name, value in more.items())
    url = f"ws://127.0.0.1:{address.port}{path}?token={address.token}{query}"
    # A server that does not read, as it should here, does not answer a close either.
    return connect(url, compression=None, proxy=None, open_timeout=PATIENCE_S, close_timeout=0.1)


def posted_stop(address: Address) -> int:
    path = f"/stop?token={address.token}"
    return status_of_request(address, path, [("Host", f"127.0.0.1:{address.port}")], "POST")


def closed_code(client: ClientConnection) -> tuple[int | None, str | None]:
    """Code and reason with which the server ended a connection."""
    end_s = time.monotonic() + PATIENCE_S
    with pytest.raises(ConnectionClosed):
        while time.monotonic() < end_s:
            client.recv(PATIENCE_S)
    return client.close_code, client.close_reason


def block_the_loop(desk: Desk) -> None:
    """Wait until the event loop that serves all clients is inside a call that does not return."""
    desk.status_may_return.clear()
    desk.status_is_called.clear()
    assert desk.status_is_called.wait(PATIENCE_S)


def test_a_stop_needs_no_turn_of_the_loop_that_serves_clients(desk: Desk, address: Address) -> None:
    with opened(address, "/stop") as before, opened(address):
        block_the_loop(desk)
        before.send("stop")
        assert before.recv(PATIENCE_S) == "stopped"
        assert desk.stops == 1
        assert posted_stop(address) == 200
        assert desk.stops == 2
        with opened(address, "/stop") as later:
            later.send("anything")
            assert later.recv(PATIENCE_S) == "stopped"
        assert desk.stops == 3
        assert not desk.status_may_return.is_set()


def test_a_response_ends_its_connection_so_that_no_stop_follows_it_into_the_loop(address: Address) -> None:
    host = f"127.0.0.1:{address.port}"
    request = f"GET /main.js HTTP/1.1\r\nHost: {host}\r\n\r\n"
    with socket.create_connection((address.host, address.port), timeout=PATIENCE_S) as browser:
        browser.sendall(request.encode())
        received = b""
        while data := browser.recv(65536):
            received += data
    assert b"connection: close" in received.lower()


def test_what_exceeds_the_rate_is_neither_decoded_nor_queued(
    desk: Desk, address: Address, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Without refill the claim depends on no clock.
    monkeypatch.setattr(serve, "Meter", lambda: Meter(messages_per_s=0.0, message_burst=10.0))
    decoded: list[bytes] = []
    decode = WebSocketsSansIOProtocol.data_received

    def note_and_decode(protocol: WebSocketsSansIOProtocol, data: bytes) -> None:
        decoded.append(data)
        decode(protocol, data)

    monkeypatch.setattr(WebSocketsSansIOProtocol, "data_received", note_and_decode)
    with opened(address, rows="0") as client:
        request = json.dumps({"do": "count", "id": 1}).encode()
        flood = Frame(Opcode.TEXT, request).serialize(mask=True, extensions=[]) * 5000
        with contextlib.suppress(OSError):
            client.socket.sendall(flood)
        code, reason = closed_code(client)
    assert code in (guard.POLICY_VIOLATION, 1006)
    assert code == 1006 or "more than 0 messages per second" in str(reason)
    frames = sum(len(data) for data in decoded if data.startswith((b"\x81", b"\x82"))) // (len(flood) // 5000)
    assert desk.counted <= frames <= 10


def test_a_client_that_is_a_little_too_fast_reads_why_it_is_disconnected(
    address: Address, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(serve, "Meter", lambda: Meter(messages_per_s=0.0, message_burst=2.0))
    with opened(address, rows="0") as client:
        for number in range(2):
            client.send(json.dumps({"do": "count", "id": number}))
            while json.loads(client.recv(PATIENCE_S)).get("answer") != number:
                pass
        client.send("one more")
        assert closed_code(client) == (guard.POLICY_VIOLATION, "more than 0 messages per second; send fewer")


def test_requests_that_wait_are_bounded(desk: Desk, address: Address) -> None:
    from heli_host.ui.page.requests import MAX_PENDING

    desk.action_may_return.clear()
    with opened(address, rows="0") as client:
        for number in range(MAX_PENDING + 1):
            client.send(json.dumps({"do": "count", "id": number}))
        while "answer" not in (message := json.loads(client.recv(PATIENCE_S))):
            pass
        assert message["answer"] == MAX_PENDING
        assert message["error"] == "32 of your requests wait for their answers"
        desk.action_may_return.set()
        answered: set[object] = set()
        while len(answered) < MAX_PENDING:
            answered.add(json.loads(client.recv(PATIENCE_S)).get("answer", "none"))
            answered.discard("none")
    assert answered == set(range(MAX_PENDING))


def test_watchers_together_wait_unread_and_the_pilot_does_not(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(service, "RateLimit", lambda rate, burst: RateLimit(rate_per_s=1e-9, burst=1.0))
    with serving(desk) as address, opened(address, rows="0") as pilot, opened(address, rows="0") as watcher:
        watcher.send(json.dumps({"do": "count", "id": 0}))
        while json.loads(watcher.recv(PATIENCE_S)).get("answer") != 0:
            pass
        for number in range(1, 40):
            watcher.send(json.dumps({"do": "count", "id": number}))
        for number in range(3):
            pilot.send(json.dumps({"do": "count", "id": number}))
            while (message := json.loads(pilot.recv(PATIENCE_S))).get("answer") != number:
                pass
            assert "error" not in message
    # The first message of the watcher, and all of the pilot.
    assert desk.counted == 1 + 3


def test_more_clients_than_the_limit_are_refused_and_a_stop_is_not(
    desk: Desk, address: Address, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(serve, "MAX_CONNECTIONS", 3)
    with contextlib.ExitStack() as stack:
        for _ in range(3):
            stack.enter_context(opened(address))
        with pytest.raises(InvalidStatus) as refused:
            opened(address)
        assert refused.value.response.status_code == 503
        assert posted_stop(address) == 200
        with opened(address, "/stop") as stop:
            stop.send("stop")
            assert stop.recv(PATIENCE_S) == "stopped"
    assert desk.stops == 2


def test_new_connections_are_limited_in_rate_and_a_stop_is_not(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gates, "RateLimit", lambda rate, burst: RateLimit(rate_per_s=0.0, burst=2.0))
    with serving(desk) as address:
        host = [("Host", f"127.0.0.1:{address.port}")]
        assert [status_of_request(address, "/main.js", host) for _ in range(4)] == [200, 200, 503, 503]
        assert [posted_stop(address) for _ in range(4)] == [200] * 4
    assert desk.stops == 4


def test_connections_that_say_nothing_keep_nobody_out(
    desk: Desk, address: Address, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gates, "MAX_ARRIVALS", 3)
    # Not the time limit of a request ends the oldest, but the next connections.
    monkeypatch.setattr(gates, "_HEAD_S", 1e6)
    with contextlib.ExitStack() as stack:
        silent = [
            stack.enter_context(socket.create_connection((address.host, address.port), timeout=PATIENCE_S))
            for _ in range(8)
        ]
        assert posted_stop(address) == 200
        assert [connection.recv(1) for connection in silent[:5]] == [b""] * 5
    assert desk.stops == 1


def test_a_head_without_end_is_refused(address: Address) -> None:
    with socket.create_connection((address.host, address.port), timeout=PATIENCE_S) as client:
        client.sendall(b"GET /" + b"x" * 20_000)
        assert client.recv(100).startswith(b"HTTP/1.1 431 ")


def test_a_flood_on_the_stop_socket_stops_and_is_disconnected(
    desk: Desk, address: Address, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stops, "Meter", lambda rate, burst: Meter(messages_per_s=0.0, message_burst=10.0))
    with opened(address, "/stop") as client:
        with contextlib.suppress(OSError):
            client.socket.sendall(Frame(Opcode.TEXT, b"x").serialize(mask=True, extensions=[]) * 5000)
        assert closed_code(client)[0] in (guard.POLICY_VIOLATION, 1006)
    assert 1 <= desk.stops <= 11
    assert posted_stop(address) == 200


@settings(deadline=None)
@given(head=st.binary(max_size=300), is_whole=st.booleans())
def test_no_bytes_of_a_client_end_the_thread_of_the_stop(head: bytes, is_whole: bool) -> None:
    for method in (b"GET", b"POST", b"", b"\xff"):
        ours, theirs = socket.socketpair()
        with ours, theirs:
            ours.setblocking(False)
            theirs.settimeout(PATIENCE_S)
            endpoint = stops.StopEndpoint(Desk(), Guard("secret", "127.0.0.1"), Notes())
            text = method + b" /stop?token=" + head + (b"\r\n\r\n" if is_whole else b"")
            opened_socket = endpoint.open(ours, text)
            assert opened_socket is None
            assert theirs.recv(65536)[:9] in (b"HTTP/1.1 ", b"")


@given(
    sizes=st.lists(st.sampled_from([0, 1, 5, 125, 126, 127, 1000, 65535, 65536, 70000]), max_size=8),
    masked=st.booleans(),
    seed=st.integers(0, 99),
)
def test_frames_are_counted_as_a_decoder_finds_them(sizes: list[int], masked: bool, seed: int) -> None:
    chance = random.Random(seed)
    stream = b"".join(Frame(Opcode.TEXT, bytes(size)).serialize(mask=masked, extensions=[]) for size in sizes)
    counter, counted, at = FrameCounter(), 0, 0
    while at < len(stream):
        size = chance.choice((1, 2, 3, 7, 1000, 100_000))
        counted += counter.count(stream[at : at + size], 1000.0)
        at += size
    assert counted == len(sizes)


def test_an_allowance_refills_with_time_up_to_its_maximum() -> None:
    now_s = [0.0]
    limit = RateLimit(rate_per_s=10.0, burst=5.0, clock=lambda: now_s[0])
    assert [limit.take() for _ in range(6)] == [True] * 5 + [False]
    assert limit.wait_s() == pytest.approx(0.1)
    now_s[0] = 0.1
    assert limit.take() and not limit.take()
    now_s[0] = 100.0
    assert [limit.take() for _ in range(6)] == [True] * 5 + [False]


def test_bytes_are_limited_even_in_a_single_endless_frame() -> None:
    meter = Meter(clock=lambda: 0.0)
    assert meter.excess(b"\x81\xff" + (10**9).to_bytes(8) + bytes(100_000)) == ""
    assert meter.excess(bytes(100_000)) == ""
    assert meter.excess(bytes(100_000)) == "more than 128 KiB per second; send less"
