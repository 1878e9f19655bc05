"""Stretches of simulated time in which something is wrong."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from heli_sim.errors import OptionError

NEVER: Final = 1 << 62
"""A tick that does not come."""
_TICKS_PER_S: Final = 1000


@dataclass(frozen=True)
class During:
    """A stretch of simulated time that may have no end.

    Parameters
    ----------
    start_s : float
        Beginning, seconds since the simulation started.
    duration_s : float
        Length, s; infinite for one that lasts.

    Raises
    ------
    OptionError
        When it begins before the simulation, or has no length.
    """

    start_s: float
    duration_s: float = math.inf

    def __post_init__(self) -> None:
        if not (math.isfinite(self.start_s) and self.start_s >= 0.0 and self.duration_s > 0.0):
            raise self._refused("write start or start:length in seconds")

    def _refused(self, remedy: str) -> OptionError:
        return OptionError(f"'{self.start_s}:{self.duration_s}' is no stretch of time", remedy)

    def edges(self) -> tuple[int, int]:
        """First tick of the stretch, and first tick after it, ms since the simulation started."""
        end_s = self.start_s + self.duration_s
        end_tick = round(_TICKS_PER_S * end_s) if math.isfinite(end_s) else NEVER
        return round(_TICKS_PER_S * self.start_s), end_tick

    def holds(self, tick: int) -> bool:
        """Whether a `tick`, ms since the simulation started, lies in the stretch."""
        first, after = self.edges()
        return first <= tick < after


class Span(During):
    """A stretch of simulated time that ends: `duration_s` is finite; an OptionError when it is not."""

    def __post_init__(self) -> None:
        finite = math.isfinite(self.start_s) and math.isfinite(self.duration_s)
        if not finite or self.start_s < 0.0 or self.duration_s <= 0.0:
            raise self._refused("write start:length in seconds")


def next_edge(spans: Iterable[During], tick: int) -> int:
    """First tick after `tick` at which one of the `spans` begins or ends; `NEVER` when there is none."""
    return min((edge for span in spans for edge in span.edges() if edge > tick), default=NEVER)
