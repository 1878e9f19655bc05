"""Random faults of the link: flipped bits, lost and doubled bytes, stalls, and an unplugged cable.

With the same seed, the same bytes are damaged, independent of how the stream is cut into pieces.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from heli_sim.errors import OptionError
from heli_sim.sil.intervals import NEVER, Span, edges_of, next_edge


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
        """Return the first tick after `tick` at which a stall or an unplugging begins or ends.

        Without a further one, the result is `NEVER`.
        """
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
    """Draws the positions of rare events in a long sequence of trials.

    It draws the gaps between events, which takes less time than a draw for each trial.
    """

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
