"""A flight is completed only if the angles at rest are those of before the take-off."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import heli_host
import numpy as np
import pytest
from heli_host.board.rest_check import ANGLE_SHIFTED, HoverTilt, RestAngles
from heli_host.board.samples import Samples
from heli_host.declaration import State
from heli_host.errors import FlightAborted
from heli_host.fly.plan import Plan
from heli_host.fly.runner import fly

from tests.fly.slip import PITCH, slipping

pytestmark = pytest.mark.medium

PLAN = Plan.parse('[start]\nsettle_s = 2\n[[segment]]\nkind = "hold"\nduration_s = 9\n', "hold.toml")
COUNT_DEG = 0.1


def after(elevation_deg: object, pitch_deg: object, length_s: float = 20.0) -> Samples:
    """The samples since a landing, with constant angles or functions of the time in s."""
    tick = np.arange(round(length_s * 1e3))
    columns: dict[str, Any] = {field: np.zeros(len(tick)) for field in Samples.__dataclass_fields__}
    for name, value in (("elevation_rad", elevation_deg), ("pitch_rad", pitch_deg)):
        columns[name] = np.radians(value(tick * 1e-3) if callable(value) else np.full(len(tick), value))
    return Samples(**{**columns, "tick": tick})


BEFORE = RestAngles(-25.0, 0.0, COUNT_DEG, HoverTilt(COUNT_DEG))


@pytest.mark.parametrize(
    ("elevation_deg", "pitch_deg", "axes"),
    [
        (-24.8, 0.9, ()),
        (-26.1, 0.0, ("elevation",)),
        (-23.9, 0.0, ("elevation",)),
        (-25.0, 1.1, ("pitch",)),
        (-26.5, -4.0, ("elevation", "pitch")),
    ],
)
def test_an_axis_that_rests_more_than_a_degree_off_is_named(
    elevation_deg: float, pitch_deg: float, axes: tuple[str, ...]
) -> None:
    text = BEFORE.shift_after(after(elevation_deg, pitch_deg))
    assert text is not None
    assert bool(text) == bool(axes)
    for axis in ("elevation", "pitch"):
        assert (f"{axis} at rest was" in text) == (axis in axes)


@pytest.mark.parametrize(("hover_deg", "is_shifted"), [(-8.0, False), (0.0, True)])
def test_a_tilt_of_the_hover_that_friction_holds_is_not_accused(hover_deg: float, is_shifted: bool) -> None:
    hover = HoverTilt(COUNT_DEG)
    hover.mean_deg = hover_deg
    text = replace(BEFORE, hover=hover).shift_after(after(-25.0, -8.9))
    assert text is not None
    assert bool(text) is is_shifted


def test_an_arm_that_floats_up_without_voltage_is_not_accused() -> None:
    floating = after(lambda t_s: -23.7 + np.minimum(5.0, 3.0 * t_s), 0.0)
    assert BEFORE.shift_after(floating) == ""


def test_a_swing_about_the_old_angle_is_waited_for_and_not_accused() -> None:
    swing = lambda t_s: 3.0 * np.exp(-t_s / 2.0) * np.cos(2.0 * t_s)  # noqa: E731
    assert BEFORE.shift_after(after(-25.0, swing, 1.0)) is None
    assert BEFORE.shift_after(after(-25.0, swing)) == ""


def test_a_swing_about_another_angle_is_found_although_it_begins_at_the_old_one() -> None:
    swing = lambda t_s: 3.0 - 3.0 * np.exp(-t_s / 2.0) * np.cos(2.0 * t_s)  # noqa: E731
    assert BEFORE.shift_after(after(-25.0, swing, 1.0)) is None
    text = BEFORE.shift_after(after(-25.0, swing))
    assert text and "pitch" in text


def test_an_endless_swing_is_judged_by_its_middle() -> None:
    for middle_deg, shifted in ((0.5, False), (5.0, True)):
        text = BEFORE.shift_after(after(-25.0, lambda t_s, m=middle_deg: m + 2.0 * np.sin(3.0 * t_s)))
        assert text is not None
        assert bool(text) is shifted


def test_a_flight_whose_pitch_encoder_slipped_is_not_completed(tmp_path: Path) -> None:
    with heli_host.connect("sil://?seed=3") as heli:
        heli.wait(0.6)
        slip = slipping(heli, PITCH, 4.0)
        summary = fly(heli, PLAN, on_progress=lambda progress: slip() if progress.t_s > 6.0 else None)
    assert summary.outcome.startswith(f"{ANGLE_SHIFTED}: pitch at rest was 0.0 degrees")
    assert not summary.completed


def test_a_flight_by_hand_ends_with_the_same_error() -> None:
    with heli_host.connect("sil://?seed=3") as heli:
        heli.wait(0.6)
        heli.take_off()
        slip = slipping(heli, PITCH, -4.0)
        heli.wait(3.0)
        for _ in heli.pace(0.05, 3.0):
            slip()
        with pytest.raises(FlightAborted, match=f"{ANGLE_SHIFTED}: pitch at rest"):
            heli.land()
        assert heli.state is State.IDLE


@pytest.mark.parametrize(
    "effect",
    [
        "coulomb_friction.travel",
        "coulomb_friction.pitch",
        "backlash.pitch",
        "counterweight_shift",
        "random_torque.pitch",
    ],
)
def test_a_healthy_rig_with_an_effect_is_completed(effect: str) -> None:
    with heli_host.connect(f"sil://?seed=1&effect={effect}") as heli:
        assert fly(heli, PLAN).outcome == "completed"
