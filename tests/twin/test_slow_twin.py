"""A twin that is too slow for its computer skips samples; its memory and its delay stay bounded."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from typing import Any, cast

import numpy as np
from heli_host.board.twins import TwinNews, TwinWatch
from heli_host.declaration import CHANNELS
from heli_host.link.session import Session
from heli_host.link.telemetry import Ticks

BATCH_TICKS = 1000
BATCHES = 100


class _Session:
    """A session whose ticks the test sends itself."""

    lockstep = False

    def subscribe_ticks(self, callback: Callable[[Ticks], None]) -> Callable[[], None]:
        self.send = callback
        return lambda: None

    def ticks_counted_on(self, ticks: Ticks) -> Any:
        return ticks.tick.astype(np.int64)


class _SlowTwin:
    """A twin whose first update lasts until `may_continue` is set."""

    def __init__(self) -> None:
        self.has_begun, self.may_continue = threading.Event(), threading.Event()
        self.first_ticks: list[int] = []

    def update(self, tick: Any, raw: Any) -> Sequence[TwinNews]:
        self.has_begun.set()
        self.may_continue.wait(60.0)
        self.first_ticks.append(int(tick[0]))
        return []

    def ghost_rad(self) -> None:
        return None

    def words(self) -> str:
        return "follows"


def test_a_slow_twin_skips_samples_and_reports_it() -> None:
    session, twin = _Session(), _SlowTwin()
    watch = TwinWatch(cast(Session, session), twin)
    raw = np.zeros((BATCH_TICKS, len(CHANNELS)), np.int32)
    for batch in range(BATCHES):
        ticks = np.arange(batch * BATCH_TICKS, (batch + 1) * BATCH_TICKS, dtype=np.uint32)
        session.send(Ticks(ticks, raw))
        twin.has_begun.wait(60.0)
    twin.may_continue.set()
    watch.close()
    # At most 10 s of samples wait for the twin; the newest batch is always processed.
    assert len(twin.first_ticks) <= 13 and twin.first_ticks[-1] == (BATCHES - 1) * BATCH_TICKS
    assert watch.skipped_ticks == (BATCHES - len(twin.first_ticks)) * BATCH_TICKS
    skipped_s = watch.skipped_ticks // 1000
    assert watch.words() == f"follows; {skipped_s} s of samples skipped, because this computer is slow"
