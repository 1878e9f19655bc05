"""Counts of received and lost ticks, and all other counters of a session."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heli_host.declaration import StatusMessage
from heli_host.link.telemetry import EMPTY_TICKS, Ticks

_TICK_MODULUS = 1 << 32


@dataclass(frozen=True)
class LinkCounters:
    """Counts of a session, from the first welcome on.

    Parameters
    ----------
    frames_ok : int
        Frames from the board that passed every check.
    frames_bad : int
        Frames refused: COBS, length, CRC, protocol, or telemetry whose length does not fit or whose
        enumerations have values that are not declared.
    frames_lost : int
        Gaps in the board's sequence numbers.
    bytes_received : int
        All bytes that arrived.
    bytes_dropped : int
        Bytes that belong to no accepted frame.
    retries : int
        Commands sent again because no answer came in time.
    reconnects : int
        Times that the link was lost, or the board fell silent, and came back.
    restarts : int
        Number of restarts of the board during the session.
    ticks_received : int
        Samples delivered.
    ticks_lost : int
        Samples missing between those delivered; a restart of the board ends the counting before it.
    setpoints_sent, voltages_sent : int
        Streamed values that were sent.
    setpoints_skipped, voltages_skipped : int
        Streamed values that a later one replaced before the rate limit let them go.
    board : StatusMessage or None
        The board's own counters as it last sent them.
    """

    frames_ok: int = 0
    frames_bad: int = 0
    frames_lost: int = 0
    bytes_received: int = 0
    bytes_dropped: int = 0
    retries: int = 0
    reconnects: int = 0
    restarts: int = 0
    ticks_received: int = 0
    ticks_lost: int = 0
    setpoints_sent: int = 0
    setpoints_skipped: int = 0
    voltages_sent: int = 0
    voltages_skipped: int = 0
    board: StatusMessage | None = None


class TickAccount:
    """Follows the tick numbers of a session.

    Attributes
    ----------
    received, lost : int
        Samples accepted, and samples missing between them.
    """

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
        """Return a device tick counted on over 2^32.

        Parameters
        ----------
        tick : int
            As it came over the link.

        Returns
        -------
        int
            The value congruent to it that is nearest to the newest tick.
        """
        if self._last is None:
            return tick
        half = _TICK_MODULUS // 2
        return self._last + (tick - self._last + half) % _TICK_MODULUS - half

    def take(self, ticks: Ticks) -> tuple[Ticks, bool]:
        """Count samples.

        Parameters
        ----------
        ticks : Ticks
            Newly decoded samples in order of arrival.

        Returns
        -------
        accepted : Ticks
            Samples before the first jump back of the tick number; later samples are left out.
        jumped_back : bool
            True if the tick number fell, because the board restarted.
        """
        if len(ticks) == 0:
            return ticks, False
        first, final = int(ticks.tick[0]), int(ticks.tick[-1])
        before = self._last if self._last is not None else first - 1
        # Right at both ends is right throughout: only a restart and a loss that make up for each other to the
        # tick, within one reading, could look the same.
        if (first - before) % _TICK_MODULUS == 1 and (final - first) % _TICK_MODULUS == len(ticks) - 1:
            self.received += len(ticks)
            self._last = before + len(ticks)
            return ticks, False
        # Signed, so that 2^32 wraps: (n,)
        steps = np.diff(ticks.tick, prepend=np.uint32(before % _TICK_MODULUS)).astype(np.int32)
        jumped_back = bool(steps.min() <= 0)
        if jumped_back:
            kept = int(np.argmax(steps <= 0))
            if kept == 0:
                return EMPTY_TICKS, True
            ticks, steps = Ticks(ticks.tick[:kept], ticks.raw[:kept]), steps[:kept]
        passed = int(steps.sum())
        self.received += len(ticks)
        self.lost += passed - len(ticks)
        self._last = before + passed
        return ticks, jumped_back
