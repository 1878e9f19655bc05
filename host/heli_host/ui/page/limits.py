"""How much a client may send: counted in the received bytes, before a message is decoded or queued."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

POLICY_VIOLATION: Final = 1008
"""Code with which a WebSocket is closed whose client may not send what it sent."""
MESSAGES_PER_S: Final = 100.0
"""Messages that a client may send per second, all kinds together [1/s].

A page sends 30 per second: 20 acknowledgements of frames and 10 signs of life; a stick or slider adds 20.
Below that, a page would be disconnected. Above 300, sixty clients keep the server's thread busy."""
MESSAGE_BURST: Final = 100.0
"""Messages that a client may send together after a pause."""
BYTES_PER_S: Final = 131_072.0
"""Bytes that a client may send per second [B/s]: 32 requests of the greatest length."""
BYTE_BURST: Final = 262_144.0
"""Bytes that a client may send together after a pause [B]. It must exceed the greatest WebSocket message,
65,536 bytes, because a single message must never exceed the limit."""
WATCHERS_PER_S: Final = 200.0
"""Requests per second that are read from all clients but the pilot together [1/s]. The others wait in the
sockets of their clients.

Each ``signal`` goes to every client: with sixty clients it becomes sixty messages. Lower: the programs of a
class wait, with signals at 10 Hz. Higher: the server is too busy to hear the pilot's signs of life."""


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
        """Return how many frames begin in the next bytes of the stream.

        `most`: Counting ends with the first frame above this number; the stream must not be used afterwards.
        """
        data = self._head + data
        at, frames = self._payload_left, 0
        while at + 2 <= len(data) and frames <= most:
            short = data[at + 1] & 0x7F
            extended = {126: 2, 127: 8}.get(short, 0)
            if at + 2 + extended > len(data):
                break
            length = int.from_bytes(data[at + 2 : at + 2 + extended]) if extended else short
            mask = 4 if data[at + 1] & 0x80 else 0
            at += 2 + extended + mask + length
            frames += 1
        self._payload_left, self._head = max(at - len(data), 0), data[at:]
        return frames


class Meter:
    """Measures what one client sends over its WebSocket."""

    def __init__(
        self,
        messages_per_s: float = MESSAGES_PER_S,
        message_burst: float = MESSAGE_BURST,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._frames = FrameCounter()
        self._messages = RateLimit(messages_per_s, message_burst, clock)
        self._bytes = RateLimit(BYTES_PER_S, BYTE_BURST, clock)
        self._messages_per_s = messages_per_s

    def excess(self, data: bytes) -> str:
        """Return why a client that sends `data` next must be disconnected; empty if it stays within
        limits.
        """
        if not self._bytes.take(len(data)):
            return f"more than {BYTES_PER_S / 1024:g} KiB per second; send less"
        if not self._messages.take(self._frames.count(data, self._messages.available())):
            return f"more than {self._messages_per_s:g} messages per second; send fewer"
        return ""
