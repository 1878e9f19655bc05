"""Metrics of flights, and several of them on one page."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from heli_host.flight import Flight
from heli_host.flight.response import effort_V, responses
from heli_host.log.table import write_csv

from tests.cli.terminal import Terminal, refusal, terminal

__all__ = ["terminal"]

pytestmark = pytest.mark.medium

NATURAL_rad_s, DAMPING, STEP_deg, AT_s = 3.0, 0.4, 20.0, 5.0


def second_order(state: bool = True, ramp_s: float = 0.0) -> Flight:
    """Travel steps as a linear oscillator does, whose metrics every textbook has; elevation stays."""
    t_s = np.arange(0.0, 20.0, 0.002)
    since = np.maximum(t_s - AT_s, 0.0)
    decay, fast = DAMPING * NATURAL_rad_s, NATURAL_rad_s * math.sqrt(1.0 - DAMPING**2)
    share = 1.0 - np.exp(-decay * since) * (np.cos(fast * since) + decay / fast * np.sin(fast * since))
    wanted = np.clip(since / ramp_s, 0.0, 1.0) if ramp_s else (t_s >= AT_s).astype(float)
    zero = np.zeros_like(t_s)
    return Flight(
        t_s,
        zero + 1.5,
        zero + 2.5,
        zero + 0.01,
        zero,
        np.deg2rad(STEP_deg) * share,
        elevation_setpoint_rad=zero,
        pitch_setpoint_rad=zero,
        travel_setpoint_rad=np.deg2rad(STEP_deg) * wanted,
        state=np.full(len(t_s), 4, np.uint8) if state else None,
        state_names={4: "closed_loop", 0: "idle"},
    )


@pytest.mark.parametrize("ramp_s", [0.0, 0.4])
def test_metrics_of_a_step_are_those_of_the_textbook(ramp_s: float) -> None:
    elevation, pitch, travel = responses(second_order(ramp_s=ramp_s))
    overshoot = 100.0 * math.exp(-math.pi * DAMPING / math.sqrt(1.0 - DAMPING**2))
    assert travel.step_s == pytest.approx(AT_s, abs=0.005)
    assert travel.step_deg == pytest.approx(STEP_deg)
    assert travel.overshoot_percent == pytest.approx(overshoot, abs=0.1)
    # Of a second-order system with this damping: rise 10 to 90 % at 1.463 / w, by its closed form.
    share = np.rad2deg(second_order().travel_rad) / STEP_deg
    t_s = second_order().t_s
    rise_s = t_s[np.argmax(share > 0.9)] - t_s[np.argmax(share > 0.1)]
    assert travel.rise_s == pytest.approx(rise_s, abs=0.005)
    outside = np.flatnonzero(np.abs(share[t_s >= AT_s] - 1.0) > 0.05)
    assert travel.settling_s == pytest.approx(t_s[outside[-1]], abs=0.01)
    assert elevation.rms_deg == pytest.approx(math.degrees(0.01))
    assert math.isnan(elevation.rise_s)
    assert pitch.rms_deg == 0.0


def test_effort_is_the_rms_voltage_under_control_alone() -> None:
    flight = second_order()
    assert effort_V(flight) == pytest.approx(math.sqrt((1.5**2 + 2.5**2) / 2.0))
    assert flight.state is not None
    flight.state[:] = 0
    assert math.isnan(effort_V(flight))
    assert all(math.isnan(one.rms_deg) for one in responses(flight))


def test_step_that_does_not_settle_has_no_settling_time() -> None:
    (_, _, travel) = responses(second_order().between(0.0, AT_s + 1.2))
    assert math.isnan(travel.settling_s)
    assert travel.overshoot_percent > 0.0


def test_flights_are_laid_over_each_other_with_their_metrics(terminal: Terminal) -> None:
    for name in ("a", "b"):
        write_csv(second_order(state=False), f"{name}.csv")
    ended = terminal("plot", "a.csv", "b.csv", "-o", "both.png")
    assert ended.code == 0, ended
    assert Path("both.png").read_bytes().startswith(b"\x89PNG")
    head, *rows = ended.out.splitlines()
    assert head.split()[:2] == ["flight", "axis"]
    assert [row.split()[0] for row in rows if row[0] != " "] == ["a.csv", "b.csv", "files:"]
    numbers = json.loads(terminal("plot", "a.csv", "b.csv", "--json").out)
    assert numbers["figure"] is None
    assert numbers["flights"][0]["axis"]["travel"]["step_deg"] == pytest.approx(STEP_deg, rel=1e-3)
    assert numbers["flights"][0]["axis"]["elevation"]["rise_s"] is None


def test_too_many_and_the_same_twice_are_refused(terminal: Terminal) -> None:
    write_csv(second_order(), "a.csv")
    assert "twice" in refusal(terminal("plot", "a.csv", "a.csv"), code=2)
    assert "cannot be told apart" in refusal(terminal("plot", *(f"{i}.csv" for i in range(9))), code=2)


def test_figure_in_no_format_that_can_be_drawn_is_one_line(terminal: Terminal) -> None:
    write_csv(second_order(), "a.csv")
    write_csv(second_order(), "b.csv")
    assert "both.txt" in refusal(terminal("plot", "a.csv", "b.csv", "-o", "both.txt"), code=5)
