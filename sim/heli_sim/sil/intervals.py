"""Intervals of simulated time in which a fault acts."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

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
