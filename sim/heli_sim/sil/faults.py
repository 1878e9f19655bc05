"""Random faults of the link. The same seed damages the same bytes, whatever the sizes of the pieces in which
they arrive.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from heli_sim.errors import OptionError
from heli_sim.sil.intervals import NEVER, Span, edges_of, next_edge


@dataclass(frozen=True)
class FaultPlan:
    """Faults of the link, in both directions.

    Parameters
    ----------
    flip : float
        Probability that a bit arrives inverted.
    drop : float
        Probability that a byte is lost.
    double : float
        Probability that a byte arrives twice.
    stalls : tuple of Span
        The host neither reads nor writes: bytes towards it overflow the bridge, bytes from it wait.
    unplugs : tuple of Span
        The cable is out: the port is gone, bytes under way are lost; the board keeps its power.

    Raises
    ------
    OptionError
        When a probability is not between 0 and 1.
    """

    flip: float = 0.0
    drop: float = 0.0
    double: float = 0.0
    stalls: tuple[Span, ...] = ()
    unplugs: tuple[Span, ...] = ()

    def __post_init__(self) -> None:
        for name in ("flip", "drop", "double"):
            value = getattr(self, name)
            if not 0.0 <= value <= 1.0:
                raise OptionError(f"{name}={value} is not a probability", "give a number from 0 to 1")

    def next_edge(self, tick: int) -> int:
        """First tick after `tick` at which a stall or an unplugging begins or ends; a very large number if
        there is none.
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
    """Number of faults so far, by kind.

    Parameters
    ----------
    bytes_seen : int
        Bytes that entered.
    flipped : int
        Bits inverted.
    dropped : int
        Bytes lost.
    doubled : int
        Bytes sent twice.
    """

    bytes_seen: int = 0
    flipped: int = 0
    dropped: int = 0
    doubled: int = 0


class FaultyStream:
    """One direction of a link with random faults: `direction` is 0 to the board, 1 to the host. Each
    direction draws other faults from the `seed`.
    """

    def __init__(self, plan: FaultPlan, seed: int, direction: int) -> None:
        self.counters = FaultCounters()
        self._flip = _Gaps(plan.flip, seed, direction, 0)
        self._drop = _Gaps(plan.drop, seed, direction, 1)
        self._double = _Gaps(plan.double, seed, direction, 2)
        self._clean = plan.flip == plan.drop == plan.double == 0.0

    def pass_through(self, data: bytes) -> bytes:
        """Return the bytes of `data` after the faults that are due."""
        self.counters.bytes_seen += len(data)
        if self._clean or not data:
            return data
        flips = self._flip.within(8 * len(data))
        drops = self._drop.within(len(data))
        doubles = self._double.within(len(data))
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


class _Gaps:
    """Positions of rare events in a long sequence of trials, drawn gap by gap."""

    def __init__(self, probability: float, *seed: int) -> None:
        self._probability = probability
        self._random = np.random.default_rng(seed)
        self._next = self._gap()

    def _gap(self) -> int:
        if self._probability == 0.0:
            return NEVER
        return int(self._random.geometric(self._probability)) - 1

    def within(self, trials: int) -> list[int]:
        """Positions of the events among the next `trials` trials."""
        hits = []
        while self._next < trials:
            hits.append(self._next)
            self._next += 1 + self._gap()
        self._next -= trials
        return hits
