"""The live page: how soon a stop acts on the emulated Due, and what the page costs a host that records.

``python -m tests.bench.page HOST PORT TOKEN TABS`` has tabs of a page in a process of their own. It answers
each line of standard input with one line. ``press`` stops by the socket of the first tab, and gives the time
before that [s, monotonic]. ``gaps`` gives the number of ticks that the tabs missed.
"""

import contextlib
import os
import random
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from heli_host.board.heli import Heli
from heli_host.declaration import Axes, Channel, State
from heli_host.errors import CommandRefused
from heli_host.fly.recorder import Recorder
from heli_host.link.telemetry import Ticks
from heli_host.ui.foxglove_feed import FoxgloveFeed, foxglove_feed
from heli_host.ui.page.serve import Address

from tests.bench.result import Measured
from tests.page.page_server import Served, SocketPage, page_of_a_simulated_board


def missing(page: SocketPage) -> int:
    """Count the ticks that a tab did not get, of those since the history, which may be thinned."""
    # The history follows an empty frame, which the page must answer first.
    frames = [rows for rows in list(page.rows) if rows.tick.size]
    tick = np.concatenate([rows.tick for rows in frames[1:]])
    return int((np.diff(tick) - 1).sum())


def main(host: str, port: str, token: str, tabs: str) -> None:
    """Open tabs and do what is asked, until the input ends."""
    dice = random.Random(1)
    pages = [SocketPage(Address(host, int(port), token)) for _ in range(int(tabs))]
    print("ready", flush=True)
    for line in sys.stdin:
        if line.strip() == "press":
            # Anywhere between two frames, and between two readings of the link.
            time.sleep(dice.uniform(0.0, 0.1))
            pressed_s = time.monotonic()
            pages[0].stop()
            print(pressed_s, flush=True)
        else:
            print(sum(missing(page) for page in pages), flush=True)
    for page in pages:
        page.close()


PRESSES = 100
HOVER_S = 20.0
TABS = 4
WATCHED_S = 60.0
BURN = "while True: pass"


@contextlib.contextmanager
def tabs(served: Served, count: int) -> Iterator[Callable[[str], str]]:
    """Open tabs in a process of their own; what is yielded asks them."""
    address = served.address
    words = [address.host, str(address.port), address.token, str(count)]
    with subprocess.Popen(
        [sys.executable, "-m", "tests.bench.page", *words],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        sent, heard = process.stdin, process.stdout

        def ask(what: str) -> str:
            sent.write(f"{what}\n")
            sent.flush()
            return heard.readline().strip()

        assert heard.readline().strip() == "ready"
        yield ask
        sent.close()


@contextlib.contextmanager
def loaded_cores(count: int) -> Iterator[None]:
    """Keep cores busy with processes that only count."""
    burning = [subprocess.Popen([sys.executable, "-c", BURN]) for _ in range(count)]
    try:
        yield
    finally:
        for process in burning:
            process.kill()
            process.wait()


def run_motors(heli: Heli) -> None:
    """Bring the motors to a voltage within the dead zone."""
    while heli.state is not State.ARMED:
        heli.session.release_stop(heli.session.stops)
        with contextlib.suppress(CommandRefused):
            heli.arm()
        heli.wait(0.1)
    heli.control(Axes(0), front_V=0.8, back_V=0.8)
    heli.wait_until(lambda sample: sample.front_V > 0.0, 2.0)


class ZeroDuty:
    """Notes when this host has seen the motors without voltage, after they ran."""

    # That is later than the moment itself by the rest of a batch, the line and the reading of it, 10 to 30
    # ms: the number is an upper bound. The board's ticks say less where a loaded computer runs it in bursts.

    def __init__(self, heli: Heli) -> None:
        self._heli = heli
        self._ran = False
        self._seen_s: float | None = None
        heli.session.subscribe_ticks(self._take)

    def wait(self) -> float:
        """Return the host's monotonic time at which it was seen [s], once it has been."""
        self._heli.session.wait_for(lambda: self._seen_s is not None, 5.0)
        seen_s, self._seen_s, self._ran = self._seen_s, None, False
        assert seen_s is not None, "the motors were not stopped in 5 s"
        return seen_s

    def _take(self, ticks: Ticks) -> None:
        runs = (ticks.raw[:, Channel.FRONT] != 0) | (ticks.raw[:, Channel.BACK] != 0)
        self._ran = self._ran or bool(runs.any())
        if self._ran and not runs[-1] and self._seen_s is None:
            self._seen_s = time.monotonic()


def stop_latencies_ms(presses: int, press: Callable[[], float], heli: Heli) -> list[float]:
    """Stop running motors again and again; from each press to zero duty [ms]."""
    latencies, zero_duty = [], ZeroDuty(heli)
    for _ in range(presses):
        run_motors(heli)
        pressed_s = press()
        latencies.append((zero_duty.wait() - pressed_s) * 1e3)
    return latencies


def stop_under_load() -> list[float]:
    """Four tabs that take every row, both cores busy with other work, an emulated Due in real time."""
    with TemporaryDirectory() as folder, page_of_a_simulated_board(Path(folder), board="due") as served:
        heli = served.heli
        with tabs(served, TABS) as ask, loaded_cores(2):
            return stop_latencies_ms(PRESSES, lambda: float(ask("press")), heli)


def core_share(heli: Heli, folder: Path) -> float:
    """Share of a core that this process takes while it records [1]."""
    with Recorder(heli, folder / f"bench-{time.monotonic_ns()}.mcap"):
        start_s, busy_s = time.perf_counter(), time.process_time()
        heli.wait(HOVER_S)
        return (time.process_time() - busy_s) / (time.perf_counter() - start_s)


def cost_and_gaps(watched_s: float = WATCHED_S) -> tuple[float, int]:
    """Processor time with three tabs over that without any, and the ticks that three tabs missed."""
    with TemporaryDirectory() as folder, page_of_a_simulated_board(Path(folder)) as served:
        share_alone = core_share(served.heli, Path(folder))
        with tabs(served, 3) as ask:
            served.heli.wait(1.0)
            shown = core_share(served.heli, Path(folder))
            served.heli.wait(max(watched_s - HOVER_S, 0.0))
            return shown / share_alone, int(ask("gaps")) + served.heli.counters.ticks_lost


def measure_page() -> list[Measured]:
    """Measure the stop, and the page's cost."""
    latencies = stop_under_load()
    ratio, gaps = cost_and_gaps()
    return [
        Measured("page_stop_p99_ms", [float(np.percentile(latencies, 99))]),
        Measured("page_stop_median_ms", [float(np.median(latencies))]),
        Measured("page_cpu_ratio_three_tabs", [ratio]),
        Measured("page_ticks_missed_three_tabs", [float(gaps)]),
    ]


VIEWED_S = 20.0
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
    heli.wait(VIEWED_S)
    busy_s = time.process_time() - own_s + (server_busy_s(feed) - server_s if feed else 0.0)
    return busy_s / (time.perf_counter() - start_s)


def measure_foxglove() -> list[Measured]:
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


if __name__ == "__main__":
    main(*sys.argv[1:])
