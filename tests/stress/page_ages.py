"""How old the status is that a client of a page shows, and whether this computer let the client look."""

from __future__ import annotations

import json
import sys
import threading
import time
from collections import deque
from typing import Any, Final

from heli_host.ui.page.serve import Address

from tests.page.socket_page import SocketPage

STALE_S: Final = 0.6
"""Age of a status at which a page shows the red bar: `STALE_MS` of main.js."""
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
        return sum(
            until - since - _LOOK_S for since, until in list(self.late) if until > begin_s and since < end_s
        )


class StatusAges:
    """Ages of the statuses that one client has shown.

    A status holds the server's monotonic time, which all processes of a computer share. As a page does, a
    client drops a status that is older than `STALE_S` when it comes.

    Attributes
    ----------
    received : int
        Number of statuses.
    dropped : int
        How many of them were too old to be shown.
    oldest_s : float
        The greatest age that was shown without the red bar.
    bars : int
        How often the red bar came up.
    bars_of_computer : int
        How often the computer did not run this client meanwhile.
    """

    def __init__(self, lateness: Lateness) -> None:
        self.received = self.dropped = self.bars = self.bars_of_computer = 0
        self.oldest_s = 0.0
        self._lateness = lateness
        self._sent_s = 0.0

    def take(self, sent_s: float, now_s: float) -> None:
        """Note a status of that time, which arrived now."""
        self.received += 1
        if now_s - sent_s > STALE_S:
            self.dropped += 1
            return
        if self._sent_s:
            age_s = now_s - self._sent_s
            if age_s <= STALE_S:
                self.oldest_s = max(self.oldest_s, age_s)
            elif self._lateness.during(self._sent_s, now_s) > age_s - STALE_S:
                self.bars_of_computer += 1
            else:
                self.bars += 1
        self._sent_s = sent_s


class AgedPage(SocketPage):
    """A tab that knows how old its status is, and forgets what it received."""

    def __init__(self, address: Address, lateness: Lateness, client: str = "") -> None:
        self.ages = StatusAges(lateness)
        super().__init__(address, client)

    def take_words(self, words: dict[str, Any]) -> None:
        """Take a message; see `SocketPage`."""
        if "status" in words and "hello" not in words:
            self.ages.take(words["status"]["sent_s"], time.monotonic())
        super().take_words(words)
        if len(self.words) > 2 * _KEPT:
            del self.words[:_KEPT], self.rows[:-2]


def main(host: str, port: str, token: str, tabs: str) -> None:
    """Keep tabs open until the input ends; then print what was measured, as JSON."""
    lateness = Lateness()
    pages = [AgedPage(Address(host, int(port), token), lateness) for _ in range(int(tabs))]
    print("ready", flush=True)
    for line in sys.stdin:
        print(
            json.dumps({"pages": [vars_of(page.ages) for page in pages], "asked": line.strip()}), flush=True
        )
    for page in pages:
        page.close()


def vars_of(ages: StatusAges) -> dict[str, float]:
    """Return the public numbers of some ages."""
    return {name: value for name, value in vars(ages).items() if not name.startswith("_")}


if __name__ == "__main__":
    main(*sys.argv[1:])
