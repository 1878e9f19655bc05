"""The page that flies in a browser: speed, stop, memory and start, and a diagnosis of its logs."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from tests.bench.result import Measured

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

PRESSES: Final = 50
OPENINGS: Final = 5
WATCHED_S: Final = 8.0
LAG_S: Final = 0.08
HOUR_SPEED: Final = 20.0
FIRST_MINUTES, ALL_MINUTES = 10.0, 60.0

READY: Final = """
const seen = setInterval(() => {
  if (document.querySelector("#take-off")?.disabled !== false || !window.heliPage?.status) return;
  window.readyMs = performance.now();
  clearInterval(seen);
}, 5);
"""
"""Notes when the page permits a take-off, in ms since it was opened."""
STOP: Final = """async () => {
  const startMs = performance.now(), volts = (channel) => heliPage.history.latest(channel);
  document.body.dispatchEvent(new KeyboardEvent("keydown", {key: " ", code: "Space", bubbles: true}));
  while (volts(6) !== 0 || volts(7) !== 0) await new Promise((settle) => setTimeout(settle, 1));
  return performance.now() - startMs;
}"""
"""Presses Space; returns the time until the newest sample shows both motors without voltage [ms]."""


def tell(page: Page, news: dict[str, Any]) -> None:
    """Send a message to the worker of the page."""
    page.evaluate("news => heliLab.tellWorker(news)", news)


def take_off(page: Page) -> None:
    """Take off, and wait until the motors run; a refusal is followed by another attempt."""
    while not page.evaluate("heliPage.status.state === 2 && heliPage.history.latest(6) > 0.5"):
        tell(page, {"text": json.dumps({"do": "take_off", "id": "bench"})})
        page.wait_for_timeout(300)


@contextmanager
def opened(browser: Browser, page: Path, address: str) -> Iterator[Page]:
    """Open the page without a network, wherever its file is."""
    from tests.page.browser import tabs

    with tabs(browser, offline=True) as window:
        window.context.add_init_script(READY)
        yield window.open(f"{page.as_uri()}#{address}")


def start_s(browser: Browser, page: Path) -> float:
    """Seconds from the opening of the page until a take-off is possible."""
    with opened(browser, page, "") as tab:
        while tab.evaluate("window.readyMs ?? 0") == 0:
            tab.wait_for_timeout(20)
        return float(tab.evaluate("readyMs")) * 1e-3


def renderers(browser: Browser) -> list[dict[str, Any]]:
    """The processes that show pages."""
    every = browser.new_browser_cdp_session().send("SystemInfo.getProcessInfo")["processInfo"]
    return [process for process in every if process["type"] == "renderer"]


def busy_s(browser: Browser) -> float:
    """Processor time of all processes that show pages [s]."""
    return sum(float(process["cpuTime"]) for process in renderers(browser))


def speed(browser: Browser, page: Path, address: str, plan: str = "") -> tuple[float, float]:
    """Fly a hover, or a plan that is recorded, as fast as possible."""
    # Returns simulated seconds per second, and per second of the page's own processor time.
    with opened(browser, page, address) as tab:
        if plan:
            tell(tab, {"text": json.dumps({"do": "fly", "id": "bench", "plans": [plan] * 80})})
        else:
            take_off(tab)
        tell(tab, {"lab": {"speed": 1e4}})
        tab.wait_for_timeout(1000)
        before, from_s, from_busy_s = (
            tab.evaluate("heliPage.history.latestTick"),
            time.monotonic(),
            busy_s(browser),
        )
        tab.wait_for_timeout(WATCHED_S * 1e3)
        flown_s = float(tab.evaluate("heliPage.history.latestTick") - before) * 1e-3
        spent_s = busy_s(browser) - from_busy_s
        passed_s = time.monotonic() - from_s
        assert tab.evaluate("heliPage.status.state") == 2, "the flight ended early"
        return flown_s / passed_s, flown_s / spent_s


def stop_ms(browser: Browser, page: Path, board: str) -> list[float]:
    """Times from a press of Space until the motors are without voltage [ms]."""
    with opened(browser, page, f"board={board}") as tab:
        times = []
        for _ in range(PRESSES):
            take_off(tab)
            times.append(float(tab.evaluate(STOP)))
        return times


def memory_MB(browser: Browser) -> float:
    """Resident memory of all processes that show pages [MB]; Linux only."""
    pages = [Path(f"/proc/{process['id']}/statm") for process in renderers(browser)]
    return sum(int(path.read_text().split()[1]) for path in pages) * os.sysconf("SC_PAGE_SIZE") * 1e-6


def hour(browser: Browser, page: Path, minutes: tuple[float, float]) -> tuple[float, float]:
    """Hover; return how much memory grew between two minutes of the simulation [1], and the lost ticks."""
    used_MB = []
    with opened(browser, page, f"speed={HOUR_SPEED:g}") as tab:
        take_off(tab)
        for minute in minutes:
            while tab.evaluate("heliPage.history.latestTick") < minute * 6e4:
                tab.wait_for_timeout(200)
            tab.context.new_cdp_session(tab).send("HeapProfiler.collectGarbage")
            used_MB.append(memory_MB(browser))
        lost = tab.evaluate("heliPage.status.link.lost_ticks + heliPage.history.gaps")
    return used_MB[1] / used_MB[0] - 1.0, float(lost)


def measure_web(say: Callable[[str], None]) -> list[Measured]:
    """Measure the page in Chromium."""
    from tests.page.browser import chromium
    from tests.web.pages import write_whole_page

    measured = []
    with TemporaryDirectory() as folder, chromium() as browser:
        page = write_whole_page(Path(folder))
        measured.append(Measured("web_start_s", [start_s(browser, page) for _ in range(OPENINGS)]))
        for name, address, plan in (
            ("native", "", ""),
            ("native_recorded", "", "sine"),
            ("due", "board=due", ""),
        ):
            times_realtime, times_cpu = speed(browser, page, address, plan)
            measured.append(Measured(f"web_{name}_x_realtime", [times_realtime]))
            measured.append(Measured(f"web_{name}_x_cpu", [times_cpu]))
        for board in ("native", "due"):
            times = stop_ms(browser, page, board)
            measured.append(Measured(f"web_stop_p99_{board}_ms", [float(np.percentile(times, 99))]))
        say(f"      hovering for an hour at {HOUR_SPEED:g} times real time")
        grown, lost = hour(browser, page, (FIRST_MINUTES, ALL_MINUTES))
    return [*measured, Measured("web_memory_growth", [grown]), Measured("web_ticks_lost", [lost])]


def hidden_lag(folder: Path) -> tuple[str, float, float]:
    """Diagnose a lag of the rotors from two logs of the small host."""
    from heli_host.fly.plan import load_plan
    from heli_sim.rig import load_rig
    from heli_web.facts import page_facts
    from playwright._impl._driver import compute_driver_executable

    from tests.bench.board import RIG
    from tests.web.pages import board_module
    from tests.web.recording import run_piece

    plans = [load_plan(name) for name in ("sine", "step")]
    facts = page_facts(plans, {plan.name: tomllib.loads(plan.text) for plan in plans}, [load_rig(RIG)])
    logs, node = [], str(compute_driver_executable()[0])
    for seed, plan in enumerate(plans, 1):
        logs.append(folder / f"{plan.name}.mcap")
        settings = {"effect": "rotor_lag", "values": {"rotor_lag.s": LAG_S}, "seed": seed}
        given = {"board": str(board_module()), "facts": facts, "settings": settings, "plans": [plan.name]}
        run_piece(node, "fly", given | {"log": str(logs[-1])})
    written = folder / "diagnosis.json"
    words = ["diagnose", str(logs[0]), "--validate", str(logs[1]), "--rig", RIG, "--json", str(written)]
    program = [sys.executable, "-c", "from heli_host.ui.cli import main; main()"]
    subprocess.run([*program, *words], check=True, cwd=folder, capture_output=True)
    cause = json.loads(written.read_text())["causes"][0]
    size = next(iter(cause["parameters"].values()))
    return cause["effect"], size["value"], size["std"]


def measure_web_diagnosis(_: Callable[[str], None]) -> list[Measured]:
    """Compare the hidden lag with the diagnosed one, in standard errors."""
    with TemporaryDirectory() as folder:
        name, size_s, std_s = hidden_lag(Path(folder))
    is_named = name == "rotor_lag"
    return [Measured("web_lag_error_std", [abs(size_s - LAG_S) / std_s if is_named else float("inf")])]
