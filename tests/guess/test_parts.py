"""A guess doubts a change within a file, because a profile has one entry for all parts of the file."""

from __future__ import annotations

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


def cut_voltage(log: Log) -> None:
    log["back_V"][rows(log, 50.0, 51.0)] = 0.0


def slow_clock(log: Log) -> None:
    later = rows(log, 50.0, 1e3)
    log["t_s"][later] = log["t_s"][later.start] + 2.0 * (log["t_s"][later] - log["t_s"][later.start])


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
        (cut_voltage, "the back voltage in parts of the file"),
        (slow_clock, "the rate of the clock"),
        (halve_pitch, "the scale of pitch's encoder"),
    ],
)
def test_a_change_within_a_file_is_doubted(damage: Callable[[Log], None], subject: str) -> None:
    log = log_of(simulated(1)[0])
    assert subjects(log) == []
    damage(log)
    assert subject in subjects(log)


def test_the_encoders_of_another_rig_are_only_doubted_if_the_user_names_the_rig() -> None:
    log = log_of(simulated(1)[0])
    log["travel_rad"] *= 0.5
    assert subjects(log) == []
    assert subjects(log, is_given=True) == ["the scale of travel's encoder"]


@pytest.mark.parametrize("path", measured(), ids=lambda path: path.name)
def test_measured_flights_change_nothing_within(path: Path) -> None:
    assert subjects(log_of(read_flight(path))) == []
