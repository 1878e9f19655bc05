"""Faults of the link and of the rig, and the intervals of simulated time in which they act."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, Protocol

import numpy as np
from heli_host.declaration import AXES

from heli_sim import _native
from heli_sim.errors import OptionError

NEVER: Final = 1 << 62
"""A tick that no simulation reaches."""
LATEST_S: Final = 1e9
"""Latest permitted time, s: thirty years; an interval that ends later counts as endless."""
_TICKS_PER_S: Final = 1000


@dataclass(frozen=True)
class Interval:
    """An interval of simulated time that may have no end."""

    start_s: float  # Beginning, seconds since the simulation started
    duration_s: float = math.inf  # Length, s; infinite by default

    def __post_init__(self) -> None:
        if not self._is_possible():
            raise self._refused("write start or start:length in seconds, at least 0.001 long")

    def _is_possible(self) -> bool:
        """Whether the interval begins in the permitted time and lasts at least one tick."""
        if not (0.0 <= self.start_s <= LATEST_S and self.duration_s > 0.0):
            return False
        first_tick, end_tick = self.edges()
        return end_tick > first_tick

    def _refused(self, remedy: str) -> OptionError:
        return OptionError(f"'{self.start_s}:{self.duration_s}' is not an interval of time", remedy)

    def edges(self) -> tuple[int, int]:
        """Return the first tick of the interval, and the first tick after it."""
        end_s = self.start_s + self.duration_s
        end_tick = round(_TICKS_PER_S * end_s) if end_s <= LATEST_S else NEVER
        return round(_TICKS_PER_S * self.start_s), end_tick

    def holds(self, tick: int) -> bool:
        """Whether a `tick`, ms since the simulation started, is within the interval."""
        first_tick, end_tick = self.edges()
        return first_tick <= tick < end_tick


class Span(Interval):
    """An interval of simulated time that ends: `duration_s` is finite, otherwise an OptionError is raised."""

    def __post_init__(self) -> None:
        if not (self.duration_s <= LATEST_S and self._is_possible()):
            raise self._refused("write start:length in seconds, at least 0.001 long")


def edges_of(spans: Iterable[Interval]) -> tuple[int, ...]:
    """Ticks at which one of the `spans` begins or ends, sorted, with `NEVER` as the last element."""
    return (*sorted(edge for span in spans for edge in span.edges() if edge < NEVER), NEVER)


def next_edge(edges: Sequence[int], tick: int) -> int:
    """First of the `edges` that `edges_of` returned that is after a `tick`; `NEVER` if there is none."""
    return edges[bisect_right(edges, tick)]


_MAX_SCALE: Final = 16.0
"""Largest scale of an encoder: discs of 1000 to 16000 lines are sold."""


class _SimBoard(Protocol):
    def set_stop(self, pressed: bool) -> None: ...


@dataclass(frozen=True)
class RigFaults:
    """Faults of the rig with their times."""

    encoders_out: tuple[tuple[str, Interval], ...] = ()
    """Axes whose encoder is unplugged, and when: motion in this time is not counted."""
    stop_switch: tuple[Interval, ...] = ()  # Times in which the hardware stop input is active
    supply_out: tuple[Interval, ...] = ()
    """Times in which the motors have no supply, although the board commands a voltage."""
    encoder_scales: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Counts of each encoder per count in the rig file: 0.5 for an encoder with half the counts, -1 for one
    that is wired backwards. The board does not know them."""
    motor_signs: tuple[int, int] = (1, 1)  # -1 for a motor, front or back, whose leads are exchanged
    motors_swapped: bool = False
    """The front output drives the back motor, and the back output the front motor."""

    def __post_init__(self) -> None:
        for axis, _ in self.encoders_out:
            if axis not in AXES:
                raise OptionError(f"unknown encoder '{axis}'", f"choose {', '.join(AXES)}")
        for scale in self.encoder_scales:
            if not (math.isfinite(scale) and 0.0 < abs(scale) <= _MAX_SCALE):
                raise OptionError(
                    f"an encoder's scale of {scale:g} is out of range",
                    f"give a number from -{_MAX_SCALE:g} to {_MAX_SCALE:g}, but not 0",
                )

        if not set(self.motor_signs) <= {-1, 1}:
            raise OptionError(f"motor signs {self.motor_signs} are invalid", "give 1 or -1 for each")

    @property
    def uncompared_signs(self) -> dict[str, float]:
        """Return 0 as the sign of each motor with wrong wires."""
        # Sign 0 means "unknown": the host then does not compare the sign in the board with the rig.
        wires_are_wrong = (self.motors_swapped or sign < 0 for sign in self.motor_signs)
        names = ("motor_front_sign", "motor_back_sign")
        return {name: 0.0 for name, is_wrong in zip(names, wires_are_wrong, strict=True) if is_wrong}

    def next_edge(self, tick: int) -> int:
        """Return the first tick after a given one at which a fault begins or ends."""
        return next_edge(self._edges, tick)

    @cached_property
    def _edges(self) -> tuple[int, ...]:
        encoders_out = (interval for _, interval in self.encoders_out)
        return edges_of((*encoders_out, *self.stop_switch, *self.supply_out))

    def apply(self, tick: int, native: _native.World, board: _SimBoard) -> None:
        """Apply the faults that are active at a tick to the simulated rig."""
        if self.encoders_out:
            native.encoders_out = [
                any(name == axis and interval.holds(tick) for name, interval in self.encoders_out)
                for axis in AXES
            ]
        if self.stop_switch:
            board.set_stop(any(interval.holds(tick) for interval in self.stop_switch))
        if self.supply_out:
            native.supply_on = not any(interval.holds(tick) for interval in self.supply_out)


@dataclass(frozen=True)
class FaultPlan:
    """Faults of the link, in both directions."""

    flip: float = 0.0  # Probability that a bit arrives inverted
    drop: float = 0.0  # Probability that a byte is lost
    double: float = 0.0  # Probability that a byte arrives twice
    stalls: tuple[Span, ...] = ()
    """Times in which the host neither reads nor writes: bytes towards it overflow the bridge, bytes from it
    wait."""
    unplugs: tuple[Span, ...] = ()
    """Times in which the cable is unplugged: the port is gone, and bytes in transit are lost; the board keeps
    its power."""

    def __post_init__(self) -> None:
        for name in ("flip", "drop", "double"):
            value = getattr(self, name)
            if not 0.0 <= value <= 1.0:
                raise OptionError(f"{name}={value} is not a probability", "give a number from 0 to 1")

    def next_edge(self, tick: int) -> int:
        """Return the first tick after `tick` at which a stall or an unplugging begins or ends."""
        # Without a further one, the result is `NEVER`.
        return next_edge(self._edges, tick)

    @cached_property
    def _edges(self) -> tuple[int, ...]:
        return edges_of((*self.stalls, *self.unplugs))

    def stalled(self, tick: int) -> bool:
        """Whether the host is stalled at a `tick`, inside one of `stalls`."""
        return any(span.holds(tick) for span in self.stalls)

    def unplugged(self, tick: int) -> bool:
        """Whether the cable is unplugged at a `tick`, inside one of `unplugs`."""
        return any(span.holds(tick) for span in self.unplugs)


@dataclass
class FaultCounters:
    """Number of faults so far, by kind."""

    bytes_seen: int = 0  # Bytes that entered
    flipped: int = 0  # Bits inverted
    dropped: int = 0  # Bytes lost
    doubled: int = 0  # Bytes sent twice


class FaultyStream:
    """One direction of a link with random faults."""

    def __init__(self, plan: FaultPlan, seed: int, direction: int) -> None:
        self.counters = FaultCounters()
        self._flip = _RareEvents(plan.flip, seed, direction, 0)
        self._drop = _RareEvents(plan.drop, seed, direction, 1)
        self._double = _RareEvents(plan.double, seed, direction, 2)
        self._has_no_faults = plan.flip == plan.drop == plan.double == 0.0

    def pass_through(self, data: bytes) -> bytes:
        """Return the bytes of `data` after the faults that are due."""
        self.counters.bytes_seen += len(data)
        if self._has_no_faults or not data:
            return data
        flips = self._flip.next_positions(8 * len(data))
        drops = self._drop.next_positions(len(data))
        doubles = self._double.next_positions(len(data))
        if not (flips or drops or doubles):
            return data
        pieces = [bytearray([byte]) for byte in data]
        for bit in flips:
            pieces[bit // 8][0] ^= 1 << (bit % 8)
        for index in doubles:
            pieces[index] *= 2
        for index in drops:
            pieces[index].clear()
        self.counters.flipped += len(flips)
        self.counters.dropped += len(drops)
        self.counters.doubled += len(doubles)
        return b"".join(pieces)


class _RareEvents:
    """Draws the positions of rare events in a long sequence of trials."""

    # It draws the gaps between events, which takes less time than a draw for each trial.

    def __init__(self, probability: float, *seed: int) -> None:
        self._probability = probability
        self._random = np.random.default_rng(seed)
        self._next = self._draw_gap()

    def _draw_gap(self) -> int:
        """Draw the number of trials without an event before the next event."""
        if self._probability == 0.0:
            return NEVER
        return int(self._random.geometric(self._probability)) - 1

    def next_positions(self, trials: int) -> list[int]:
        """Return the positions of the events among the next `trials` trials, and go on after them."""
        positions = []
        while self._next < trials:
            positions.append(self._next)
            self._next += 1 + self._draw_gap()
        self._next -= trials
        return positions
