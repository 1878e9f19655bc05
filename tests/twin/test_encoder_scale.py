"""A twin names in flight the encoder whose counts per turn are wrong."""

from __future__ import annotations

from pathlib import Path

import pytest
from heli_host.data.log.reader import read_log
from heli_host.ui.cli import run
from heli_lab.watch.calibration import open_rig
from heli_lab.watch.monitor import monitor_file

pytestmark = pytest.mark.slow
FALSE_ALARM_INTERVAL_h = 10.0
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


def fly_with_scale(folder: Path, encoder_scale: str) -> Path:
    """Fly `PLAN` in simulation with a twin; `encoder_scale` is such as ``travel:0.5``. Return the log."""
    plan, log = folder / "short.toml", folder / "flight.mcap"
    plan.write_text(PLAN)
    port = f"sil://?encoder_scale={encoder_scale}"
    run(["fly", str(plan), "--log", str(log), "--twin", "makki2024", "--port", port])
    return log


def test_half_the_counts_of_travel_are_named_in_flight(tmp_path: Path) -> None:
    log = fly_with_scale(tmp_path, "travel:0.5")
    messages = [str(event["message"]) for event in read_log(log).events if event["name"] == "twin"]
    (alarm,) = monitor_file(open_rig("makki2024"), log, FALSE_ALARM_INTERVAL_h).alarms
    most_likely = alarm.ranking[0]
    assert most_likely.change.id == "encoder_scale.travel"
    # The estimate of so large a change is approximate, because the twin is linearised.
    assert -1.0 < most_likely.size < -0.25
    assert any(
        "the travel encoder counts" in message and "fewer than its counts" in message for message in messages
    )


def test_right_scales_are_no_change(tmp_path: Path) -> None:
    log = fly_with_scale(tmp_path, "travel:1")
    report = monitor_file(open_rig("makki2024"), log, FALSE_ALARM_INTERVAL_h)
    assert report.free_s > 10.0 and not report.alarms
