"""A twin names the encoder whose counts per turn are wrong, in the flight, and is silent if they are right."""

from __future__ import annotations

from pathlib import Path

import pytest
from heli_host.cli import run
from heli_host.log.reader import read_log
from heli_lab.twin.files import open_rig
from heli_lab.twin.follow import follow_file

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


@pytest.mark.parametrize(("axis", "scale"), [("travel", 0.5), ("pitch", 0.5)])
def test_a_wrong_scale_is_named_in_flight(axis: str, scale: float, tmp_path: Path) -> None:
    log = flown(tmp_path, f"{axis}:{scale:g}")
    said = [str(event["message"]) for event in read_log(log).events if event["name"] == "twin"]
    (named,) = follow_file(open_rig("makki2024"), log, 10.0).alarms
    first = named.ranking[0]
    assert first.change.id == f"encoder_scale.{axis}"
    # A share of the twin's own counts, linearised: large ones have the right sign and order only.
    assert -1.2 < first.size < -0.25
    assert f"the {axis} encoder counts" in said[-1] and "fewer than its counts per turn" in said[-1]


def test_right_scales_are_no_change(tmp_path: Path) -> None:
    seen = follow_file(open_rig("makki2024"), flown(tmp_path, "travel:1"), 10.0)
    assert seen.free_s > 10.0 and not seen.alarms
