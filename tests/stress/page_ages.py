"""How old the status is that a client of a page shows, and whether this computer gave the client time to look."""

from __future__ import annotations

import json
import sys
import threading
import time
from collections import deque
from typing import Any, Final

from heli_host.page.serve import Address

from tests.page.socket_page import SocketPage

STALE_S: Final = 0.6
"""Age of a status at which a page shows the red bar: `STALE_MS` of main.js."""
SHOWN_S: Final = 0.05
"""A status that the next one replaces sooner is not seen: a tab that is resumed reads all that waits at once."""
_MEMORY: Final = 100
_LOOK_S: Final = 0.05
_KEPT: Final = 300


class Lateness:
    """How late this computer wakes a thread that only sleeps: its own share of every gap.

    Attributes
    ----------
    worst_s : float
        The latest waking.
    """

    def __init__(self) -> None:
        self.worst_s = 0.0
        self.late: deque[tuple[float, float]] = deque(maxlen=1000)
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        before_s = time.monotonic()
        while True:
            time.sleep(_LOOK_S)
            now_s = time.monotonic()
            late_s = now_s - before_s - _LOOK_S
            if late_s > 0.1:
                self.late.append((before_s, now_s))
            self.worst_s = max(self.worst_s, late_s)
            before_s = now_s

    def during(self, begin_s: float, end_s: float) -> float:
        """Return how late wakings were between two moments, in all [s]."""
        return sum(until - since - _LOOK_S for since, until in self.late if until > begin_s and since < end_s)


class StatusAges:
    """Ages of the statuses that one client has shown.

    The status holds how many ticks the host has received. They come at 1 kHz, so the smallest difference from the
    receiver's clock is a status that took no time; a larger one is an old status.

    Attributes
    ----------
    received : int
        Number of statuses.
    oldest_s : float
        The greatest age that was shown without the red bar.
    bars : int
        How often the red bar came up.
    """

    def __init__(self, lateness: Lateness) -> None:
        self.received = self.bars = self.bars_of_computer = 0
        self.oldest_s = 0.0
        self.oldest_arrival_s = 0.0
        self._lateness = lateness
        self._offsets: deque[float] = deque(maxlen=_MEMORY)
        self._arrived_s = self._age_s = 0.0

    def take(self, status: dict[str, Any], now_s: float) -> None:
        """Note a status that arrived now."""
        self._offsets.append(now_s - 1e-3 * status["link"]["ticks"])
        age_s = self._offsets[-1] - min(self._offsets)
        if self.received:
            gap_s = now_s - self._arrived_s
            if gap_s > STALE_S:
                own = self._lateness.during(self._arrived_s, now_s) > gap_s - STALE_S
                self.bars += not own
                self.bars_of_computer += own
            elif gap_s >= SHOWN_S:
                self.oldest_s = max(self.oldest_s, gap_s + self._age_s)
        self.oldest_arrival_s = max(self.oldest_arrival_s, age_s)
        self.received += 1
        self._arrived_s, self._age_s = now_s, age_s


class AgedPage(SocketPage):
    """A tab that knows how old its status is, and forgets what it received."""

    def __init__(self, address: Address, lateness: Lateness, client: str = "") -> None:
        self.ages = StatusAges(lateness)
        super().__init__(address, client)

    def take_words(self, words: dict[str, Any]) -> None:
        """Take a message; see `SocketPage`."""
        if "status" in words and "hello" not in words:
            self.ages.take(words["status"], time.monotonic())
        super().take_words(words)
        if len(self.words) > 2 * _KEPT:
            del self.words[:_KEPT], self.rows[:-2]


def main(host: str, port: str, token: str, tabs: str) -> None:
    """Keep tabs open until the input ends; then print what was measured, as JSON."""
    lateness = Lateness()
    pages = [AgedPage(Address(host, int(port), token), lateness) for _ in range(int(tabs))]
    print("ready", flush=True)
    for line in sys.stdin:
        print(json.dumps({"pages": [vars_of(page.ages) for page in pages], "asked": line.strip()}), flush=True)
    for page in pages:
        page.close()


def vars_of(ages: StatusAges) -> dict[str, float]:
    """Return the public numbers of some ages."""
    return {name: value for name, value in vars(ages).items() if not name.startswith("_")}


if __name__ == "__main__":
    main(*sys.argv[1:])
