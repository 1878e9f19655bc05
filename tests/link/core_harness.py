"""The board's end of the link by itself: Python plays both the host and the control tick."""

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from heli_host import declaration
from heli_host import declaration as d
from heli_host.link.frames import Frame, FrameParser, encode_frame
from heli_test_native import link as core_link

# Numbers of the Due.
DUTY_FULL = 2100
PAGE_BYTES = 512

# The generated classes of all messages that the host sends; of these the streams and the commands.
TO_BOARD: list[Any] = [
    cls
    for cls in vars(declaration).values()
    if isinstance(cls, type) and getattr(cls, "ID", d.MessageId.ACK) < d.MessageId.ACK
]
STREAMS = [
    cls for cls in TO_BOARD if cls.ID in (d.MessageId.SETPOINT, d.MessageId.VOLTAGES, d.MessageId.FOLLOWING)
]
COMMANDS = [cls for cls in TO_BOARD if cls not in STREAMS]

Execute = Callable[[int, bytes], tuple[int, int, float]]


class Message(Protocol):
    """Interface that the generated message classes share."""

    @property
    def ID(self) -> d.MessageId: ...
    def pack(self) -> bytes: ...


def always_ok(_message_id: int, _payload: bytes) -> tuple[int, int, float]:
    return int(d.Result.OK), 0, 0.0


class Harness:
    """One board, its host and its tick; `turn` lets a millisecond pass."""

    def __init__(self, execute: Execute = always_ok) -> None:
        self.native = core_link.Harness(DUTY_FULL, PAGE_BYTES)
        self.execute = execute
        self.tick = 0
        self.room = 4096  # bytes that the transmitter takes in a millisecond
        self.executed: list[tuple[int, bytes]] = []
        self.streamed: list[tuple[int, bytes]] = []
        self._seq = 0
        self._parser = FrameParser()

    def frame(self, message: Message) -> bytes:
        return self.raw_frame(message.ID, message.pack())

    def raw_frame(self, message_id: int, payload: bytes) -> bytes:
        self._seq += 1
        return encode_frame(message_id, self._seq - 1, payload)

    def turn(self, received: bytes = b"", ticks: int = 1) -> list[Frame]:
        """Give the board these bytes, then let tick and idle loop run; what the board sent meanwhile."""
        self.native.receive(received)
        frames: list[Frame] = []
        for _ in range(ticks):
            self.run_tick()
            self.native.room = self.room
            self.native.poll()
            frames += self._parser.feed(self.native.sent())
        return frames

    def run_tick(self) -> None:
        self.native.begin_tick(self.tick)
        request = self.native.take_request()
        if request is not None:
            self.executed.append(request)
            self.native.answer(*self.execute(*request))
        while (value := self.native.take_stream()) is not None:
            self.streamed.append(value)
        self.tick += 1

    def hello(self, session: int = 1, link_hash: int = d.LINK_HASH, request: int = 200) -> d.WelcomeMessage:
        frames = self.turn(self.frame(d.HelloMessage(request, link_hash, session)))
        (welcome,) = [f for f in frames if f.id == d.MessageId.WELCOME]
        return d.WelcomeMessage.unpack(welcome.payload)

    def ask(self, message: Message) -> list[Frame]:
        """Send a command and let three milliseconds pass: enough for the tick to answer."""
        return self.turn(self.frame(message), ticks=3)

    def status(self) -> d.StatusMessage:
        request = 250
        frames = self.ask(d.StatusReadMessage(request))
        (answer,) = [f for f in frames if f.id == d.MessageId.STATUS and f.payload[0] == request]
        return d.StatusMessage.unpack(answer.payload)


def named(value: object) -> str | None:
    """Test ids of message classes."""
    return value.ID.name.lower() if isinstance(value, type) and hasattr(value, "ID") else None


def open_harness(execute: Execute = always_ok, session: int = 1) -> Harness:
    """One on which the handshake has been made."""
    harness = Harness(execute)
    assert harness.hello(session).result == d.Result.OK
    return harness


def payloads_of(frames: list[Frame], message_id: d.MessageId) -> list[bytes]:
    """Payloads of the frames with this id."""
    return [frame.payload for frame in frames if frame.id == message_id]


def acks_in(frames: list[Frame]) -> list[d.AckMessage]:
    return [d.AckMessage.unpack(payload) for payload in payloads_of(frames, d.MessageId.ACK)]


def slowly_changing_samples(count: int) -> np.ndarray:
    """Samples whose channels all move a little, shape (count, channels)."""
    return np.repeat(np.arange(count, dtype=np.int32)[:, None] % 7, len(d.Channel), axis=1)
