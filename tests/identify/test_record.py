"""Records for fitting: which parts of a log are cut out, and from which states its segments start."""

from __future__ import annotations

import math

import numpy as np
import pytest
from heli_host.data.flight import Flight
from heli_lab.fit.problem import Problem, states_at
from heli_lab.fit.records import prepare
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import catalogue
from heli_sim.rig import load_rig

COUNT_RAD = 2 * np.pi / 4096
STEP_S = 0.002
ROWS = 10_000


def leaning(elevation_deg: float, pitch_deg: float) -> Flight:
    """Make twenty seconds near level, in which the arm leans by these angles for about a second at 10 s."""
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
    cuts = [cut for cut in record.cuts if "table" in cut.why]
    assert bool(cuts) == touches
    assert all(cut.start_s < 10.0 < cut.stop_s for cut in cuts)


@pytest.mark.medium
def test_thrust_at_the_beginning_of_a_segment_follows_the_voltages_before_it() -> None:
    rig, lag_s = load_rig("quanser-course"), 0.1
    level = leaning(0.0, 0.0)
    # The voltage steps up shortly before the segment begins, so the thrust has not reached its final value.
    first_row, step_before_s = round(5.0 / STEP_S), 0.05
    low_V, high_V = 3.0, 4.0
    volts = np.where(np.arange(ROWS) < first_row - round(step_before_s / STEP_S), low_V, high_V)
    flight = Flight(level.t_s, volts, volts + 0.1 * np.sin(level.t_s), *level.angles_rad.T)
    record = prepare(flight, rig, start_s=float(level.t_s[first_row]))
    model = MultibodyModel((catalogue()["rotor_lag"].make({"rotor_lag_s": lag_s}),))
    problem = Problem(model, rig, [record])
    front_N = states_at(problem, 0, np.array([record.segments[0][0]]), problem.parameter_vector.start)[0, 6]
    gain, zero_V = rig["thrust_gain"].value, rig["dead_zone"].value
    reached_V = high_V - (high_V - low_V) * math.exp(-step_before_s / lag_s)
    assert front_N == pytest.approx(gain * (reached_V - zero_V), rel=1e-3)


def landing(final_V: float, final_deg: float) -> Flight:
    """Make twenty seconds at level, then a descent of two seconds, whose end the log does not contain.

    Parameters
    ----------
    final_V : float
        Sum of both voltages during the descent; 3.4 V carries the arm.
    final_deg : float
        Elevation at the end of the log.
    """
    t_s = np.arange(0.0, 22.0, 0.01)
    descended = np.clip(t_s - 20.0, 0.0, None) / 2.0  # share of the descent, 0 to 1
    wave = 0.02 * np.sin(3.0 * t_s)
    total_V = 3.4 + wave + descended.clip(0.0, 0.05) / 0.05 * (final_V - 3.4)
    elevation_rad = COUNT_RAD * np.round((wave + np.radians(final_deg) * descended) / COUNT_RAD)
    travel_rad = COUNT_RAD * np.round(t_s * 65)
    return Flight(t_s, total_V / 2, total_V / 2, elevation_rad, 0 * t_s, travel_rad)


@pytest.mark.parametrize(
    ("final_V", "final_deg", "is_cut"), [(0.5, -14.0, True), (3.2, -14.0, False), (0.5, -2.0, False)]
)
def test_landing_that_the_log_does_not_show_to_its_end_is_cut(
    final_V: float, final_deg: float, is_cut: bool
) -> None:
    record = prepare(landing(final_V, final_deg), load_rig("makki2024"))
    assert bool(record.cuts) == is_cut
    if is_cut:
        assert record.cuts[-1].start_s == pytest.approx(20.1, abs=0.25)
        assert record.cuts[-1].stop_s == pytest.approx(22.0, abs=0.02)
