"""No healthy flight is taken for one with a plug off; what is noticed, and when, is in `fault_table.py`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from heli_host.board.parameters import load_gains
from heli_host.declaration import PARAMS, Axes, Fault, State
from heli_host.errors import HeliError
from heli_host.fly.connection import connect
from heli_host.fly.plan import Plan, load_plan
from heli_host.fly.runner import fly
from heli_host.fly.tracking import NOT_TRACKED
from heli_sim.rig import write_rig

from tests.fly.plug_sweep import random_rig
from tests.running.long import samples

pytest.importorskip("heli_sim._native", reason="skipped: the simulation is not built")

pytestmark = pytest.mark.slow

OFF = {
    spec.name: spec.max
    for spec in PARAMS
    if spec.name.endswith(("_following_max_deg", "_motion_V", "travel_motion_deg"))
}
"""Parameters with which no following error and no drive without motion trips."""
NEW = frozenset(fault for fault in Fault if fault.name.endswith(("_FOLLOWING", "_MOTIONLESS")))
EVERY_AXIS = Plan.parse(
    """
[start]
settle_s = 2
[[segment]]
kind = "sine"
elevation_amplitude_deg = 6
elevation_period_s = 7
travel_amplitude_deg = 15
travel_period_s = 14
duration_s = 14
[[segment]]
kind = "step"
travel_deg = 15
elevation_deg = 6
duration_s = 5
""",
    "every axis",
)


def test_an_emergency_landing_is_left_by_stop_only_and_nothing_is_flown_on(tmp_path: Path) -> None:
    with connect("sil://?speed=max&encoder_out=travel:3") as heli:
        heli.arm()
        heli.control()
        heli.setpoint(elevation_deg=0.0)
        heli.wait(6.0)
        heli.setpoint(travel_deg=40.0)
        heli.wait_until(lambda sample: sample.state is State.EMERGENCY_LANDING, 20.0)
        with pytest.raises(HeliError, match="emergency_landing"):
            heli.control()
        heli.wait_until(lambda sample: sample.state is State.FAULT, 20.0)
        assert heli.latest.fault is Fault.TRAVEL_MOTIONLESS


def outcome(
    rig: Path | str, plan: Plan, prepare: dict[str, float], log: Path, gains: str | None = None
) -> str:
    log.unlink(missing_ok=True)
    with connect(f"sil://?rig={rig}&seed=3&speed=max") as heli:
        load_gains(heli.params, gains)
        for name, value in prepare.items():
            heli.params[name] = value
        return fly(heli, plan, log_path=log).outcome


def tripped(text: str) -> bool:
    return any(fault.name.lower() in text for fault in NEW)


# Each plan and each set of gains once in `make test`.
@pytest.mark.parametrize(
    ("plan", "gains"),
    [("step", None), ("identify", "paper"), ("step", "paper"), ("identify", None)][: samples(4, 2)],
)
def test_no_built_in_plan_trips_on_the_papers_rig(plan: str, gains: str | None, tmp_path: Path) -> None:
    text = outcome("makki2024", load_plan(plan), {}, tmp_path / "a.mcap", gains)
    assert not tripped(text)
    assert gains is not None or text == "completed"


def test_no_healthy_flight_of_a_random_rig_trips(tmp_path: Path) -> None:
    chance = np.random.default_rng(12)
    healthy = 0
    for number in range(samples(200, 8)):
        rig = random_rig("makki2024", chance)
        if rig is None:
            continue
        path = tmp_path / "rig.toml"
        path.unlink(missing_ok=True)
        write_rig(rig, path)
        text = outcome(path, EVERY_AXIS, {}, tmp_path / "a.mcap")
        if tripped(text):
            without = outcome(path, EVERY_AXIS, OFF, tmp_path / "a.mcap")
            assert without != "completed", f"seed 12, rig {number}: {text}"
        healthy += text == "completed"
    assert healthy >= 0.8 * samples(200, 8)


def test_a_hover_that_hangs_low_is_not_tracked(tmp_path: Path) -> None:
    weak = {"elevation_integral_max_V": 0.0, "hover_V": 0.8, "elevation_kp": 0.03}
    text = outcome("makki2024", load_plan("hover"), weak, tmp_path / "a.mcap")
    assert text.startswith(f"{NOT_TRACKED}: elevation was up to")
    wide = Plan.parse(load_plan("hover").text + "\n[tolerance]\nelevation_deg = 20\n", "wide")
    assert outcome("makki2024", wide, weak, tmp_path / "b.mcap") == "completed"


def test_a_bench_in_open_loop_is_left_alone() -> None:
    with connect("sil://?speed=max&supply_out=0") as heli:
        heli.arm()
        heli.control(Axes(0), 5.0, 5.0)
        heli.wait(3.0)
        assert heli.state is State.OPEN_LOOP
