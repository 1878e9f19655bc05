"""A twin names in flight the encoder whose counts per turn are wrong."""

from __future__ import annotations

from pathlib import Path

import pytest
from heli_host.cli import run
from heli_host.log.reader import read_log
from heli_lab.twin.files import open_rig
from heli_lab.twin.monitor import monitor_file

pytestmark = pytest.mark.slow
PLAN = """
title = "Short"
[start]
elevation_deg = 0
rate_deg_s = 12
settle_s = 2
[[segment]]
kind = "sine"
travel_amplitude_deg = 12
travel_period_s = 12
elevation_amplitude_deg = 4
elevation_period_s = 8
duration_s = 14
excite = { signal = "multisine", front_V = 0.3, back_V = 0.3, start_Hz = 0.1, stop_Hz = 3 }
"""


def flown(folder: Path, scale: str) -> Path:
    (folder / "short.toml").write_text(PLAN)
    log = folder / "flight.mcap"
    run(
        [
            *("fly", str(folder / "short.toml"), "--log", str(log), "--twin", "makki2024"),
            *("--port", f"sil://?encoder_scale={scale}"),
        ]
    )
    return log


def test_half_the_counts_of_travel_are_named_in_flight(tmp_path: Path) -> None:
    log = flown(tmp_path, "travel:0.5")
    said = [str(event["message"]) for event in read_log(log).events if event["name"] == "twin"]
    (named,) = monitor_file(open_rig("makki2024"), log, 10.0).alarms
    first = named.ranking[0]
    assert first.change.id == "encoder_scale.travel"
    # Linear in a change this large: its sign and its order are right.
    assert -1.0 < first.size < -0.25
    assert any("the travel encoder counts" in text and "fewer than its counts" in text for text in said)


def test_right_scales_are_no_change(tmp_path: Path) -> None:
    seen = monitor_file(open_rig("makki2024"), flown(tmp_path, "travel:1"), 10.0)
    assert seen.free_s > 10.0 and not seen.alarms
