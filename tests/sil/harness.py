"""A host that speaks to a simulated board in frames, on simulated time."""

from __future__ import annotations

from typing import Any

from heli_host.declaration import (
    LINK_HASH,
    AckMessage,
    ArmMessage,
    ControlMessage,
    HelloMessage,
    MessageId,
    Param,
    ParamSetMessage,
    Result,
    WelcomeMessage,
)
from heli_host.link.frames import Frame, FrameParser, encode_frame
from heli_sim.sil.options import SilOptions, parse_options
from heli_sim.sil.world import SilWorld


def world(**options: str) -> SilWorld:
    return SilWorld(parse_options(options))


def hello_frame(seq: int = 0) -> bytes:
    return encode_frame(MessageId.HELLO, seq, HelloMessage(1, LINK_HASH, 77).pack())


class Host:
    """Frames to and from one world; time passes in `wait` and while an answer is awaited."""

    def __init__(self, world: SilWorld | None = None) -> None:
        self.world = world if world is not None else SilWorld(SilOptions())
        self.frames: list[Frame] = []
        self._parser = FrameParser()
        self._seq = 0
        self._request = 0

    @property
    def frames_bad(self) -> int:
        return self._parser.frames_bad

    def wait(self, ticks: int, data: bytes = b"") -> list[Frame]:
        new = self._parser.feed(self.world.advance(ticks, data))
        self.frames += new
        return new

    def ask(self, kind: Any, *fields: float) -> Any:
        """Send a command; the payload of its reply."""
        self._request = self._request % 255 + 1
        message = kind(self._request, *fields)
        data = encode_frame(kind.ID, self._seq, message.pack())
        self._seq = (self._seq + 1) % 256
        for _ in range(100):
            for frame in self.wait(1, data):
                if frame.id == kind.REPLY and frame.payload[0] == self._request:
                    return frame.payload
            data = b""
        raise AssertionError(f"no answer to {kind.__name__}")

    def hello(self) -> WelcomeMessage:
        welcome = WelcomeMessage.unpack(self.ask(HelloMessage, LINK_HASH, 77))
        assert welcome.result == Result.OK
        return welcome

    def order(self, kind: Any, *fields: float) -> AckMessage:
        return AckMessage.unpack(self.ask(kind, *fields))

    def drive(self, front_V: float, back_V: float) -> None:
        """Hand the motors open-loop voltages; the rig is held until they have built up, then let go."""
        self.hello()
        assert self.order(ParamSetMessage, Param.BUMPLESS_S, 0.02).result == Result.OK
        self.world.native.locked = [True] * 3
        assert self.order(ArmMessage).result == Result.OK
        assert self.order(ControlMessage, 0, front_V, back_V).result == Result.OK
        self.wait(300)
        self.world.native.locked = [False] * 3
