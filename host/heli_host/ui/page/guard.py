"""The limits of clients: which connections the page's server accepts, and how much each client may send.

The limits are counted in the received bytes, before a message is decoded or queued.
"""

from __future__ import annotations

import logging
import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final
from urllib.parse import SplitResult, urlsplit

from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse, Response
from starlette.websockets import WebSocket

from heli_host.errors import printable

LOCAL_HOSTS = frozenset(("127.0.0.1", "localhost", "::1"))
POLICY_VIOLATION: Final = 1008
"""Code with which a WebSocket is closed whose client may not send what it sent."""
MESSAGES_PER_S: Final = 100.0
"""Messages that a client may send per second, all kinds together [1/s].

A page sends 30 per second: 20 acknowledgements of frames and 10 signs of life; a stick or slider adds 20.
Below that, a page would be disconnected. Above 300, sixty clients keep the server's thread busy."""
_MESSAGE_BURST: Final = 100.0
"""Messages that a client may send together after a pause."""
_BYTES_PER_S: Final = 131_072.0
"""Bytes that a client may send per second [B/s]: 32 requests of the greatest length."""
_BYTE_BURST: Final = 262_144.0
"""Bytes that a client may send together after a pause [B]. It must exceed the greatest WebSocket message,
65,536 bytes, because a single message must never exceed the limit."""
WATCHERS_PER_S: Final = 200.0
"""Requests per second that are read from all clients but the pilot together [1/s]. The others wait in the
sockets of their clients.

Each ``signal`` goes to every client: with sixty clients it becomes sixty messages. Lower: the programs of a
class wait, with signals at 10 Hz. Higher: the server is too busy to hear the pilot's signs of life."""

_LONGEST_PATH = 200
_MAX_CAUSES = 200
"""Greatest number of different lines: a client with endless invalid requests must not fill a disk."""


class RateLimit:
    """An allowance that refills at a constant rate, up to a maximum (token bucket)."""

    def __init__(self, rate_per_s: float, burst: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._rate_per_s, self._burst, self._clock = rate_per_s, burst, clock
        self._allowance, self._refilled_s = burst, clock()

    def take(self, amount: float = 1.0) -> bool:
        """Use a part of the allowance; False if less is available, and then nothing is used."""
        if amount > self.available():
            return False
        self._allowance -= amount
        return True

    def available(self) -> float:
        """Return the present allowance."""
        now_s = self._clock()
        self._allowance += (now_s - self._refilled_s) * self._rate_per_s
        self._allowance, self._refilled_s = min(self._allowance, self._burst), now_s
        return self._allowance

    def wait_s(self) -> float:
        """Return how long it takes until one more may be used [s]; 0 if it may be used now."""
        return max((1.0 - self.available()) / self._rate_per_s, 0.0)


class FrameCounter:
    """Counts the WebSocket frames in a stream of bytes by their headers (RFC 6455), without decoding them."""

    def __init__(self) -> None:
        self._payload_left = 0
        self._head = b""

    def count(self, data: bytes, most: float) -> int:
        """Return how many frames begin in the next bytes of the stream. Counting ends with the first frame
        above `most`; the stream must not be used afterwards.
        """
        data = self._head + data
        frame_begin, frames = self._payload_left, 0
        while frames <= most and (length := _frame_length(data, frame_begin)) is not None:
            frame_begin += length
            frames += 1
        self._payload_left, self._head = max(frame_begin - len(data), 0), data[frame_begin:]
        return frames


def _frame_length(data: bytes, begin: int) -> int | None:
    """Return the bytes of the WebSocket frame at `begin`; None if the length in its header is incomplete."""
    # RFC 6455, 5.2: The second byte is a mask bit and a length. A length of 126 or 127 means that the length
    # follows in 2 or 8 bytes. A mask of 4 bytes follows the length.
    length_begin = begin + 2
    if length_begin > len(data):
        return None
    is_masked, payload_length = data[begin + 1] & 0x80, data[begin + 1] & 0x7F
    length_end = length_begin + {126: 2, 127: 8}.get(payload_length, 0)
    if length_end > len(data):
        return None
    if length_end > length_begin:
        payload_length = int.from_bytes(data[length_begin:length_end])
    return length_end - begin + (4 if is_masked else 0) + payload_length


class Meter:
    """Measures what one client sends over its WebSocket."""

    def __init__(
        self,
        messages_per_s: float = MESSAGES_PER_S,
        message_burst: float = _MESSAGE_BURST,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._frames = FrameCounter()
        self._messages = RateLimit(messages_per_s, message_burst, clock)
        self._bytes = RateLimit(_BYTES_PER_S, _BYTE_BURST, clock)
        self._messages_per_s = messages_per_s

    def excess(self, data: bytes) -> str:
        """Return why a client that sends `data` next must be disconnected; empty if it stays within
        limits.
        """
        if not self._bytes.take(len(data)):
            return f"more than {_BYTES_PER_S / 1024:g} KiB per second; send less"
        if not self._messages.take(self._frames.count(data, self._messages.available())):
            return f"more than {self._messages_per_s:g} messages per second; send fewer"
        return ""


class Notes:
    """The server's log."""

    def __init__(self) -> None:
        self._log = logging.getLogger("heli_host.ui.page")
        self._seen: set[str] = set()

    def warn(self, cause: str) -> None:
        """Write one line, unless the same line was written before."""
        line = printable(" ".join(cause.split()))
        if line in self._seen or len(self._seen) > _MAX_CAUSES:
            return
        self._seen.add(line)
        more = "; further lines are left out" if len(self._seen) > _MAX_CAUSES else ""
        self._log.warning("page: %s%s", line, more)


@dataclass(frozen=True)
class Guard:
    """Decides which connections the server accepts."""

    token: str  # Secret that each address must carry. Without it a client sees nothing and commands nothing.
    host: str
    """Address that the server is bound to. If it is local, only requests for a local name are served: this
    refuses a foreign page whose host name resolves to this machine (DNS rebinding)."""
    notes: Notes = field(default_factory=Notes)  # Log for malformed headers

    def refusal(self, connection: HTTPConnection, *, needs_token: bool = True) -> Response | None:
        """Return the error response for a connection that must be refused, otherwise None."""
        if needs_token and not self._has_token(connection):
            message = "open the whole address that heli-host dashboard printed: it carries a token\n"
            return PlainTextResponse(message, 403)
        if (length := len(connection.scope["path"])) > _LONGEST_PATH:
            self._warn(connection, f"its path has {length} characters")
            return PlainTextResponse("the path is too long\n", 414)
        host = connection.headers.get("host", "")
        address = _parse_host(host)
        if address is None:
            self._warn(connection, f"its Host header is {host[:100]!r}")
            return PlainTextResponse("the Host header is not an address\n", 400)
        if self.host in LOCAL_HOSTS and (address.hostname or "") not in LOCAL_HOSTS:
            return PlainTextResponse(f"this page is served as {self.host} only\n", 421)
        origin = connection.headers.get("origin")
        # Programs send no Origin header; browsers send it whenever a page of another origin asks.
        if origin is not None and not self._is_same_origin(connection, origin, host):
            return PlainTextResponse("a page of another origin may not ask this\n", 403)
        return None

    def _has_token(self, connection: HTTPConnection) -> bool:
        """Whether a connection has the token; the duration of the comparison does not reveal the token."""
        received = connection.query_params.get("token", "")
        return secrets.compare_digest(received.encode(), self.token.encode())

    def _is_same_origin(self, connection: HTTPConnection, origin: str, host: str) -> bool:
        """Whether the page at `origin` comes from this server, which the client called `host`."""
        try:
            return urlsplit(origin).netloc.lower() == host.lower()
        except ValueError:
            self._warn(connection, f"its Origin header is {origin[:100]!r}")
            return False

    def _warn(self, connection: HTTPConnection, cause: str) -> None:
        client = connection.client.host if connection.client is not None else "a client"
        self.notes.warn(f"a request of {client} is refused: {cause}")

    async def admit(self, socket: WebSocket) -> bool:
        """Accept a WebSocket, or close it with the code of a policy violation."""
        if self.refusal(socket) is not None:
            await socket.close(POLICY_VIOLATION)
            return False
        await socket.accept()
        return True


def _parse_host(host: str) -> SplitResult | None:
    """Parse a Host header; None if it is not an address, such as ``[``."""
    try:
        return urlsplit(f"//{host}")
    except ValueError:
        return None


def new_token() -> str:
    """Return a random token of 128 bits."""
    return secrets.token_urlsafe(16)
