"""A profile survives its file, and makes flights of tables."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from heli_host.errors import FlightDataError
from heli_host.tables import (
    Angle,
    Column,
    Part,
    Profile,
    Table,
    Voltage,
    flights_of,
    profile_text,
    read_profile,
)

PROFILE = Profile(
    {
        "elevation": Angle("e", "deg", offset_deg=-25.0),
        "pitch": Angle('p "x"', "count", 2000.0, -1.0),
        "travel": Angle("t", "rad", delay_s=0.02),
    },
    {"sum": Voltage("s", "pwm", 1023.0, 9.0, 1.0, 1.5), "difference": Voltage("d", "mV", sign=-1.0)},
    "time",
    "ms",
    setpoints={"pitch": Angle("r")},
    parts={"a.csv": Part(((0.0, 0.5),), "rig 8")},
    about="made by hand",
)
N = 400


def table(source: str = "a.csv") -> Table:
    t = np.arange(N) * 5.0
    columns = {
        "time": t,
        "e": 25.0 + t / 1000,
        'p "x"': np.full(N, 500.0),
        "t": t / 1000,
        "s": np.full(N, 341.0),
    }
    columns |= {"d": np.full(N, 1000.0), "r": np.zeros(N)}
    return Table(source, {name: Column(np.asarray(one, float)) for name, one in columns.items()})


def test_a_profile_survives_its_file(tmp_path: Path) -> None:
    path = tmp_path / "p.toml"
    path.write_text(profile_text(PROFILE))
    read = read_profile(path)
    # What has no meaning for a unit is not written.
    assert read == dataclasses.replace(
        PROFILE, voltages={**PROFILE.voltages, "difference": Voltage("d", "mV", sign=-1.0)}
    )


def test_units_signs_offsets_delays_and_parts() -> None:
    (flight,) = flights_of(table(), PROFILE)
    assert flight.t_s[0] == pytest.approx(0.5)
    assert np.degrees(flight.elevation_rad[0]) == pytest.approx(0.5)
    assert np.degrees(flight.pitch_rad[0]) == pytest.approx(-90.0)
    assert flight.travel_rad[0] == pytest.approx(0.52)
    assert flight.front_V[0] + flight.back_V[0] == pytest.approx(341.0 / 1023.0 * 9.0 + 1.5)
    assert flight.front_V[0] - flight.back_V[0] == pytest.approx(-1.0)
    assert flight.meta["group"] == "rig 8"


def test_what_is_left_out_in_the_middle_makes_two_flights() -> None:
    parts = {"a.csv": Part(((0.9, 1.1),))}
    first, second = flights_of(table(), dataclasses.replace(PROFILE, parts=parts))
    assert first.t_s[-1] < 0.9
    assert second.t_s[0] >= 1.1


def test_voltages_that_acted_until_a_row_move_up_by_one() -> None:
    moving = table()
    moving.columns["d"].values[:] = 1000.0 * np.arange(N)
    after = flights_of(moving, dataclasses.replace(PROFILE, parts={}))[0]
    before = flights_of(moving, dataclasses.replace(PROFILE, parts={}, act="before"))[0]
    assert before.front_V[:-1] == pytest.approx(after.front_V[1:])


def test_an_uneven_clock_becomes_even_and_a_hole_ends_a_flight() -> None:
    rough = table()
    random = np.random.default_rng(3)
    rough.columns["time"].values[:] += random.uniform(-1.0, 1.0, N)
    rough.columns["time"].values[200:] += 1000.0
    whole = dataclasses.replace(PROFILE, parts={})
    first, second = flights_of(rough, whole)
    assert np.ptp(np.diff(first.t_s)) < 1e-9
    # The ramp of a column stays a ramp.
    assert np.degrees(first.elevation_rad) == pytest.approx(
        rough.columns["e"].values[0] - 25.0 + first.t_s, abs=0.01
    )
    assert second.t_s[0] - first.t_s[-1] > 0.9


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "neither"),
        ("[front]\ncolumn='a'\n[back]\ncolumn='b'\n", "[elevation] is missing"),
        ("[elevation]\ncolumn='a'\nsgin=1\n", "sgin"),
        ("altitude=1", "altitude"),
        ("[front]\n[sum]\n", "neither"),
        ("= 3", "not a profile"),
    ],
)
def test_a_wrong_profile_is_refused_in_a_line(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "p.toml"
    whole = profile_text(PROFILE)
    path.write_text(text if said != "sgin" else whole.replace("[elevation]\n", "[elevation]\nsgin = 1\n"))
    with pytest.raises(FlightDataError, match=said.replace("[", r"\[")):
        read_profile(path)


def test_a_column_that_is_not_there_is_named() -> None:
    wrong = dataclasses.replace(PROFILE, time="tme")
    with pytest.raises(FlightDataError, match="did you mean 'time'"):
        flights_of(table(), wrong)
