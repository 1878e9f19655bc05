"""Counts of received and lost ticks, and all other counters of a session."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heli_host.declaration import StatusMessage
from heli_host.link.telemetry import EMPTY_TICKS, Ticks

_TICK_MODULUS = 1 << 32


@dataclass(frozen=True)
class LinkCounters:
    """Counts of a session, from the first welcome on."""

    frames_ok: int = 0  # Frames from the board that passed every check
    frames_bad: int = 0
    """Frames refused: COBS, length, CRC, protocol, or telemetry whose length does not fit or whose
    enumerations have values that are not declared."""
    frames_lost: int = 0  # Gaps in the board's sequence numbers
    bytes_received: int = 0  # All bytes that arrived
    bytes_dropped: int = 0  # Bytes that belong to no accepted frame
    retries: int = 0  # Commands sent again because no answer came in time
    reconnects: int = 0  # Times that the link was lost, or the board fell silent, and came back
    restarts: int = 0  # Number of restarts of the board during the session
    ticks_received: int = 0  # Samples delivered
    ticks_lost: int = 0
    """Samples missing between those delivered; a restart of the board ends the counting before it."""
    setpoints_sent: int = 0  # setpoints_sent, voltages_sent: Streamed values that were sent
    setpoints_skipped: int = 0
    """setpoints_skipped, voltages_skipped: Streamed values that a newer value replaced before the rate limit
    permitted them to be sent."""
    voltages_sent: int = 0
    voltages_skipped: int = 0
    board: StatusMessage | None = None  # The newest counters that the board sent


class TickAccount:
    """Follows the tick numbers of a session."""

    def __init__(self) -> None:
        self.received = 0
        self.lost = 0
        self._last: int | None = None

    @property
    def last(self) -> int | None:
        """Newest tick, counted on over 2^32; None before the first and after a restart."""
        return self._last

    def restart(self) -> None:
        """Accept the next tick without a check of its number, because the board has restarted."""
        self._last = None

    def unwrap(self, tick: int) -> int:
        """Return a device tick without the wrap at 2^32."""
        if self._last is None:
            return tick
        half_range = _TICK_MODULUS // 2
        return self._last + (tick - self._last + half_range) % _TICK_MODULUS - half_range

    def take(self, ticks: Ticks) -> tuple[Ticks, bool]:
        """Count samples. Returns `accepted`, `jumped_back`."""
        if len(ticks) == 0:
            return ticks, False
        first, final = int(ticks.tick[0]), int(ticks.tick[-1])
        before = self._last if self._last is not None else first - 1
        # If first and last tick and their distance are right, no tick is missing. Only a restart and a loss
        # that compensate each other exactly within one reading would not be noticed.
        if (first - before) % _TICK_MODULUS == 1 and (final - first) % _TICK_MODULUS == len(ticks) - 1:
            self.received += len(ticks)
            self._last = before + len(ticks)
            return ticks, False
        # As signed numbers, steps are right across the wrap at 2^32, shape (n,).
        steps = np.diff(ticks.tick, prepend=np.uint32(before % _TICK_MODULUS)).astype(np.int32)
        jumped_back = bool(steps.min() <= 0)
        if jumped_back:
            accepted_count = int(np.argmax(steps <= 0))
            if accepted_count == 0:
                return EMPTY_TICKS, True
            ticks, steps = (
                Ticks(ticks.tick[:accepted_count], ticks.raw[:accepted_count]),
                steps[:accepted_count],
            )
        elapsed = int(steps.sum())
        self.received += len(ticks)
        self.lost += elapsed - len(ticks)
        self._last = before + elapsed
        return ticks, jumped_back
