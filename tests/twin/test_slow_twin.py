"""A twin that is too slow for its computer: it skips what waits, and neither memory nor its delay grows."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from typing import Any, cast

import numpy as np
from heli_host.declaration import CHANNELS
from heli_host.link.session import Session
from heli_host.link.telemetry import Ticks
from heli_host.twins import TwinNews, TwinWatch

PART = 1000


class _Session:
    lockstep = False

    def subscribe_ticks(self, callback: Callable[[Ticks], None]) -> Callable[[], None]:
        self.send = callback
        return lambda: None

    def ticks_counted_on(self, ticks: Ticks) -> Any:
        return ticks.tick.astype(np.int64)


class _SlowTwin:
    def __init__(self) -> None:
        self.begun, self.goes_on = threading.Event(), threading.Event()
        self.seen: list[int] = []

    def update(self, tick: Any, raw: Any) -> Sequence[TwinNews]:
        self.begun.set()
        self.goes_on.wait(60.0)
        self.seen.append(int(tick[0]))
        return []

    def ghost_rad(self) -> None:
        return None

    def words(self) -> str:
        return "follows"


def test_a_twin_that_is_too_slow_skips_what_waits_and_says_so() -> None:
    session, twin = _Session(), _SlowTwin()
    watch = TwinWatch(cast(Session, session), twin)
    raw = np.zeros((PART, len(CHANNELS)), np.int32)
    for part in range(100):
        session.send(Ticks(np.arange(part * PART, (part + 1) * PART, dtype=np.uint32), raw))
        twin.begun.wait(60.0)
    twin.goes_on.set()
    watch.close()
    # 10 s wait at most; the newest sample is always processed.
    assert len(twin.seen) <= 13 and twin.seen[-1] == 99 * PART
    assert watch.skipped_ticks == 100 * PART - len(twin.seen) * PART
    skipped_s = watch.skipped_ticks // 1000
    assert watch.words() == f"follows; {skipped_s} s of samples skipped, because this computer is slow"
