"""A guess is right, or says what it is unsure of; a log without names is proposed right, and never sure."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from heli_host.data.flight import Flight
from heli_host.data.tables import flights_of, read_table
from heli_lab.setup.guess import guess, merge_tables
from heli_sim.rig import Rig

from tests.guess.__main__ import judge_seed
from tests.guess.distort import Distortion, draw_distortion, write
from tests.guess.exports import BIAS_V, DEG, setpoint_rows, state_rows, voltage_rows, write_mat
from tests.guess.flights import measured, measured_flight, simulated
from tests.guess.foreign import write as write_foreign
from tests.guess.grade import DEVELOPMENT_SEEDS, grade
from tests.running.long import samples

pytestmark = pytest.mark.slow

PLAIN = Distortion(
    "own", "deg", "V", "s", True, (1.0, 1.0, 1.0), False, False, 250.0, ("", 0.0), False, False, 0
)


def guessed(how: Distortion, folder: Path, number: int = 1) -> tuple[object, ...]:
    flight, rig = simulated(number)
    path = folder / "flight.csv"
    write(flight, rig, how, path)
    guess_result = guess(read_table(path), rig)
    return guess_result, {ambiguity.subject for ambiguity in guess_result.ambiguities}


def test_nothing_wrong_is_sure(tmp_path: Path) -> None:
    guess_result, ambiguities = guessed(PLAIN, tmp_path)
    assert guess_result.sure, ambiguities  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("number", "late_s", "is_doubted"), [(0, 0.0, False), (0, 0.1, True), (1, 0.1, True)]
)
def test_late_voltages_are_doubted_and_rotors_without_a_lag_are_not(
    number: int, late_s: float, is_doubted: bool, tmp_path: Path
) -> None:
    _, ambiguities = guessed(replace(PLAIN, late=("voltages", late_s)), tmp_path, number)
    assert ambiguities == ({"the voltages' time"} if is_doubted else set())


@pytest.mark.parametrize("axis", range(3))
def test_a_turned_angle_is_turned_back(axis: int, tmp_path: Path) -> None:
    signs = [1.0, 1.0, 1.0]
    signs[axis] = -1.0
    guess_result, ambiguities = guessed(replace(PLAIN, signs=tuple(signs)), tmp_path)  # type: ignore[arg-type]
    angles = guess_result.profile.angles  # type: ignore[attr-defined]
    assert [angles[name].sign for name in ("elevation", "pitch", "travel")] == signs
    assert ambiguities == (set() if axis == 0 else {"which rotor is the front one"})


def test_zero_at_rest_is_brought_to_level(tmp_path: Path) -> None:
    guess_result, ambiguities = guessed(replace(PLAIN, at_rest=True), tmp_path)
    assert not ambiguities
    assert guess_result.profile.angles["elevation"].offset_deg == pytest.approx(-25.0, abs=0.5)  # type: ignore[attr-defined]


@pytest.mark.parametrize("seed", range(samples(24, 2)))
def test_no_distorted_flight_is_silently_wrong(seed: int) -> None:
    guess_result = judge_seed(seed)
    print(seed, draw_distortion(seed).text(), guess_result)
    assert guess_result.verdict != "SILENTLY WRONG"


def test_measured_flights_are_guessed_right(tmp_path: Path) -> None:
    if not measured():
        pytest.skip("skipped: no shared data")
    for path in measured()[:: samples(1, 6)]:
        flight, rig = measured_flight(path)
        table = read_table(path)
        guess_result = guess(table, rig)
        (made,) = flights_of(table, guess_result.profile)
        subjects = {ambiguity.subject for ambiguity in guess_result.ambiguities}
        # Slow rotors look like a delay, and reversed propellers hardly push; nothing is changed for either.
        assert subjects <= {"elevation's time", "the voltages' lower limit"}, (path.name, subjects)
        assert made.pitch_rad == pytest.approx(flight.pitch_rad, abs=1e-6)
        assert made.front_V == pytest.approx(flight.front_V, abs=1e-6)


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


def test_setpoints_and_estimates_are_not_taken_for_angles(tmp_path: Path) -> None:
    flight, rig = simulated(1)
    estimates = [np.convolve(item, np.ones(10) / 10.0, mode="same") for item in state_rows(flight, DEG)[::2]]
    rows = [*setpoint_rows(flight, DEG), *voltage_rows(flight), *estimates, *state_rows(flight, DEG)]
    path = write_mat(tmp_path / "a.mat", flight.t_s, rows)
    assert assert_right(flight, rig, path) == {"which rotor is the front one", "the columns"}


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
        assert {"the columns", "the sum's bias", "which rotor is the front one"} <= ambiguities


@pytest.mark.parametrize("seed", DEVELOPMENT_SEEDS[1 :: samples(1, 9)])
def test_a_raw_file_needs_at_most_one_correction_and_a_doubt_names_it(seed: int, tmp_path: Path) -> None:
    graded = grade(write_foreign(seed, tmp_path))
    assert graded.corrections <= 1, graded
    assert not graded.silent, graded
    assert not (graded.sure and graded.wrong), graded
