"""One time axis for device ticks: from the first tick logged, across wraps and restarts of the board."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from heli_host.declaration import TICK_US


class TickClock:
    """Converts the board's 32-bit tick counter, which wraps after 49.7 days, to time that always grows.

    After a restart of the board, whose counter starts at 0, the time continues.
    """

    def __init__(self) -> None:
        self._last_tick: int | None = None
        self._last_us = 0

    def advance(self, tick: NDArray[np.uint32]) -> tuple[NDArray[np.int64], int]:
        """Place a batch of ticks on the axis. Shapes: `tick` (n,); returns `time_us` (n,)."""
        has_previous = self._last_tick is not None
        before = self._last_tick if self._last_tick is not None else int(tick[0])
        # A tick has 32 bits: differences modulo 2^32, read as signed, are right over an overflow too.
        step = np.diff(tick, prepend=np.uint32(before)).view(np.int32).astype(np.int64)
        first_counted = 0 if has_previous else 1
        # A step that is not positive is a restart of the board; it counts as one tick.
        is_restart = step[first_counted:] <= 0
        step[first_counted:][is_restart] = 1
        lost = int(step.sum()) - (step.size - first_counted)
        time_us = self._last_us + np.cumsum(step) * TICK_US
        self._last_tick, self._last_us = int(tick[-1]), int(time_us[-1])
        return time_us, lost

    def skip(self, gap_s: float) -> None:
        """Leave time for a restart of the board."""
        if self._last_tick is not None:
            self._last_us += max(1, round(gap_s * 1e6 / TICK_US)) * TICK_US
            self._last_tick = None

    def time_us(self, tick: int) -> int:
        """Place an event on the axis, without moving on."""
        if self._last_tick is None:
            return self._last_us
        step = (tick - self._last_tick) & 0xFFFFFFFF
        return max(0, self._last_us + (step - (1 << 32) if step >= 1 << 31 else step) * TICK_US)
