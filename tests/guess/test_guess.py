"""A guess is right, or says what it is unsure of."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from heli_host.data.tables import Column, Table, flights_of, read_table
from heli_host.errors import FlightDataError
from heli_lab.setup.guess import guess

from tests.guess.__main__ import judge_seed
from tests.guess.distort import Distortion, draw_distortion, write
from tests.guess.flights import measured, measured_flight, simulated
from tests.running.long import samples

PLAIN = Distortion(
    "own", "deg", "V", "s", True, (1.0, 1.0, 1.0), False, False, 250.0, ("", 0.0), False, False, 0
)


def guessed(how: Distortion, folder: Path, number: int = 1) -> tuple[object, ...]:
    flight, rig = simulated(number)
    path = folder / "flight.csv"
    write(flight, rig, how, path)
    guess_result = guess(read_table(path), rig)
    return guess_result, {ambiguity.subject for ambiguity in guess_result.ambiguities}


@pytest.mark.slow
def test_nothing_wrong_is_sure(tmp_path: Path) -> None:
    guess_result, ambiguities = guessed(PLAIN, tmp_path)
    assert guess_result.sure, ambiguities  # type: ignore[attr-defined]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "late_s", "is_doubted"),
    [(0, 0.0, False), (0, 0.1, True), (1, 0.0, False), (1, 0.1, True), (2, 0.08, True)],
)
def test_late_voltages_are_doubted_and_rotors_without_a_lag_are_not(
    number: int, late_s: float, is_doubted: bool, tmp_path: Path
) -> None:
    _, ambiguities = guessed(replace(PLAIN, late=("voltages", late_s)), tmp_path, number)
    assert ambiguities == ({"the voltages' time"} if is_doubted else set())


@pytest.mark.slow
@pytest.mark.parametrize("axis", range(3))
def test_a_turned_angle_is_turned_back(axis: int, tmp_path: Path) -> None:
    signs = [1.0, 1.0, 1.0]
    signs[axis] = -1.0
    guess_result, ambiguities = guessed(replace(PLAIN, signs=tuple(signs)), tmp_path)  # type: ignore[arg-type]
    angles = guess_result.profile.angles  # type: ignore[attr-defined]
    assert [angles[name].sign for name in ("elevation", "pitch", "travel")] == signs
    assert ambiguities == (set() if axis == 0 else {"which rotor is the front one"})


@pytest.mark.slow
def test_zero_at_rest_is_brought_to_level(tmp_path: Path) -> None:
    guess_result, ambiguities = guessed(replace(PLAIN, at_rest=True), tmp_path)
    assert not ambiguities
    assert guess_result.profile.angles["elevation"].offset_deg == pytest.approx(-25.0, abs=0.5)  # type: ignore[attr-defined]


@pytest.mark.slow
def test_columns_without_names_are_found_by_physics(tmp_path: Path) -> None:
    flight, rig = simulated(1)
    values = [flight.travel_rad, flight.back_V, flight.pitch_rad, flight.front_V, flight.elevation_rad]
    columns = {"t": Column(flight.t_s[::5])} | {f"x{i}": Column(item[::5]) for i, item in enumerate(values)}
    guess_result = guess(Table("memory", columns, named=False), rig)
    angles = guess_result.profile.angles
    assert [angles[name].column for name in ("elevation", "pitch", "travel")] == ["x4", "x2", "x0"]
    assert {item.column for item in guess_result.profile.voltages.values()} == {"x1", "x3"}
    assert {ambiguity.subject for ambiguity in guess_result.ambiguities} == {"which rotor is the front one"}


@pytest.mark.slow
def test_a_flight_without_voltages_is_refused() -> None:
    flight, rig = simulated(1)
    columns = {"t_s": Column(flight.t_s[::5])} | {
        name: Column(getattr(flight, name)[::5]) for name in ("elevation_rad", "pitch_rad", "travel_rad")
    }
    with pytest.raises(FlightDataError, match="no column is a motor voltage"):
        guess(Table("memory", columns), rig)
    columns |= {"a": Column(flight.t_s[::5] % 3.0), "b": Column(flight.t_s[::5] % 7.0)}
    with pytest.raises(FlightDataError, match="no two columns act like motor voltages"):
        guess(Table("memory", columns), rig)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(samples(24, 2)))
def test_no_distorted_flight_is_silently_wrong(seed: int) -> None:
    guess_result = judge_seed(seed)
    print(seed, draw_distortion(seed).text(), guess_result)
    assert guess_result.verdict != "SILENTLY WRONG"


@pytest.mark.slow
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
