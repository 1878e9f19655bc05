"""Logs without any names are imported: rates, setpoints and estimates are not taken for angles."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from heli_host.data.flight import Flight
from heli_host.data.tables import flights_of, read_table
from heli_lab.setup.guess import guess, merge_tables
from heli_sim.rig import Rig

from tests.guess.flights import measured, measured_flight, simulated
from tests.guess.students import BIAS_V, DEG, setpoint_rows, state_rows, voltage_rows, write_mat
from tests.running.long import samples

pytestmark = pytest.mark.slow


def assert_right(flight: Flight, rig: Rig, path: Path, offset_V: float = 0.0) -> set[str]:
    """Hold a guess against the flight; return what it says is open."""
    table = read_table(path)
    guess_result = guess(table, rig)
    imported = flights_of(table, guess_result.profile)[0]
    for name in ("elevation_rad", "pitch_rad", "travel_rad"):
        assert getattr(imported, name) == pytest.approx(getattr(flight, name), abs=1e-6), name
    rows = slice(None, None, 50)
    assert imported.front_V[rows] - imported.back_V[rows] == pytest.approx(
        flight.front_V[rows] - flight.back_V[rows], abs=1e-6
    )
    both = (imported.front_V + imported.back_V - flight.front_V - flight.back_V).mean()
    assert abs(both) < 0.5 + 0.1 * abs(offset_V)
    return {ambiguity.subject for ambiguity in guess_result.ambiguities}


def test_rates_next_to_angles_are_not_taken_for_angles(tmp_path: Path) -> None:
    flight, rig = simulated(1)
    path = write_mat(tmp_path / "a.mat", flight.t_s, [*voltage_rows(flight), *state_rows(flight)])
    assert assert_right(flight, rig, path) == {"which rotor is the front one"}


def test_setpoints_and_estimates_are_not_taken_for_angles(tmp_path: Path) -> None:
    flight, rig = simulated(1)
    estimates = [np.convolve(item, np.ones(10) / 10.0, mode="same") for item in state_rows(flight, DEG)[::2]]
    rows = [*setpoint_rows(flight, DEG), *voltage_rows(flight), *estimates, *state_rows(flight, DEG)]
    path = write_mat(tmp_path / "a.mat", flight.t_s, rows)
    assert assert_right(flight, rig, path) == {"which rotor is the front one"}


def test_angles_and_voltages_in_two_files_are_one_flight(tmp_path: Path) -> None:
    flight, rig = simulated(1)
    angles = write_mat(tmp_path / "plant.mat", flight.t_s, state_rows(flight))
    voltages = write_mat(tmp_path / "u.mat", flight.t_s[100:], [item[100:] for item in voltage_rows(flight)])
    guess_result = guess(merge_tables([read_table(angles), read_table(voltages)]), rig)
    columns = {axis: item.column for axis, item in guess_result.profile.angles.items()}
    assert columns == {"travel": "1: ans[2]", "pitch": "1: ans[4]", "elevation": "1: ans[6]"}
    imported = flights_of(merge_tables([read_table(angles), read_table(voltages)]), guess_result.profile)[0]
    assert imported.pitch_rad == pytest.approx(flight.pitch_rad[100:], abs=1e-6)
    assert imported.front_V == pytest.approx(flight.front_V[100:], abs=1e-6)


def test_measured_flights_logged_without_names_and_bias_are_guessed_right(tmp_path: Path) -> None:
    if not measured():
        pytest.skip("skipped: no shared data")
    for number, path in enumerate(measured()[:: samples(1, 4)]):
        flight, rig = measured_flight(path)
        rows = [*setpoint_rows(flight, DEG), *voltage_rows(flight, BIAS_V), *state_rows(flight, DEG)]
        ambiguities = assert_right(
            flight, rig, write_mat(tmp_path / f"{number}.mat", flight.t_s, rows), BIAS_V
        )
        assert {"the sum's bias", "which rotor is the front one"} <= ambiguities
