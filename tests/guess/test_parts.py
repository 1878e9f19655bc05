"""A guess doubts a change within a file, because a profile has one entry for all parts of the file."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_host.data.log.reader import read_flight
from heli_host.data.tables import Angle, Column, Profile, Table, Voltage
from heli_lab.setup.guess.names import AXES
from heli_lab.setup.guess.parts import part_ambiguities
from heli_sim.rig import load_rig

from tests.guess.flights import measured, simulated

NAMES = ("t_s", "elevation_rad", "pitch_rad", "travel_rad", "front_V", "back_V")
PROFILE = Profile(
    {axis: Angle(f"{axis}_rad", "rad") for axis in AXES},
    {"front": Voltage("front_V"), "back": Voltage("back_V")},
    "t_s",
)
Log = dict[str, Floats]


def log_of(flight: Flight) -> Log:
    stride = max(1, round(0.01 / flight.step_s))
    return {name: np.array(getattr(flight, name)[::stride]) for name in NAMES}


def subjects(log: Log, *, is_given: bool = False) -> list[str]:
    table = Table("lab.csv", {name: Column(values) for name, values in log.items()})
    rig = load_rig("makki2024")
    return [each.subject for each in part_ambiguities([table], PROFILE, rig, is_given=is_given)]


def rows(log: Log, start_s: float, stop_s: float) -> slice:
    return slice(*np.searchsorted(log["t_s"], (start_s, stop_s)).tolist())


def invert_late(log: Log) -> None:
    log["elevation_rad"][rows(log, 50.0, 1e3)] *= -1.0


def change_unit(log: Log) -> None:
    log["travel_rad"][rows(log, 50.0, 1e3)] *= np.degrees(1.0)


def lose_counts(log: Log) -> None:
    log["pitch_rad"][rows(log, 50.0, 1e3)] += np.radians(4.0)


def limit(log: Log) -> None:
    log["pitch_rad"].clip(-1.0, np.quantile(log["pitch_rad"], 0.9), out=log["pitch_rad"])


def hold_voltage(log: Log) -> None:
    held = rows(log, 50.0, 53.0)
    log["front_V"][held] = log["front_V"][held.start]


def hold_rounded_voltage(log: Log) -> None:
    for motor in ("front_V", "back_V"):
        log[motor] = np.round(log[motor], 2)
    hold_voltage(log)


def change_unit_in_the_middle_of_a_part(log: Log) -> None:
    log["pitch_rad"][rows(log, 93.0, 1e3)] /= np.degrees(1.0)


def hold_both_voltages(log: Log) -> None:
    for motor in ("front_V", "back_V"):
        held = rows(log, 50.0, 53.0)
        log[motor][held] = log[motor][held.start]


def cut_voltage(log: Log) -> None:
    log["back_V"][rows(log, 50.0, 51.0)] = 0.0


def slow_clock(log: Log) -> None:
    later = rows(log, 50.0, 1e3)
    log["t_s"][later] = log["t_s"][later.start] + 2.0 * (log["t_s"][later] - log["t_s"][later.start])


def turn_over(log: Log) -> None:
    log["elevation_rad"][rows(log, 50.0, 1e3)] += 2.5


def cut_to_pieces(log: Log) -> None:
    """Leave a flight of a few rows, which is too short for a signal."""
    log["travel_rad"][10:] += np.radians(150.0)
    log["front_V"][rows(log, 50.0, 53.0)] = 3.0


def stick(log: Log) -> None:
    log["travel_rad"][rows(log, 60.0, 100.0)] = log["travel_rad"][rows(log, 60.0, 100.0)][0]


def halve_pitch(log: Log) -> None:
    log["pitch_rad"] *= 0.5


@pytest.mark.parametrize(
    ("damage", "subject"),
    [
        (invert_late, "the signs in parts of the file"),
        (change_unit, "travel's unit in parts of the file"),
        (lose_counts, "pitch's zero in parts of the file"),
        (limit, "pitch beyond its highest value"),
        (hold_voltage, "the front voltage in parts of the file"),
        (hold_both_voltages, "the front voltage in parts of the file"),
        (hold_rounded_voltage, "the front voltage in parts of the file"),
        (change_unit_in_the_middle_of_a_part, "pitch's unit in parts of the file"),
        (cut_voltage, "the back voltage in parts of the file"),
        (slow_clock, "the rate of the clock"),
        (turn_over, "elevation's unit"),
        (cut_to_pieces, "the front voltage in parts of the file"),
        (halve_pitch, "the scale of pitch's encoder"),
        (stick, "the rows that stand still"),
    ],
)
def test_a_change_within_a_file_is_doubted(damage: Callable[[Log], None], subject: str) -> None:
    log = log_of(simulated(1)[0])
    damage(log)
    assert subject in subjects(log)


def test_a_sound_file_is_not_doubted() -> None:
    assert subjects(log_of(simulated(1)[0])) == []


def test_the_encoders_of_another_rig_are_only_doubted_if_the_user_names_the_rig() -> None:
    log = log_of(simulated(1)[0])
    log["travel_rad"] *= 0.5
    assert subjects(log) == []
    assert subjects(log, is_given=True) == ["the scale of travel's encoder"]


def test_a_voltage_that_stands_still_for_a_moment_is_no_failed_link() -> None:
    log = log_of(simulated(1)[0])
    log["back_V"][rows(log, 50.0, 50.45)] = 0.0
    assert subjects(log) == []


def test_a_voltage_at_its_limit_is_no_failed_link_if_pitch_responds() -> None:
    t_s = 0.02 * np.arange(3000)
    random = np.random.default_rng(1)
    wanted_V = 1.5 * np.sin(1.7 * t_s) * np.sin(0.31 * t_s) + random.normal(0.0, 0.02, t_s.size)
    front_V, back_V = 1.7 + 0.5 * wanted_V, 1.7 - 0.5 * wanted_V
    # A driver with a dead zone jumps to 0.
    back_V[back_V < 1.2] = 0.0
    pitch_rad = np.zeros(t_s.size)
    rate_rad_s = 0.0
    for row in range(1, t_s.size):
        torque = 2.9 * (front_V[row - 1] - back_V[row - 1])
        rate_rad_s += 0.02 * (torque - 3.0 * rate_rad_s - 8.0 * pitch_rad[row - 1])
        pitch_rad[row] = pitch_rad[row - 1] + 0.02 * rate_rad_s
    elevation_rad = np.where(t_s < 1.0, -0.4, 0.02 * np.sin(t_s))
    travel_rad = np.cumsum(np.cumsum(pitch_rad)) * 4e-4
    columns = (t_s, elevation_rad, pitch_rad, travel_rad, front_V, back_V)
    log = dict(zip(NAMES, columns, strict=True))
    assert "the back voltage in parts of the file" not in subjects(log)
    log["back_V"][rows(log, 20.5, 21.5)] = 0.0
    assert "the back voltage in parts of the file" in subjects(log)


@pytest.mark.parametrize("path", measured(), ids=lambda path: path.name)
def test_measured_flights_change_nothing_within(path: Path) -> None:
    assert subjects(log_of(read_flight(path))) == []
