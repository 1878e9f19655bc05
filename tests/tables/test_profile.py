"""A profile survives its file, and makes flights of tables."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from heli_host.data.arrays import Floats
from heli_host.data.tables import (
    Angle,
    Column,
    Part,
    Profile,
    Table,
    Voltage,
    flights_of,
    profile_of,
    profile_text,
    read_profile,
)
from heli_host.errors import FlightDataError

PROFILE = Profile(
    {
        "elevation": Angle("e", "deg", offset_deg=-25.0),
        "pitch": Angle('p "x"', "count", 2000.0, -1.0),
        "travel": Angle("t", "rad", delay_s=0.02),
    },
    {
        "sum": Voltage("s", "pwm", 1023.0, 9.0, 1.0, 1.5, factor=2.0),
        "difference": Voltage("d", "mV", sign=-1.0),
    },
    "time",
    "ms",
    setpoints={"pitch": Angle("r")},
    parts={"a.csv": Part(((0.0, 0.5),), "rig 8")},
    about="made by hand",
    clip_V=(-1.0, 24.0),
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
    return Table(source, {name: Column(np.asarray(column, float)) for name, column in columns.items()})


def test_a_profile_survives_its_file(tmp_path: Path) -> None:
    path = tmp_path / "p.toml"
    path.write_text(profile_text(PROFILE))
    read = read_profile(path)
    # Options without a meaning for a unit are not written.
    assert read == dataclasses.replace(
        PROFILE, voltages={**PROFILE.voltages, "difference": Voltage("d", "mV", sign=-1.0)}
    )


def test_what_both_voltages_share_is_stated_once(tmp_path: Path) -> None:
    path = tmp_path / "p.toml"
    pair = {name: Voltage(name[0], "pwm", 1023.0, 9.0) for name in ("front", "back")}
    profile = dataclasses.replace(PROFILE, voltages=pair)
    path.write_text(profile_text(profile))
    assert path.read_text().count("supply_V") == 1
    assert read_profile(path) == profile
    path.write_text(path.read_text().replace('column = "b"', 'column = "b"\nsupply_V = 8'))
    assert read_profile(path).voltages == {**pair, "back": Voltage("b", "pwm", 1023.0, 8.0)}


def test_units_signs_offsets_delays_and_parts() -> None:
    (flight,) = flights_of(table(), PROFILE)
    assert flight.t_s[0] == pytest.approx(0.5)
    assert np.degrees(flight.elevation_rad[0]) == pytest.approx(0.5)
    assert np.degrees(flight.pitch_rad[0]) == pytest.approx(-90.0)
    assert flight.travel_rad[0] == pytest.approx(0.52)
    assert flight.front_V[0] + flight.back_V[0] == pytest.approx(2.0 * 341.0 / 1023.0 * 9.0 + 1.5)
    assert flight.front_V[0] - flight.back_V[0] == pytest.approx(-1.0)
    assert flight.meta["group"] == "rig 8"


def test_a_motor_gets_no_more_than_the_clip() -> None:
    (free,) = flights_of(table(), dataclasses.replace(PROFILE, clip_V=None))
    assert (free.front_V[0], free.back_V[0]) == pytest.approx((3.25, 4.25))
    (clipped,) = flights_of(table(), dataclasses.replace(PROFILE, clip_V=(0.0, 4.0)))
    assert (clipped.front_V[0], clipped.back_V[0]) == pytest.approx((3.25, 4.0))


def test_in_a_mirror_motors_are_exchanged_and_pitch_and_travel_turned() -> None:
    (plain,), (mirrored,) = (
        flights_of(table(), dataclasses.replace(PROFILE, mirrored=mirrored)) for mirrored in (False, True)
    )
    assert np.array_equal(plain.voltages_V[:, ::-1], mirrored.voltages_V)
    assert np.array_equal(plain.elevation_rad, mirrored.elevation_rad)
    assert np.array_equal(plain.pitch_rad, -mirrored.pitch_rad)
    assert np.array_equal(plain.travel_rad, -mirrored.travel_rad)


@pytest.mark.parametrize("counts", [4096.0, 4000.0])
def test_counters_of_16_bits_that_run_over_go_on(counts: float) -> None:
    swinging = np.round(-300.0 + 400.0 * np.sin(np.arange(N) / 30.0))
    wrapped = table()
    wrapped.columns["e"].values[:] = np.mod(swinging, 65536.0)
    angles = {**PROFILE.angles, "elevation": Angle("e", "count", counts)}
    (flight,) = flights_of(wrapped, dataclasses.replace(PROFILE, angles=angles, parts={}))
    assert flight.elevation_rad == pytest.approx(2.0 * np.pi * swinging[: len(flight)] / counts)


def test_whole_turns_of_elevation_are_where_a_counter_began() -> None:
    high = table()
    high.columns["e"].values[:] += 720.0
    assert flights_of(high, PROFILE)[0].elevation_rad == pytest.approx(
        flights_of(table(), PROFILE)[0].elevation_rad
    )


def test_times_that_begin_again_begin_another_flight() -> None:
    twice = table()
    twice.columns["time"].values[150:] -= twice.columns["time"].values[150]
    first, second = flights_of(twice, dataclasses.replace(PROFILE, parts={}))
    assert (len(first), second.t_s[0]) == (150, 0.0)
    assert np.degrees(second.elevation_rad[0]) == pytest.approx(0.75)


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
    complete = dataclasses.replace(PROFILE, parts={})
    first, second = flights_of(rough, complete)
    assert np.ptp(np.diff(first.t_s)) < 1e-9
    # The ramp of a column stays a ramp.
    assert np.degrees(first.elevation_rad) == pytest.approx(
        rough.columns["e"].values[0] - 25.0 + first.t_s, abs=0.01
    )
    assert second.t_s[0] - first.t_s[-1] > 0.9


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "neither"),
        ("[front]\ncolumn='a'\n[back]\ncolumn='b'\n", "[elevation] is missing"),
        ("[elevation]\ncolumn='a'\nsgin=1\n", "sgin"),
        ("altitude=1", "altitude"),
        ("[front]\n[sum]\n", "neither"),
        ("= 3", "not a profile"),
    ],
)
def test_a_wrong_profile_is_refused_in_a_line(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "p.toml"
    complete = profile_text(PROFILE)
    path.write_text(
        text if message != "sgin" else complete.replace("[elevation]\n", "[elevation]\nsgin = 1\n")
    )
    with pytest.raises(FlightDataError, match=message.replace("[", r"\[")):
        read_profile(path)


@pytest.mark.parametrize(
    ("entry", "wrong", "message"),
    [
        ("mirrored = false", "mirrored = 1", "neither true nor false"),
        ("clip_V = [-1.0, 24.0]", "clip_V = [5, -5]", "smallest, largest"),
        ("clip_V = [-1.0, 24.0]", "clip_V = 5", "smallest, largest"),
        ("factor = 2.0", "factor = 0", "not positive"),
    ],
)
def test_a_wrong_entry_is_refused_in_a_line(entry: str, wrong: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "p.toml"
    complete = profile_text(PROFILE)
    assert entry in complete
    path.write_text(complete.replace(entry, wrong))
    with pytest.raises(FlightDataError, match=message):
        read_profile(path)


def test_a_column_that_is_not_there_is_named() -> None:
    wrong = dataclasses.replace(PROFILE, time="tme")
    with pytest.raises(FlightDataError, match="did you mean 'time'"):
        flights_of(table(), wrong)


def test_an_angle_that_jumps_begins_another_flight_and_says_why() -> None:
    jumping = table()
    jumping.columns["e"].values[150:] += 21.0
    first, second = flights_of(jumping, dataclasses.replace(PROFILE, parts={}))
    assert len(first) == 150
    assert "cut" not in first.meta
    assert second.meta["cut"].startswith("elevation jumps by 21.0 deg at ")


def test_filled_gaps_are_counted_in_the_notes() -> None:
    complete = table()
    keep = np.ones(N, bool)
    keep[100:103] = False
    columns = {name: Column(column.values[keep], column.unit) for name, column in complete.columns.items()}
    flights = flights_of(Table("x", columns), dataclasses.replace(PROFILE, parts={}))
    assert len(flights) == 1
    assert flights[0].meta["filled"].startswith("3 missing rows in 1 gaps, the longest ")
    assert "filled" not in flights_of(complete, dataclasses.replace(PROFILE, parts={}))[0].meta


def test_a_logged_direction_gives_sizes_their_sign(tmp_path: Path) -> None:
    t_s: Floats = 0.01 * np.arange(300, dtype=np.float64)
    volts = 2.0 + 4.0 * np.sin(3.0 * t_s)
    columns = {name: Column(0.1 * t_s) for name in ("elevation", "pitch", "travel")}
    columns |= {"t": Column(t_s), "size": Column(np.abs(volts)), "back": Column(volts)}
    # Forwards is 0, the value with the larger voltages.
    columns["dir"] = Column((volts < 0.0).astype(float))
    content: dict[str, Any] = {name: {"column": name} for name in ("elevation", "pitch", "travel", "back")}
    content |= {"time": {"column": "t"}, "front": {"column": "size", "sign_column": "dir"}}
    profile = profile_of(content, "x.toml")
    (flight,) = flights_of(Table("x.csv", columns), profile)
    np.testing.assert_allclose(flight.front_V, volts)
    path = tmp_path / "x.toml"
    path.write_text(profile_text(profile), encoding="utf-8")
    assert read_profile(path).voltages == profile.voltages


@pytest.mark.parametrize("is_alone", [False, True])
def test_a_logged_supply_scales_shares_row_by_row(is_alone: bool, tmp_path: Path) -> None:
    t_s: Floats = 0.01 * np.arange(300, dtype=np.float64)
    duty = 50.0 + 10.0 * np.sin(3.0 * t_s)
    supply_V = np.linspace(12.0, 10.0, t_s.size)
    logged = supply_V.copy()
    logged[1::2] = np.nan
    columns = {name: Column(0.1 * t_s) for name in ("elevation", "pitch", "travel")}
    columns |= {
        "t": Column(t_s),
        "front": Column(duty),
        "back": Column(duty),
        "Vbat": Column(1e3 * logged, "mV"),
    }
    if is_alone:
        # The rows of the supply lack the others.
        for name in columns.keys() - {"t", "Vbat"}:
            columns[name].values[::2] = np.nan
    share = {"unit": "percent", "supply_column": "Vbat"}
    content: dict[str, Any] = {axis: {"column": axis} for axis in ("elevation", "pitch", "travel")}
    content |= {
        "time": {"column": "t"},
        "voltages": share,
        "front": {"column": "front"},
        "back": {"column": "back"},
    }
    profile = profile_of(content, "x.toml")
    (flight,) = flights_of(Table("x.csv", columns), profile)
    # Each second row has the supply of the row before.
    expected_V = duty / 100.0 * np.repeat(supply_V[::2], 2)
    np.testing.assert_allclose(flight.front_V, expected_V[1::2] if is_alone else expected_V)
    path = tmp_path / "x.toml"
    path.write_text(profile_text(profile), encoding="utf-8")
    assert read_profile(path).voltages == profile.voltages
