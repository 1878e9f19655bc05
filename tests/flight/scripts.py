"""Scripts for a whole board: an arm that moves, a host that commands, and what both do wrong.

A script is a function of its seed alone. Its arm needs no library of functions: on every machine it gives the
same numbers.
"""

import random
import struct
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from heli_host import declaration as d
from heli_host.board.law_flight import PART_WORDS
from heli_host.link.frames import Frame, FrameParser, encode_frame
from heli_test_native import flight

from tests.flight.harness import ALL_AXES

DEFAULT: Final = {spec.name: spec.default for spec in d.PARAMS}
INDEX: Final = {spec.name: spec.index for spec in d.PARAMS}
WINDOW_ms: Final = 500
"""Time of one fingerprint: short enough to show where a flight first differs."""
RAD: Final = 3.14159265358979 / 180.0
REST_DEG: Final = -25.0
COUNTS_PER_REV: Final = 4096
SUPPLY_DUTY: Final = 2100
"""Duty of the Due at `supply_V`, in counts."""
PAGE_BYTES: Final = 512

ELEVATION, PITCH, TRAVEL = range(3)

Words = Sequence[int]
Laws = dict[str, tuple[Words, int]]
"""Words and checksum of a law, by name."""


@dataclass
class Arm:
    """The rig as the board's default parameters describe it, with dry friction and gusts."""

    chance: random.Random  # Decides on the gusts
    friction_rad_s2: float = 0.0  # Acceleration of travel that dry friction takes up [rad/s2]
    gust_rad_s2: float = 0.0  # Range of the disturbing acceleration of all axes [rad/s2]
    pitch_gust_rad_s2: float = 0.0  # The same for pitch; 0: as of the other axes [rad/s2]
    gain: float = 1.0  # Acceleration of elevation and pitch, as a multiple of what the parameters say
    angle: list[float] = field(init=False, default_factory=lambda: [REST_DEG * RAD, 0.0, 0.0])
    rate: list[float] = field(init=False, default_factory=lambda: [0.0, 0.0, 0.0])
    lift_V: list[float] = field(init=False, default_factory=lambda: [0.0, 0.0])
    gust: list[float] = field(init=False, default_factory=lambda: [0.0, 0.0, 0.0])

    def step(self, front_V: float, back_V: float) -> None:
        """One millisecond."""
        for k, volts_V in enumerate((front_V, back_V)):
            lift_V = max(0.0, abs(volts_V) - DEFAULT["dead_zone_V"]) * (1.0 if volts_V > 0.0 else -1.0)
            self.lift_V[k] += (lift_V - self.lift_V[k]) * 0.02
        front_lift_V, back_lift_V = self.lift_V
        total_V, difference_V = front_lift_V + back_lift_V, front_lift_V - back_lift_V
        # A new gust about each half second.
        if self.chance.random() < 0.002:
            sizes = (self.gust_rad_s2, self.pitch_gust_rad_s2 or self.gust_rad_s2, self.gust_rad_s2)
            self.gust = [size * (self.chance.random() - 0.5) for size in sizes]
        elevation, pitch, _ = self.angle
        needed_V = max(0.4, DEFAULT["hover_V"] + DEFAULT["hover_slope"] * elevation / RAD)
        pull = [
            self.gain * DEFAULT["elevation_gain"] * (total_V - needed_V) - 0.3 * self.rate[ELEVATION],
            self.gain * DEFAULT["pitch_gain"] * (difference_V - DEFAULT["pitch_hold_ff"] * pitch / RAD)
            - 0.8 * self.rate[PITCH],
            DEFAULT["travel_gain"] * pitch * total_V / DEFAULT["hover_V"] - 0.2 * self.rate[TRAVEL],
        ]
        for axis in range(3):
            self.rate[axis] += 0.001 * (pull[axis] + self.gust[axis])
        brake = 0.001 * self.friction_rad_s2
        travel_rate = self.rate[TRAVEL]
        self.rate[TRAVEL] = max(0.0, travel_rate - brake) + min(0.0, travel_rate + brake)
        for axis in range(3):
            self.angle[axis] += 0.001 * self.rate[axis]
        if self.angle[ELEVATION] <= REST_DEG * RAD:
            # On the table: no lower, level within a second, and travel brakes.
            self.angle[ELEVATION], self.rate[ELEVATION] = REST_DEG * RAD, max(0.0, self.rate[ELEVATION])
            self.angle[PITCH], self.rate[PITCH] = 0.99 * self.angle[PITCH], 0.0
            self.rate[TRAVEL] *= 0.9


class Notes:
    """Fingerprints in the order in which they come."""

    def __init__(self, chance: random.Random, expected: list[str] | None = None) -> None:
        self.chance = chance
        self.expected = expected
        self.windows: list[str] = []
        self.events: list[str] = []

    def note(self, window: str) -> None:
        """Note a fingerprint."""
        number = len(self.windows)
        self.windows.append(window)
        if self.expected is not None:
            assert self.expected[number : number + 1] == [window], (
                f"part {number} differs; {self.events[-3:]}"
            )

    def add(self, label: str, data: bytes) -> None:
        """Note the fingerprint of bytes."""
        self.note(f"{label} {zlib.crc32(data):08x}")


class Board(Notes):
    """The flight code with an arm, and the fingerprint of all that it does."""

    def __init__(self, chance: random.Random, expected: list[str] | None, arm: Arm) -> None:
        super().__init__(chance, expected)
        self.arm = arm
        self.core = flight.Harness(None, None, SUPPLY_DUTY, PAGE_BYTES)
        self.parser = FrameParser()
        self.sequence = self.request = self.now_ms = 0
        self.is_late = False  # Whether ticks come late
        self.frozen: dict[int, int] = {}  # Counts of the encoders that do not count any more, by axis
        self.illegal = [0, 0, 0]  # Illegal transitions of the encoders
        self.shift = [0, 0, 0]  # Counts by which each encoder reads too high
        self._crc = 0
        self.core.encoders([0, 0, 0], self.illegal)
        self.core.tick(20)  # The board starts before the host speaks.
        self.send(d.HelloMessage(request=1, link_hash=d.LINK_HASH, session=7))
        self.core.tick(5)
        # The welcome contains versions, which change with each release: of what is sent here, events count.
        for frame in self.parser.feed(self.core.sent()):
            self._note(frame)

    def send(self, message: Any) -> None:
        """A message of the host, as it is."""
        self.raw(encode_frame(message.ID, self.sequence & 0xFF, message.pack()))
        self.sequence += 1

    def raw(self, data: bytes) -> None:
        """Bytes on the line."""
        self.core.receive(data)

    def ask(self, kind: Any, /, *fields: Any, **named: Any) -> None:
        """A command with the next request number; its answer counts in the fingerprint."""
        self.request = self.request % 255 + 1
        self.send(kind(self.request, *fields, **named))
        self.run(3)

    def set(self, **values: float) -> None:
        """Set parameters."""
        for name, value in values.items():
            self.ask(d.ParamSetMessage, INDEX[name], value)

    def point(self, elevation_deg: float, pitch_deg: float, travel_deg: float, ahead_ms: int = 0) -> None:
        """A setpoint, which the board reaches `ahead_ms` from now."""
        at_tick = (self.now_ms + 25 + ahead_ms) & 0xFFFF_FFFF
        self.send(d.SetpointMessage(at_tick, elevation_deg * RAD, pitch_deg * RAD, travel_deg * RAD))

    def upload(self, words: Words, crc: int) -> None:
        """Send a law, part by part."""
        self.ask(d.LawBeginMessage, crc, len(words))
        for first in range(0, len(words), PART_WORDS):
            part = [*words[first : first + PART_WORDS], *([0] * PART_WORDS)][:PART_WORDS]
            self.ask(d.LawPartMessage, first, *part)
        self.ask(d.LawEndMessage)
        self.ask(d.LawReadMessage)

    def run(self, ticks: int) -> None:
        """Let time pass."""
        volts = DEFAULT["supply_V"] / SUPPLY_DUTY
        for _ in range(ticks):
            front, back, enabled = self.core.motors()
            self.arm.step(front * volts, back * volts)
            counts = [
                self.frozen.get(axis, count) + self.shift[axis] for axis, count in enumerate(self._counts())
            ]
            self.core.encoders(counts, self.illegal)
            self.core.tick(1, self.is_late)
            self.now_ms += 1
            sent = self.core.sent()
            self._crc = zlib.crc32(struct.pack("<hhB", front, back, enabled) + sent, self._crc)
            for frame in self.parser.feed(sent):
                self._note(frame)
            if self.now_ms % WINDOW_ms == 0:
                state = d.State(self.core.state).name.lower()
                self.note(f"{self._crc:08x} {state} {front} {back}")

    def put_back(self) -> None:
        """Put the arm on the table, with encoders that count, and clear what has happened."""
        self.ask(d.StopMessage)
        self.frozen.clear()
        self.arm.angle, self.arm.rate = [REST_DEG * RAD, 0.0, 0.0], [0.0, 0.0, 0.0]
        self.arm.lift_V = [0.0, 0.0]
        self.run(700)
        self.ask(d.ClearFaultMessage)

    def finish(self) -> None:
        """Note what the last part of a window has brought."""
        self.note(f"{self._crc:08x}")

    def freeze(self, axis: int) -> None:
        """An encoder stops counting."""
        self.frozen[axis] = self._counts()[axis]

    def _counts(self) -> list[int]:
        zero = (REST_DEG * RAD, 0.0, 0.0)
        return [
            round((self.arm.angle[axis] - zero[axis]) / (360.0 * RAD) * COUNTS_PER_REV) for axis in range(3)
        ]

    def _note(self, frame: Frame) -> None:
        if frame.id == d.MessageId.EVENT:
            event = d.EventMessage.unpack(frame.payload)
            kind = d.Event(event.kind).name.lower()
            self.events.append(f"{event.tick} {kind} {event.detail} {event.cause} {event.value:.4g}")


LEVEL_DEG = (0.0, 0.0, 0.0)
"""Setpoints of elevation, pitch and travel."""


def take_off(board: Board, elevation_deg: float = 0.0, seconds: float = 3.0) -> None:
    """Arm, close the loops, rise."""
    board.ask(d.ArmMessage)
    board.ask(d.ControlMessage, axes=ALL_AXES, front_V=0.0, back_V=0.0)
    hover(board, seconds, (elevation_deg, 0.0, 0.0))


def hover(board: Board, seconds: float, target_deg: tuple[float, float, float], ahead_ms: int = 0) -> None:
    """Send the same setpoint each 20 ms."""
    for _ in range(round(50 * seconds)):
        board.point(*target_deg, ahead_ms)
        board.run(20)


def wander(board: Board, seconds: float, span_deg: Sequence[float] = (12.0, 5.0, 50.0)) -> None:
    """A new target each second, partly ahead of time and partly late."""
    for _ in range(round(seconds)):
        target = [span * (2.0 * board.chance.random() - 1.0) for span in span_deg]
        hover(board, 1.0, (target[0], target[1], target[2]), board.chance.choice((0, 0, 7, 20, 31, -5)))


def land(board: Board, ticks: int = 6000) -> None:
    """Land, and look until some time after touchdown."""
    board.ask(d.LandMessage)
    board.run(ticks)
    board.ask(d.StatusReadMessage)


def values_at_edges(spec: d.ParamSpec) -> Iterator[float]:
    """Values of a parameter that matter: its ends, its default, just beyond."""
    step = 2.0**-20 * max(1.0, abs(spec.max))
    yield from (spec.min, spec.max, spec.default, spec.min - step, spec.max + step, 0.0)
    yield 0.5 * (spec.min + spec.max)
    yield 0.9 * spec.default + 0.1 * spec.max
