"""A twin finds what changed in a flight, names it, measures it; live as afterwards, and lands if asked to."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import pytest
from heli_host.cli import run
from heli_host.log.reader import Log, read_log
from heli_lab.twin.files import open_rig
from heli_lab.twin.live import open_twin
from heli_lab.twin.monitor import TwinReport, monitor_file

pytestmark = pytest.mark.slow
CHANGED_s = 12.0
PLAN = """
title = "Short"
[start]
elevation_deg = 0
rate_deg_s = 12
settle_s = 1
[[segment]]
kind = "sine"
travel_amplitude_deg = 20
travel_period_s = 14
elevation_amplitude_deg = 5
elevation_period_s = 8
duration_s = 15
"""


@cache
def flown() -> tuple[Path, int]:
    """A flight whose front rotor loses 8 % of its thrust, with a twin that lands it; and how it ended."""
    folder = Path(mkdtemp())
    (folder / "short.toml").write_text(PLAN)
    log = folder / "flight.mcap"
    words = f"fly {folder / 'short.toml'} --sil --speed max --effect thrust_step.front=0.08@{CHANGED_s:g}"
    code = run([*words.split(), "--twin", "makki2024", "--on-alarm", "land", "--log", str(log)])
    return log, code


@cache
def logged() -> tuple[Log, TwinReport]:
    path, _ = flown()
    return read_log(path), monitor_file(open_rig("makki2024"), path, 10.0)


def test_the_change_is_found_named_and_measured() -> None:
    log, seen = logged()
    (named,) = seen.alarms
    first = named.ranking[0]
    motors_s = float(log.ticks["t_s"][np.flatnonzero(log.flight().front_V > 0)[0]])
    assert first.change.id == "thrust_step.front"
    assert abs(first.size - 0.08) < 3 * first.std
    assert abs(named.onset_s - (motors_s + CHANGED_s)) < 1.0
    assert "the front rotor lost" in named.text and "times more likely than the next" in named.text


def test_the_flight_ends_in_a_landing_and_says_why() -> None:
    _, code = flown()
    log, _ = logged()
    words = [str(event["message"]) for event in log.events if event["name"] == "twin"]
    phases = [str(event["message"]) for event in log.events if event["name"] == "phase"]
    assert code != 0
    assert any(text.startswith("alarm at") for text in words)
    assert phases[-1] == "landing"
    # Before the plan would have ended it.
    assert log.ticks["t_s"][-1] < 21.0


def test_live_and_afterwards_are_the_same_tick_for_tick() -> None:
    log, seen = logged()
    twin = open_twin("makki2024")(log.parameters, 10.0)
    number = int(log.ticks["tick"][0]) + np.rint(log.ticks["t_s"] / 1e-3).astype(np.int64)
    rng, low, live = np.random.default_rng(1), 0, []
    while low < len(number):
        high = low + int(rng.integers(1, 150))
        live += twin.update(number[low:high], log.raw[low:high])
        low = high
    afterwards = [event for event in seen.events if event.kind != "diagnosed" or event.ranking]
    zero = int(number[0])
    assert [news.kind for news in live] == [event.kind for event in afterwards]
    assert [news.tick - zero for news in live] == [round(event.t_s * 1e3) for event in afterwards]


def test_what_the_log_has_of_it_came_at_these_ticks() -> None:
    log, seen = logged()
    written = [float(event["t_s"]) for event in log.events if str(event["message"]).startswith("alarm at")]
    alarms = [event.t_s for event in seen.events if event.kind == "alarm"]
    # A step of 10 ms is reported when it is complete, and a batch of ticks comes at once.
    assert 0.0 <= written[0] - alarms[0] < 0.06


def test_nothing_is_said_of_a_part_before_the_change() -> None:
    path, _ = flown()
    before = monitor_file(open_rig("makki2024"), path, 10.0, stop_s=CHANGED_s)
    assert before.free_s > 5.0 and not before.alarms
