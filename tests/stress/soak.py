"""A live page for a long time: clients come, go, sleep and misbehave while plans are flown and recorded.

``python -m tests.stress soak --minutes 60`` prints what was lost, how the server's memory grew, and how old
the status was that any client showed. The seed decides what the clients do; the computer decides when.
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import heli_host
import numpy as np
from heli_host.data.log.reader import read_log
from heli_host.errors import HeliError
from heli_host.ui.page.serve import Address
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

from tests.page.hostile_requests import hostile_request
from tests.page.page_server import SocketPage, page_process

PLAN: Final = """
title = "Short"
[start]
elevation_deg = 0
rate_deg_s = 15
settle_s = 1
[[segment]]
kind = "ramp"
travel_deg = 5
duration_s = 3
[[segment]]
kind = "hold"
duration_s = 6
"""
WARM_UP_S: Final = 600.0
"""The server's memory counts from then on: before, its buffers of the newest minutes fill."""
MAX_GROWTH: Final = 0.02
STALE_S: Final = 0.6
"""Age of a status at which a page shows the red bar: `STALE_MS` of main.js."""

_WORKERS: Final = 3
_LOOK_S: Final = 1.0
_PAGE_KB: Final = os.sysconf("SC_PAGE_SIZE") // 1024 if hasattr(os, "sysconf") else 4
_WAKE_S: Final = 0.05
_KEPT: Final = 300


@dataclass
class Soak:
    """Result of a soak."""

    seed: int
    minutes: float = 0.0
    acts: Counter[str] = field(default_factory=Counter)
    flights: Counter[str] = field(default_factory=Counter)
    lost_ticks: int = 0
    gaps: int = 0
    logs: int = 0
    statuses: int = 0
    oldest_s: float = 0.0
    bars: int = 0
    bars_of_computer: int = 0
    resumed: int = 0
    late_s: float = 0.0
    memory_kB: list[tuple[float, int]] = field(default_factory=list)
    twin: bool = False
    complaints: list[str] = field(default_factory=list)

    @property
    def good(self) -> bool:
        """Whether nothing was lost, and memory and age stayed within what is promised."""
        return not (self.lost_ticks or self.gaps) and self.growth() <= MAX_GROWTH and self.oldest_s <= STALE_S

    def growth(self) -> float:
        """Return by which share the memory has grown after the warm-up, or after half of a shorter soak."""
        # The medians of the first and of the last fifth of that time are compared.
        begin_s = min(WARM_UP_S, 30.0 * self.minutes)
        kB = [size for at_s, size in self.memory_kB if at_s >= begin_s]
        if len(kB) < 10:
            return 0.0
        fifth = len(kB) // 5
        return float(np.median(kB[-fifth:]) / np.median(kB[:fifth]) - 1.0)

    def table(self) -> list[str]:
        """Return the results as lines of a table."""
        rows = {
            "minutes": f"{self.minutes:.1f}",
            "flights that the pilot began": ", ".join(
                f"{n} {what}" for what, n in self.flights.most_common(8)
            ),
            "what clients did": ", ".join(f"{n} {what}" for what, n in self.acts.most_common()),
            "samples that the host lost": f"{self.lost_ticks}",
            f"samples missing in {self.logs} logs": f"{self.gaps}",
            "growth of the server's memory": f"{100.0 * self.growth():.2f} %",
            "memory at the end": f"{self.memory_kB[-1][1] / 1024.0:.0f} MB" if self.memory_kB else "-",
            "statuses": f"{self.statuses}",
            "oldest status that a page showed": f"{self.oldest_s:.2f} s",
            "red bars": f"{self.bars}, and {self.bars_of_computer} while the computer did not run the client",
            "latest waking of a sleeping thread": f"{self.late_s:.2f} s",
        }
        return ["| what | result |", "|---|---|", *(f"| {name} | {text} |" for name, text in rows.items())]


class Clients:
    """Actions of clients, one at a time."""

    def __init__(self, address: Address, lateness: Lateness) -> None:
        self._address = address
        self._lateness = lateness
        self.ages: list[dict[str, float]] = []

    def acts(self) -> dict[str, Callable[[random.Random], None]]:
        """Return the acts by name."""
        return {
            "open a page for a while": self._visits,
            "reload a page": self._reloads,
            "do not acknowledge": self._does_not_acknowledge,
            "do not read": self._does_not_read,
            "vanish": self._vanishes,
            "send nonsense": self._sends_nonsense,
            "send odd requests": self._odd_requests,
            "flood with signals": self._floods,
            "ask for control and leave": self._asks_and_leaves,
            "sample and mark": self._sound,
        }

    def _page(self, client: str = "") -> AgedPage:
        return AgedPage(self._address, self._lateness, client)

    def _visits(self, chance: random.Random) -> None:
        with self._page() as page:
            time.sleep(chance.uniform(0.3, 8.0))
        self.ages.append(vars_of(page.ages))

    def _reloads(self, chance: random.Random) -> None:
        name = f"tab{chance.randrange(100)}"
        for _ in range(3):
            with self._page(name):
                time.sleep(chance.uniform(0.0, 0.5))

    def _does_not_acknowledge(self, chance: random.Random) -> None:
        with self._page() as page:
            page.answers.clear()
            time.sleep(chance.uniform(1.0, 6.0))
        self.ages.append(vars_of(page.ages))

    def _raw(self, **more: Any) -> Any:
        address = self._address
        url = f"ws://{address.host}:{address.port}/ws?role=program&token={address.token}"
        return connect(url, compression=None, proxy=None, **more)

    def _does_not_read(self, chance: random.Random) -> None:
        with self._raw(max_queue=2) as opened:
            opened.send(json.dumps({"do": "hold", "id": 1}))
            time.sleep(chance.uniform(2.0, 15.0))
            _reset(opened.socket)

    def _vanishes(self, chance: random.Random) -> None:
        with contextlib.suppress(WebSocketException, OSError), self._raw() as opened:
            time.sleep(chance.uniform(0.0, 1.0))
            _reset(opened.socket)

    def _sends_nonsense(self, chance: random.Random) -> None:
        with contextlib.suppress(WebSocketException, OSError), self._raw() as opened:
            for _ in range(20):
                size = chance.choice((0, 1, 4, 5, 4000, 70_000))
                data = chance.randbytes(size)
                opened.send(data if chance.random() < 0.5 else data.decode("latin-1"))
                time.sleep(0.02)

    def _odd_requests(self, chance: random.Random) -> None:
        with heli_host.join(self._address.program) as program:
            for _ in range(30):
                request = hostile_request(chance, harmless=True)
                with contextlib.suppress(HeliError):
                    program.ask(request.pop("do"), **{k: v for k, v in request.items() if k != "timeout_s"})

    def _floods(self, chance: random.Random) -> None:
        with heli_host.join(self._address.program) as program:
            for number in range(200):
                with contextlib.suppress(HeliError):
                    program.signal(f"signal {number % 50}", chance.gauss(0.0, 1.0))

    def _asks_and_leaves(self, chance: random.Random) -> None:
        with heli_host.join(self._address.program) as program:
            program.ask_control(timeout_s=chance.uniform(0.0, 1.0))

    def _sound(self, chance: random.Random) -> None:
        with heli_host.join(self._address.program) as program:
            time.sleep(1.0)
            program.samples(last_s=1.0)
            program.mark("sound")


def _reset(opened: socket.socket) -> None:
    """Let a connection vanish: with this option a close sends a reset."""
    opened.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    opened.close()


class Sleepers:
    """Two tabs in a process that is suspended now and then."""

    def __init__(self, address: Address) -> None:
        words = (address.host, str(address.port), address.token, "2")
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.stress.soak", *words],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert self._process.stdin is not None and self._process.stdout is not None
        self._in, self._out = self._process.stdin, self._process.stdout
        self._out.readline()

    def sleep(self, duration_s: float) -> None:
        """Suspend it."""
        os.kill(self._process.pid, signal.SIGSTOP)
        try:
            time.sleep(duration_s)
        finally:
            os.kill(self._process.pid, signal.SIGCONT)

    def measured(self) -> list[dict[str, float]]:
        """Return the numbers of its tabs' `StatusAges`."""
        self._in.write("ages\n")
        self._in.flush()
        pages: list[dict[str, float]] = json.loads(self._out.readline())["pages"]
        return pages

    def close(self) -> None:
        """End it."""
        self._in.close()
        self._process.wait(10.0)
        self._out.close()


def soak(minutes: float, seed: int, say: Callable[[str], None] = print) -> Soak:
    """Keep a page's server busy."""
    result = Soak(seed)
    with tempfile.TemporaryDirectory(prefix="heli-soak-") as name:
        folder = Path(name)
        (folder / "short.toml").write_text(PLAN)
        arguments = ("--sil", "--board", "native", "--seed", str(seed), "--twin", "makki2024", "short.toml")
        with page_process(*arguments, folder=folder) as (process, url), _drained(process) as lines:
            keep_busy(result, _address_of(url), process.pid, minutes, say)
            if not result.twin:
                result.complaints.append("the twin does not run")
            process.send_signal(signal.SIGINT)
            try:
                process.wait(60.0)
            except subprocess.TimeoutExpired:
                result.complaints.append("the server does not end")
        traces = [line for line in lines if "Traceback" in line or "failed" in line]
        result.complaints += [f"the server printed: {line.strip()}" for line in traces]
        for path in sorted(folder.glob("flights/*/*.mcap")):
            log = read_log(path)
            tick = log.ticks["tick"].astype(np.int64)
            result.gaps += int((np.diff(tick) - 1).sum()) if len(tick) else 0
            result.logs += 1
            if not log.complete:
                result.complaints.append(f"{path.parent.name}/{path.name} is not complete: {log.notes}")
    return result


def keep_busy(result: Soak, address: Address, pid: int, minutes: float, say: Callable[[str], None]) -> None:
    """Let clients do what they do; see `soak`. The first client is the pilot."""
    lateness = Lateness()
    clients = Clients(address, lateness)
    over = threading.Event()
    lock = threading.Lock()

    def misbehave(worker: int) -> None:
        chance = random.Random(f"{result.seed} {worker}")
        acts = clients.acts()
        while not over.is_set():
            name = chance.choice(list(acts))
            try:
                acts[name](chance)
            except (HeliError, WebSocketException, OSError) as error:
                say(f"{name}: {type(error).__name__}: {error}")
                with lock:
                    result.acts[f"{name}: {type(error).__name__}"] += 1
            except Exception as error:  # noqa: BLE001 - it is what a soak looks for
                with lock:
                    result.complaints.append(f"{name}: {type(error).__name__}: {error}")
            else:
                with lock:
                    result.acts[name] += 1
            over.wait(chance.uniform(0.0, 1.0))

    def sleep_now_and_then() -> None:
        chance = random.Random(f"{result.seed} sleepers")
        while not over.wait(chance.uniform(2.0, 10.0)):
            # From 0.2 to 20 s; short ones are as frequent as long ones, by their logarithm.
            sleepers.sleep(0.2 * (20.0 / 0.2) ** chance.random())
            result.resumed += 1

    threads = [threading.Thread(target=misbehave, args=(number,)) for number in range(_WORKERS)]
    threads.append(threading.Thread(target=sleep_now_and_then))
    with AgedPage(address, lateness, "pilot") as pilot, AgedPage(address, lateness) as watcher:
        # The pilot is the first client.
        sleepers = Sleepers(address)
        begin_s = time.monotonic()
        for thread in threads:
            thread.start()
        try:
            _fly(result, pilot, pid, begin_s, begin_s + 60.0 * minutes, say)
        finally:
            over.set()
            for thread in threads:
                thread.join()
        result.lost_ticks = int(pilot.known["status"]["link"]["lost_ticks"])
        result.twin = bool(pilot.known["status"]["twin"])
        ages_of_sleepers = sleepers.measured()
        sleepers.close()
        ages_of_awake = (vars_of(pilot.ages), vars_of(watcher.ages), *clients.ages)
        for ages in (*ages_of_awake, *ages_of_sleepers):
            result.oldest_s = max(result.oldest_s, ages["oldest_s"])
            result.statuses += int(ages["received"])
        # Pages that sleep show bars because they sleep; those do not count.
        for ages in ages_of_awake:
            result.bars += int(ages["bars"])
            result.bars_of_computer += int(ages["bars_of_computer"])
    result.minutes = (time.monotonic() - begin_s) / 60.0
    result.late_s = lateness.worst_s


def _fly(
    result: Soak, pilot: AgedPage, pid: int, begin_s: float, end_s: float, say: Callable[[str], None]
) -> None:
    """Fly one plan after the other and look at the server's memory, until it is time."""
    number, told_s = 0, begin_s
    while (now_s := time.monotonic()) < end_s:
        result.memory_kB.append((now_s - begin_s, memory_kB(pid)))
        if now_s - told_s >= 60.0:
            told_s = now_s
            lost = pilot.known["status"]["link"]["lost_ticks"]
            say(
                f"{(now_s - begin_s) / 60.0:.0f} min: {result.memory_kB[-1][1] / 1024.0:.1f} MB,"
                f" {lost} samples lost, {result.flights.total()} flights, {result.acts.total()} acts"
            )
        if pilot.state == "fault":
            pilot.send("clear_fault")
        elif pilot.state == "idle" and not pilot.known["status"]["flight"] and end_s - now_s > 25.0:
            if number:
                result.flights[_outcome(pilot, number)] += 1
            number = pilot.send("fly", plans=["short"])
        pilot.until_or(lambda: False, _LOOK_S)
    pilot.send("land")
    pilot.until_or(lambda: pilot.state == "idle", 20.0)


def _outcome(pilot: AgedPage, number: int) -> str:
    answer = next((words for words in list(pilot.words) if words.get("answer") == number), {})
    return str(answer.get("outcome") or answer.get("error") or "no answer")[:60]


def memory_kB(pid: int) -> int:
    """Return the resident memory of a process [kB]; 0 if the system has no /proc."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * _PAGE_KB
    except (OSError, IndexError):
        return 0


def _address_of(url: str) -> Address:
    host, _, port = url.partition("://")[2].partition("/")[0].rpartition(":")
    return Address(host, int(port), url.partition("token=")[2])


@contextlib.contextmanager
def _drained(process: subprocess.Popen[str]) -> Iterator[list[str]]:
    """Read what the server prints, so that it never waits for a reader."""
    lines: list[str] = []
    stream = process.stdout
    assert stream is not None
    thread = threading.Thread(target=lambda: lines.extend(stream), daemon=True)
    thread.start()
    yield lines
    thread.join(5.0)


class Lateness:
    """How late this computer wakes a thread that only sleeps: its own share of every gap."""

    def __init__(self) -> None:
        self.worst_s = 0.0
        self.late: deque[tuple[float, float]] = deque(maxlen=1000)
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        before_s = time.monotonic()
        while True:
            time.sleep(_WAKE_S)
            now_s = time.monotonic()
            late_s = now_s - before_s - _WAKE_S
            if late_s > 0.1:
                self.late.append((before_s, now_s))
            self.worst_s = max(self.worst_s, late_s)
            before_s = now_s

    def during(self, begin_s: float, end_s: float) -> float:
        """Return how late wakings were between two moments, in all [s]."""
        return sum(
            until - since - _WAKE_S for since, until in list(self.late) if until > begin_s and since < end_s
        )


class StatusAges:
    """Ages of the statuses that one client has shown."""

    # A status holds the server's monotonic time, which all processes of a computer share. As a page does, a
    # client drops a status that is older than `STALE_S` when it comes.

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
