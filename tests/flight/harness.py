"""The flight code with encoders, clock and serial line in the test's hands."""

import math
from typing import Any, NamedTuple

from heli_host import declaration as d
from heli_host.link.frames import Frame, FrameParser, encode_frame
from heli_host.link.telemetry import TelemetryDecoder, Ticks
from heli_test_native import flight

ELEVATION, PITCH, TRAVEL = d.Axis
ALL_AXES, NO_AXES = d.Axes.ELEVATION | d.Axes.PITCH | d.Axes.TRAVEL, d.Axes(0)
WITHOUT_TRAVEL = d.Axes.ELEVATION | d.Axes.PITCH
REST_DEG = -25.0
DUTY_FULL = 2100
"""Full duty of the Due, in counts."""
PAGE_BYTES = 512
TRACKING = ("_following_max_deg", "_motion_V", "_motion_deg")
"""Ends of the names of the parameters that decide whether an axis does what it is driven to do."""


class Motors(NamedTuple):
    """Duties of both motors and state of their drivers."""

    front_duty: int
    back_duty: int
    are_enabled: bool


class Harness:
    """A board that has just been powered with the arm on the table."""

    def __init__(
        self,
        session: bool = True,
        law: flight.ToldLaw | None = None,
        other: flight.ToldLaw | None = None,
        duty_full: int = DUTY_FULL,
        page_bytes: int = PAGE_BYTES,
        tracked: bool = False,
    ) -> None:
        self.core = flight.Harness(law, other, duty_full, page_bytes)
        self.parser = FrameParser()
        self.sequence = 0
        self.request = 0
        self.events: list[d.EventMessage] = []
        self.frames: list[Frame] = []
        self.illegal = [0, 0, 0]
        self.angles_deg = [REST_DEG, 0.0, 0.0]
        self.core.tick(300)
        if session:
            self.ask(d.HelloMessage(request=0, link_hash=d.LINK_HASH, session=7))
        if session and not tracked:
            for spec in d.PARAMS:
                if spec.name.endswith(TRACKING):
                    self.set(spec.name, spec.max)

    def send(self, message: Any) -> None:
        self.core.receive(encode_frame(message.ID, self.sequence, message.pack()))
        self.sequence += 1

    def tick(self, count: int = 1, late: bool = False) -> None:
        self.core.tick(count, late)
        for frame in self.parser.feed(self.core.sent()):
            self.frames.append(frame)
            if frame.id == d.MessageId.EVENT:
                self.events.append(d.EventMessage.unpack(frame.payload))

    def ask(self, message: Any) -> Any:
        """Send a command with the next request number and return its reply."""
        self.request = self.request % 255 + 1
        fields = {name: getattr(message, name) for name in message.__slots__}
        self.send(type(message)(**(fields | {"request": self.request})))
        for _ in range(50):
            before = len(self.frames)
            self.tick(1)
            for frame in self.frames[before:]:
                if frame.id == message.REPLY and frame.payload[0] == self.request:
                    types: dict[int, Any] = {
                        d.MessageId.ACK: d.AckMessage,
                        d.MessageId.WELCOME: d.WelcomeMessage,
                        d.MessageId.PONG: d.PongMessage,
                        d.MessageId.STATUS: d.StatusMessage,
                        d.MessageId.PARAMS: d.ParamsMessage,
                        d.MessageId.CONTROLLER: d.ControllerMessage,
                    }
                    return types[frame.id].unpack(frame.payload)
        raise AssertionError(f"no reply to {message}")

    def move(
        self,
        elevation_deg: float | None = None,
        pitch_deg: float | None = None,
        travel_deg: float | None = None,
    ) -> None:
        """Turn the encoders so that the board reads these angles."""
        for axis, value in enumerate((elevation_deg, pitch_deg, travel_deg)):
            if value is not None:
                self.angles_deg[axis] = value
        self._encoders()

    def glide(self, axis: int, to_deg: float, deg_s: float) -> None:
        """Move one axis at a constant rate, ticking as it goes."""
        step = math.copysign(deg_s / 1000, to_deg - self.angles_deg[axis])
        for _ in range(round((to_deg - self.angles_deg[axis]) / step)):
            self.angles_deg[axis] += step
            self._encoders()
            self.tick()

    def _encoders(self) -> None:
        offsets = (REST_DEG, 0.0, 0.0)
        counts = [round((a - o) / 360 * 4096) for a, o in zip(self.angles_deg, offsets, strict=True)]
        self.core.encoders(counts, self.illegal)

    def break_encoder(self, axis: int, transitions: int) -> None:
        self.illegal[axis] = (self.illegal[axis] + transitions) & 0xFFFF_FFFF
        self._encoders()

    def set(self, name: str, value: float) -> Any:
        index = next(p.index for p in d.PARAMS if p.name == name)
        return self.ask(d.ParamSetMessage(0, index, value))

    def arm(self) -> Any:
        return self.ask(d.ArmMessage(0))

    def close_loops(self, axes: int = ALL_AXES) -> Any:
        return self.ask(d.ControlMessage(request=0, axes=axes, front_V=0.0, back_V=0.0))

    def fly(self) -> None:
        assert self.arm().result == d.Result.OK
        assert self.close_loops().result == d.Result.OK

    def setpoint(
        self, elevation_deg: float = 0.0, pitch_deg: float = 0.0, travel_deg: float = 0.0, at_tick: int = 0
    ) -> None:
        angles = (math.radians(x) for x in (elevation_deg, pitch_deg, travel_deg))
        self.send(d.SetpointMessage(at_tick, *angles))

    def keep_flying(self, ticks: int, **setpoint: Any) -> None:
        for k in range(ticks):
            if k % 20 == 0:
                self.setpoint(**setpoint)
            self.tick()

    def ping(self) -> None:
        self.ask(d.PingMessage(0, 0))

    def telemetry(self) -> Ticks:
        """All samples that the board has sent."""
        return TelemetryDecoder().decode([f.payload for f in self.frames if f.id == d.MessageId.TELEMETRY])

    @property
    def state(self) -> d.State:
        return d.State(self.core.state)

    @property
    def motors(self) -> Motors:
        return Motors(*self.core.motors())

    @property
    def motors_off(self) -> bool:
        return self.motors == (0, 0, False)

    def last_event(self, kind: d.Event) -> d.EventMessage:
        return [e for e in self.events if e.kind == kind][-1]
