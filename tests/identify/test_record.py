"""A record for fitting: what it keeps of a flight, and what it knows of the time before."""

from __future__ import annotations

import math

import numpy as np
import pytest
from heli_host.flight import Flight
from heli_lab.identify import Problem, prepare
from heli_lab.identify.estimation_problem.initial_states import states_at
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import catalogue
from heli_sim.rig import load_rig

COUNT_RAD = 2 * np.pi / 4096
STEP_S = 0.002
ROWS = 10_000


def leaning(elevation_deg: float, pitch_deg: float) -> Flight:
    """Twenty seconds by formula, near level but for one second about the tenth."""
    t_s = np.linspace(0.0, STEP_S * (ROWS - 1), ROWS)
    bump = np.exp(-(((t_s - 10.0) / 0.5) ** 2))
    wave = 0.02 * np.sin(2 * np.pi * t_s / 3.0)
    angles = (math.radians(elevation_deg) * bump + wave, math.radians(pitch_deg) * bump + wave, 5.0 * wave)
    elevation, pitch, travel = (
        (COUNT_RAD * np.round(angle / COUNT_RAD)).astype(np.float64) for angle in angles
    )
    return Flight(t_s, 3.5 + wave, 3.5 - wave, elevation, pitch, travel)


@pytest.mark.parametrize(
    ("elevation_deg", "pitch_deg", "touches"),
    [(-14.0, -55.0, True), (-14.0, 55.0, True), (-14.0, 0.0, False), (0.0, -55.0, False)],
)
def test_an_arm_that_leans_far_reaches_the_table_with_its_lower_rotor(
    elevation_deg: float, pitch_deg: float, touches: bool
) -> None:
    record = prepare(leaning(elevation_deg, pitch_deg), load_rig("quanser-course"))
    cut = [(one.start_s, one.stop_s) for one in record.cuts if "table" in one.why]
    assert bool(cut) == touches
    assert all(start < 10.0 < stop for start, stop in cut)


@pytest.mark.medium
def test_thrust_at_the_beginning_of_a_segment_follows_the_voltages_before_it() -> None:
    rig, lag_s, since_s = load_rig("quanser-course"), 0.1, 0.05
    made = leaning(0.0, 0.0)
    begins = round(5.0 / STEP_S)
    low, high = 3.0, 4.0
    volts = np.where(np.arange(ROWS) < begins - round(since_s / STEP_S), low, high)
    flight = Flight(made.t_s, volts, volts + 0.1 * np.sin(made.t_s), *made.angles_rad.T)
    record = prepare(flight, rig, start_s=float(made.t_s[begins]))
    model = MultibodyModel((catalogue()["rotor_lag"].make({"rotor_lag_s": lag_s}),))
    problem = Problem(model, rig, [record])
    front_N = states_at(problem, 0, np.array([record.segments[0][0]]), problem.parameter_vector.start)[0, 6]
    gain, zero_V = rig["thrust_gain"].value, rig["dead_zone"].value
    reached_V = high - (high - low) * math.exp(-since_s / lag_s)
    assert front_N == pytest.approx(gain * (reached_V - zero_V), rel=1e-3)


def landing(held_V: float, ends_deg: float) -> Flight:
    """Twenty seconds at level, then a descent in two seconds that the log does not see the end of."""
    t_s = np.arange(0.0, 22.0, 0.01)
    down = np.clip(t_s - 20.0, 0.0, None) / 2.0
    wave = 0.02 * np.sin(3.0 * t_s)
    total_V = 3.4 + wave + down.clip(0.0, 0.05) / 0.05 * (held_V - 3.4)
    elevation_rad = np.round((wave + np.radians(ends_deg) * down) * 4096 / (2 * np.pi)) * 2 * np.pi / 4096
    return Flight(
        t_s, total_V / 2, total_V / 2, elevation_rad, 0 * t_s, np.round(t_s * 65) * 2 * np.pi / 4096
    )


@pytest.mark.parametrize(
    ("held_V", "ends_deg", "cut"), [(0.5, -14.0, True), (3.2, -14.0, False), (0.5, -2.0, False)]
)
def test_landing_that_the_log_does_not_show_to_its_end_is_cut(
    held_V: float, ends_deg: float, cut: bool
) -> None:
    record = prepare(landing(held_V, ends_deg), load_rig("makki2024"))
    assert bool(record.cuts) == cut
    if cut:
        assert record.cuts[-1].start_s == pytest.approx(20.1, abs=0.25)
        assert record.cuts[-1].stop_s == pytest.approx(22.0, abs=0.02)
