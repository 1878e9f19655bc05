"""The live samples for viewers: processor time of every tick, and the stop with them and without them."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from heli_host.fly.heli import Heli
from heli_host.ui.foxglove_feed import FoxgloveFeed, foxglove_feed

from tests.bench.page import stop_latencies_ms, tabs
from tests.bench.result import Measured
from tests.page.page_server import page_of_a_simulated_board

WATCHED_S = 20.0
BLOCKS = 10
PRESSES_PER_BLOCK = 25


@contextlib.contextmanager
def watched_feed(heli: Heli, missing: list[int]) -> Iterator[FoxgloveFeed]:
    """Serve a viewer that takes every tick; append how many it missed."""
    with foxglove_feed(heli, 0) as feed:
        assert feed is not None
        words = [sys.executable, "-m", "tests.link.foxglove_viewer", feed.address]
        with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as viewer:
            assert viewer.stdin is not None
            assert viewer.stdout is not None
            assert viewer.stdout.readline().strip() == "ready"
            yield feed
            viewer.stdin.close()
            missing.append(int(viewer.stdout.readline().split()[1]))


def server_busy_s(feed: FoxgloveFeed) -> float:
    """Return the processor time of the feed's server [s]; Linux only."""
    fields = Path(f"/proc/{feed.server_pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def busy_share(heli: Heli, feed: FoxgloveFeed | None = None) -> float:
    """Return the share of a core that this process and a feed's server take [1]."""
    start_s, own_s, server_s = time.perf_counter(), time.process_time(), server_busy_s(feed) if feed else 0.0
    heli.wait(WATCHED_S)
    busy_s = time.process_time() - own_s + (server_busy_s(feed) - server_s if feed else 0.0)
    return busy_s / (time.perf_counter() - start_s)


def measure() -> list[Measured]:
    """Compare stops in turn with a viewer and without one, then the processor time."""
    with_ms: list[float] = []
    without_ms: list[float] = []
    missing: list[int] = []
    with TemporaryDirectory() as folder, page_of_a_simulated_board(Path(folder)) as served:
        heli = served.heli
        with tabs(served, 1) as ask:

            def press() -> float:
                return float(ask("press"))

            for _ in range(BLOCKS):
                without_ms += stop_latencies_ms(PRESSES_PER_BLOCK, press, heli)
                with watched_feed(heli, missing):
                    with_ms += stop_latencies_ms(PRESSES_PER_BLOCK, press, heli)
        share_alone = busy_share(heli)
        with watched_feed(heli, missing) as feed:
            share = busy_share(heli, feed) - share_alone
    return [
        Measured("foxglove_cpu_at_1khz", [share]),
        Measured("foxglove_ticks_missed", [float(sum(missing))]),
        Measured("foxglove_stop_p99_ms", [float(np.percentile(with_ms, 99))]),
        Measured("foxglove_stop_p99_without_ms", [float(np.percentile(without_ms, 99))]),
    ]
