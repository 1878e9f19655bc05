"""Names decide which column is which; the motion confirms them, and proposes columns without names."""

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from heli_host.data.arrays import Floats
from heli_host.data.tables import Column, Table
from heli_host.errors import FlightDataError
from heli_lab.setup.guess import Guess
from heli_lab.setup.guess.columns import ColumnOptions, column_options, prepare_file
from heli_lab.setup.guess.motion import reference_of
from heli_lab.setup.guess.names import AXES, PAIR
from heli_lab.setup.guess.propose import guess_by_rigs, propose
from heli_lab.setup.guess.result import NOTHING_KNOWN, KnownEntries, read_known
from heli_sim.rig import load_rig

from tests.guess.flights import piloted

pytestmark = pytest.mark.medium

RIG = load_rig("quanser-course")
REFERENCE = reference_of(RIG)


def test_a_header_that_a_profile_contradicts_is_reported() -> None:
    known = KnownEntries(
        {"pitch": {"column": "pitch [deg]", "unit": "rad"}, "travel": {"column": "l [deg]"}}, "p"
    )
    table = Table("log", {name: Column(np.zeros(3)) for name in ("pitch [deg]", "l [deg]")})
    assert known.contradicted_headers(table) == [
        "pitch: in rad, as p states, although the header of 'pitch [deg]' states deg"
    ]


def flight_table(pilot: str = "travel", commands: bool = False, **others: Floats) -> Table:
    """A flight under `pilot` with named columns, and further columns of 12500 rows."""
    source = piloted("quanser-course", pilot, 3, 25.0)
    flight, every = source.flight, slice(None, None, 5)
    volts = source.commands_V if commands else flight.voltages_V
    columns = {"elevation": flight.elevation_rad, "pitch": flight.pitch_rad, "travel": flight.travel_rad}
    columns |= {"front": volts[:, 0], "back": volts[:, 1], **others}
    named = {name: Column(values[every]) for name, values in columns.items()}
    return Table("x.csv", {"t": Column(flight.t_s[every]), **named})


def renamed(table: Table, **names: str) -> Table:
    return replace(table, columns={names.get(name, name): item for name, item in table.columns.items()})


def proposed(table: Table) -> Guess:
    return propose([table], RIG).guess


def columns_of(guess: Guess) -> dict[str, str]:
    angles = {axis: angle.column for axis, angle in guess.profile.angles.items()}
    return angles | {role: voltage.column for role, voltage in guess.profile.voltages.items()}


def subjects(guess: Guess) -> set[str]:
    return {ambiguity.subject for ambiguity in guess.ambiguities}


@cache
def sound_guess() -> Guess:
    """The guess of the table as it is."""
    return proposed(flight_table())


def test_a_part_that_is_moved_by_hand_before_the_flight_is_no_evidence_and_is_doubted() -> None:
    table = flight_table()
    assert "the rows with the motors off" not in subjects(proposed(table))
    step_s = float(np.diff(table.columns["t"].values[:2])[0])
    hand_s = np.arange(-10.0, 0.0, step_s)
    sizes = {"elevation": 0.3, "pitch": 0.2, "travel": -0.7, "front": 0.0, "back": 0.0}
    moved = {}
    for name, size in sizes.items():
        values = table.columns[name].values
        by_hand = values[0] * (size != 0.0) + size * np.sin(hand_s) * (hand_s < -3.0)
        joined: Floats = np.concatenate((by_hand, values))
        moved[name] = Column(joined)
    times = Column(np.concatenate((hand_s, table.columns["t"].values)))
    guess = proposed(Table("x.csv", {"t": times, **moved}))
    assert "the rows with the motors off" in subjects(guess)
    assert {angle.sign for angle in guess.profile.angles.values()} == {1.0}


@pytest.mark.parametrize(
    ("per_rad", "header", "subject"),
    [
        (1024.0 / (2.0 * math.pi), "", "the units"),
        (1024.0 / (2.0 * math.pi), " [counts]", "the scale of the encoders"),
        (4096.0 / (2.0 * math.pi), " [counts]", ""),
    ],
)
def test_whole_numbers_of_an_encoder_that_is_not_the_rigs_are_doubted(
    per_rad: float, header: str, subject: str
) -> None:
    table = flight_table()
    counts = {axis: Column(np.rint(per_rad * table.columns[axis].values)) for axis in AXES}
    if per_rad == 4096.0 / (2.0 * math.pi):
        counts["travel"] = Column(2.0 * counts["travel"].values)
    counted = replace(table, columns={**table.columns, **counts})
    named = renamed(counted, **{axis: f"{axis}{header}" for axis in AXES})
    doubts = subjects(proposed(named)) & {"the units", "the scale of the encoders"}
    assert subject in doubts or not (subject or doubts)


def test_times_of_a_structure_that_are_minutes_are_doubted() -> None:
    table = flight_table()
    minutes: Floats = table.columns["t"].values[::4] / 60.0
    columns = {
        name: Column(column.values[::4], "", minutes) for name, column in table.columns.items() if name != "t"
    }
    doubts = {each.alternative for each in proposed(Table("x.mat", columns)).ambiguities}
    assert "another unit, which the file does not state" in doubts


def test_the_name_of_a_matrix_with_a_word_of_time_hides_no_column() -> None:
    table = flight_table()
    matrix = Table("x.mat", {f"date_time[{i}]": column for i, column in enumerate(table.columns.values(), 1)})
    columns = columns_of(proposed(matrix))
    assert [columns[axis] for axis in AXES] == ["date_time[2]", "date_time[3]", "date_time[4]"]


def test_a_column_that_states_a_voltage_is_the_motors() -> None:
    table = flight_table()
    forces = {name: Column(2.0 * table.columns[name].values ** 2) for name in PAIR}
    both = renamed(table, front="Motor front", back="back [V]")
    guess = proposed(replace(both, columns={**both.columns, **forces}))
    assert columns_of(guess)["front"] == "Motor front"
    assert columns_of(guess)["back"] == "back [V]"
    # Without such a word or unit, the motion alone chooses.
    both = replace(table, columns={**table.columns, "front 2": forces["front"]})
    assert "the columns" in subjects(proposed(both))


def test_widths_of_pulses_are_refused_as_such() -> None:
    times: Floats = np.linspace(0.0, 10.0, 500)
    columns = {name: Column(np.sin(times + place, dtype=np.float64)) for place, name in enumerate(AXES)}
    pulses = {f"Motor {side} [us]": Column(1300.0 + 50.0 * np.cos(3.0 * times)) for side in "AB"}
    with pytest.raises(FlightDataError, match=r"widths of pulses \(Motor A \[us\] and Motor B \[us\]\)"):
        proposed(Table("x.csv", {"t": Column(times), **columns, **pulses}))


def test_a_pitch_far_from_level_in_flight_has_a_doubtful_zero() -> None:
    table = flight_table()
    assert "pitch's zero" not in subjects(sound_guess())
    raised = replace(table.columns["pitch"], values=table.columns["pitch"].values + math.radians(40.0))
    tilted = replace(table, columns={**table.columns, "pitch": raised})
    assert "pitch's zero" in subjects(proposed(tilted))


def test_a_zero_of_pitch_that_travel_and_the_voltages_contradict_is_doubted() -> None:
    # The pilot's rig is steady at -5.7 deg, because of its torque.
    table = flight_table()
    for error_deg, is_doubted in ((8.0, True), (-8.0, True), (1.0, False)):
        shifted = table.columns["pitch"].values + math.radians(error_deg)
        other = replace(table, columns={**table.columns, "pitch": Column(shifted)})
        assert ("pitch's zero" in subjects(proposed(other))) == is_doubted, error_deg


def scaled(table: Table, names: Mapping[str, str], factors: Mapping[str, float]) -> Table:
    """Multiply columns by factors, and rename them."""
    columns = {
        names.get(name, name): Column(factors.get(name, 1.0) * column.values)
        for name, column in table.columns.items()
    }
    return replace(table, columns=columns)


def test_an_unstated_unit_of_times_is_doubted_if_nothing_follows_the_voltages() -> None:
    columns = dict(flight_table().columns)
    # Only in milliseconds are such steps those of a log.
    counts = 40.0 * columns.pop("t").values
    for unit, is_doubted in (("", True), ("ms", False)):
        guess = proposed(Table("x.csv", {"time": Column(counts, unit), **columns}))
        assert ("the time" in subjects(guess)) == is_doubted


def test_a_unit_that_is_unknown_or_that_the_motion_contradicts_is_doubted() -> None:
    table = flight_table()
    gon = dict.fromkeys(AXES, 200.0 / math.pi)
    doubts = subjects(proposed(scaled(table, {axis: f"{axis} [gon]" for axis in AXES}, gon)))
    assert {f"{axis}'s unit" for axis in AXES} <= doubts
    quarter = dict.fromkeys(AXES, 0.2)
    stated = {axis: f"{axis} [rad]" for axis in AXES}
    assert "the scale of elevation" in subjects(proposed(scaled(table, stated, quarter)))
    assert "the scale of elevation" not in subjects(proposed(scaled(table, stated, {})))


def test_a_unit_in_which_the_arm_turns_over_is_not_proposed() -> None:
    degrees = dict.fromkeys(AXES, 180.0 / math.pi)
    guess = proposed(scaled(flight_table(), {axis: f"{axis} [rad]" for axis in AXES}, degrees))
    assert {angle.unit for angle in guess.profile.angles.values()} == {"deg"}
    assert "pitch's unit" in subjects(guess)


@pytest.mark.parametrize("axis", AXES)
def test_a_rate_with_the_name_of_its_angle_is_doubted(axis: str) -> None:
    table = flight_table()
    assert f"{axis}'s column" not in subjects(sound_guess())
    rate = np.gradient(table.columns[axis].values, table.columns["t"].values)
    assert f"{axis}'s column" in subjects(
        proposed(replace(table, columns={**table.columns, axis: Column(rate)}))
    )


def test_two_motors_with_equal_voltages_are_doubted() -> None:
    table = flight_table()
    assert "the voltages' columns" not in subjects(sound_guess())
    equal = proposed(replace(table, columns={**table.columns, "back": table.columns["front"]}))
    (doubt,) = (each for each in equal.ambiguities if each.subject == "the voltages' columns")
    assert "equal in 100 % of the rows" in doubt.reason


def test_a_stated_share_of_the_supply_asks_for_the_supply() -> None:
    table = flight_table()
    shares = scaled(table, {m: f"{m} [%]" for m in PAIR}, dict.fromkeys(PAIR, 100.0 / 5.0))
    assert "the supply voltage" in subjects(proposed(shares))
    assert "the supply voltage" not in subjects(sound_guess())
    # A supply that is far from that of the rig file has to explain the hover.
    battery = {"battery [V]": Column(np.full(len(table), 12.0))}
    for supply_V in (5.0, 12.0):
        shares = scaled(table, {m: f"{m} [%]" for m in PAIR}, dict.fromkeys(PAIR, 100.0 / supply_V))
        questions = subjects(proposed(replace(shares, columns={**shares.columns, **battery})))
        assert ("the supply voltage" in questions) == (supply_V != 12.0)


def test_columns_that_names_or_units_call_voltages_are_no_setpoints() -> None:
    table = flight_table()
    names = {"sum [V]": "elevation", "difference [V]": "pitch"}
    followed = {name: Column(np.roll(table.columns[axis].values, -40)) for name, axis in names.items()}
    angles = {"qt" if name == "travel" else name: table.columns[name] for name in ("t", *AXES)}
    assert columns_of(proposed(replace(table, columns={**angles, **followed})))["sum"] == "sum [V]"


def test_a_setpoint_never_replaces_a_column_that_a_name_calls_measured() -> None:
    source = piloted("quanser-course", "travel", 3, 25.0)
    late = np.roll(source.flight.pitch_rad, 20)
    noisy = source.flight.pitch_rad + np.random.default_rng(1).normal(0.0, 0.01, late.size)
    table = flight_table(pitch_ref=source.flight.pitch_rad, pitch_real_data=noisy, front_current=late)
    guess = proposed(table)
    assert columns_of(guess)["pitch"] == "pitch_real_data"
    (left_out,) = (sentence for sentence in guess.evidence if sentence.startswith("left out"))
    assert "pitch_ref (a setpoint)" in left_out
    assert "pitch (pitch_real_data is measured)" in left_out
    assert "front_current (a current)" in left_out
    assert "the columns" not in subjects(guess)


def low_passed(values: Floats, time_constant_s: float, step_s: float) -> Floats:
    age_s = np.arange(0.0, 10.0 * time_constant_s, step_s)
    weight = np.exp(-age_s / time_constant_s)
    filtered: Floats = np.convolve(values - values[0], weight / weight.sum())[: values.size] + values[0]
    return filtered


@pytest.mark.parametrize("time_constant_s", [0.03, 0.2])
def test_a_filtered_copy_of_an_angle_is_no_third_angle(time_constant_s: float) -> None:
    source = piloted("quanser-course", "travel", 3, 25.0).flight
    copy = low_passed(source.pitch_rad, time_constant_s, source.step_s)
    table = flight_table(pitch2=copy)
    columns = {name: column for name, column in table.columns.items() if name != "travel"}
    with pytest.raises(
        FlightDataError, match=r"the only angles are elevation \(elevation\) and pitch \(pitch\)"
    ):
        proposed(replace(table, columns=columns))
    unnamed = {("t" if name == "t" else f"x{i}"): column for i, (name, column) in enumerate(columns.items())}
    with pytest.raises(FlightDataError, match=r"left out: x5 \(a filtered copy of x2\)"):
        proposed(replace(table, columns=unnamed))


def test_the_origin_of_a_filtered_copy_is_used_though_the_copy_comes_first() -> None:
    source = piloted("quanser-course", "travel", 3, 25.0).flight
    table = flight_table(pitch2=low_passed(source.pitch_rad, 0.1, source.step_s))
    guess = proposed(replace(table, columns=dict(list(table.columns.items())[::-1])))
    assert columns_of(guess)["pitch"] == "pitch"
    assert any("pitch2 (a filtered copy of pitch)" in sentence for sentence in guess.evidence)


def test_an_axis_that_follows_its_setpoint_closely_is_no_filtered_copy_of_it() -> None:
    source = piloted("quanser-course", "travel", 3, 25.0).flight
    smooth = low_passed(low_passed(source.travel_rad, 0.1, source.step_s)[::-1], 0.1, source.step_s)[::-1]
    guess = proposed(flight_table(travel3=np.concatenate((smooth[20:], np.full(20, smooth[-1])))))
    assert columns_of(guess)["travel"] == "travel" or "the columns" in subjects(guess)
    assert not any("travel (a filtered copy" in sentence for sentence in guess.evidence)


@pytest.mark.parametrize("missing", ["elevation", "pitch", "travel"])
def test_two_angles_are_refused_though_another_column_could_be_the_third(missing: str) -> None:
    rows = np.arange(piloted("quanser-course", "travel", 3, 25.0).flight.t_s.size)
    other = np.cumsum(np.random.default_rng(5).normal(size=rows.size)) * 1e-3
    table = flight_table(zz=other)
    columns = {name: column for name, column in table.columns.items() if name != missing}
    with pytest.raises(
        FlightDataError, match=rf"the only angles are .* three axes; add a column with {missing}"
    ):
        proposed(replace(table, columns=columns))
    columns[missing] = Column(np.ones(len(table)))
    with pytest.raises(FlightDataError, match=rf"the only angles are .* because '{missing}' is constant"):
        proposed(replace(table, columns=columns))


def test_names_that_the_motion_contradicts_are_kept_and_doubted() -> None:
    guess = proposed(renamed(flight_table(), elevation="travel", travel="elevation"))
    assert columns_of(guess)["elevation"] == "elevation"
    (doubt,) = (ambiguity for ambiguity in guess.ambiguities if ambiguity.subject == "the columns")
    assert "elevation is travel" in doubt.alternative and "disagree" in doubt.reason


def test_without_names_the_motion_proposes_columns_and_asks_for_a_profile() -> None:
    names = {"elevation": "x4", "pitch": "x2", "travel": "x0", "front": "x3", "back": "x1"}
    guess = proposed(renamed(flight_table(), **names))
    assert {role: columns_of(guess)[role] for role in ("elevation", "pitch", "travel")} == {
        "elevation": "x4",
        "pitch": "x2",
        "travel": "x0",
    }
    (doubt,) = (ambiguity for ambiguity in guess.ambiguities if ambiguity.subject == "the columns")
    assert "no name states elevation" in doubt.reason and "state them in a profile" in doubt.reason
    assert "a motor's current moves like its voltage" in doubt.reason


def test_a_counter_of_rows_is_no_angle_and_no_voltage_if_the_rate_is_given() -> None:
    table = renamed(flight_table(), t="x5", elevation="x4", pitch="x2", travel="x0", front="x3", back="x1")
    counted = replace(table, columns={**table.columns, "x5": Column(np.arange(len(table), dtype=float))})
    options = column_options([prepare_file(counted, REFERENCE, 200.0)], NOTHING_KNOWN)
    assert options.left_out["x5"] == "a counter of rows"
    assert options.columns() == ["x4", "x2", "x0", "x3", "x1"]


def test_two_motors_that_resemble_each_other_are_no_copies_if_their_amplifiers_limit_them() -> None:
    front_V = piloted("quanser-course", "travel", 3, 25.0).flight.voltages_V[:, 0]
    limit_V = float(np.quantile(front_V, 0.9))
    similar_V = low_passed(front_V, 0.03, 1e-3)
    table = flight_table(x3=np.minimum(front_V, limit_V), x1=np.minimum(similar_V, limit_V))
    kept = {name: column for name, column in table.columns.items() if name not in ("front", "back")}
    options = options_of(renamed(replace(table, columns=kept), elevation="x4", pitch="x2", travel="x0"))
    assert {"x1", "x3"} <= set(options.by_role["front"])


def test_without_names_a_file_without_travel_is_refused() -> None:
    table = flight_table()
    t_s = table.columns["t"].values
    columns = {**table.columns, "travel": Column(np.sin(1.3 * t_s) + 0.2 * np.sin(5.1 * t_s))}
    names = {"elevation": "x4", "pitch": "x2", "travel": "x0", "front": "x3", "back": "x1"}
    with pytest.raises(FlightDataError, match="no column moves like travel"):
        proposed(renamed(replace(table, columns=columns), **names))


@pytest.mark.parametrize(("other", "is_doubted"), [("{}_raw", True), ("{} [mV]", False)])
def test_two_voltages_of_a_motor_that_differ_by_a_gain_are_doubted(other: str, is_doubted: bool) -> None:
    table = flight_table()
    amplified = {other.format(motor): Column(0.8 * table.columns[motor].values) for motor in PAIR}
    guess = proposed(replace(table, columns={**amplified, **table.columns}))
    assert ("the columns" in subjects(guess)) == is_doubted


def test_names_that_contradict_the_motion_are_named_although_travel_has_none() -> None:
    table = renamed(flight_table(), elevation="alpha", pitch="theta", travel="phi")
    with pytest.raises(FlightDataError, match="elevation is alpha, pitch is theta, travel is phi"):
        proposed(table)


@pytest.mark.parametrize("is_off_first", [False, True])
def test_shares_against_which_elevation_rises_may_be_those_of_an_inverting_driver(is_off_first: bool) -> None:
    columns = dict(flight_table().columns)
    for motor in PAIR:
        inverted = 255.0 - np.round(51.0 * columns.pop(motor).values)
        inverted[:5] *= not is_off_first
        columns[f"{motor}_pwm"] = Column(inverted)
    assert ("elevation's sign" in subjects(proposed(Table("x.csv", columns)))) != is_off_first


def test_the_one_column_that_is_left_for_a_role_needs_no_name() -> None:
    guess = proposed(renamed(flight_table(), pitch="Pi"))
    assert columns_of(guess)["pitch"] == "Pi"
    assert "the columns" not in subjects(guess)


def test_the_name_of_one_matrix_says_nothing_of_its_columns() -> None:
    table = flight_table()
    numbered = [f"pc_ec_lam_r_p[{number}]" for number in range(1, len(table.columns) + 1)]
    options = options_of(replace(table, columns=dict(zip(numbered, table.columns.values(), strict=True))))
    assert not options.stated and not options.left_out


def options_of(table: Table) -> ColumnOptions:
    return column_options([prepare_file(table, REFERENCE, None)], NOTHING_KNOWN)


@pytest.mark.parametrize("gain", [1.0, 0.05], ids=["volts", "the size of the rate"])
def test_a_sum_that_follows_the_rate_of_elevation_is_no_copy_of_it(gain: float) -> None:
    source = piloted("quanser-course", "hands off", 3, 25.0)
    total = source.flight.voltages_V.sum(axis=1)
    added = {"w1": gain * (total - total.mean()), "w2": source.rates_rad_s[:, 0]}
    table = renamed(flight_table("hands off", **added), front="x1", back="x2")
    options = options_of(table)
    assert "w1" in options.by_role["sum"]
    assert options.left_out["w2"] == "the rate of elevation"


def test_a_known_column_keeps_its_role_against_its_name(tmp_path: Path) -> None:
    path = tmp_path / "known.toml"
    path.write_text('[front]\ncolumn = "back"\n[back]\ncolumn = "front"\n')
    guess = propose([flight_table()], RIG, known=read_known(path)).guess
    assert {guess.profile.voltages[role].column for role in ("front", "back")} == {"front", "back"}
    assert guess.profile.voltages["front"].column == "back"


def test_a_stated_unit_decides_and_the_motion_doubts_it() -> None:
    table = flight_table()
    columns = {
        name: replace(item, unit="deg") if name == "pitch" else item for name, item in table.columns.items()
    }
    guess = proposed(replace(table, columns=columns))
    assert guess.profile.angles["pitch"].unit == "deg"
    (doubt,) = (ambiguity for ambiguity in guess.ambiguities if ambiguity.subject == "pitch's unit")
    assert (doubt.chosen, doubt.alternative) == ("deg, as the header says", "rad")


@pytest.mark.parametrize("motor", ["front", "back"])
def test_an_unknown_unit_of_either_voltage_is_a_doubt(motor: str) -> None:
    guess = proposed(renamed(flight_table(), **{motor: f"{motor} [furlong]"}))
    doubts = [ambiguity.alternative for ambiguity in guess.ambiguities]
    assert "furlong, as the header says" in doubts


def test_commands_beyond_the_supply_do_not_change_their_unit() -> None:
    guess = proposed(flight_table("manual", commands=True))
    assert {item.unit for item in guess.profile.voltages.values()} == {"V"}


def test_a_file_without_voltages_is_refused_with_the_reason() -> None:
    table = flight_table()
    angles = {name: item for name, item in table.columns.items() if name not in ("front", "back")}
    with pytest.raises(FlightDataError, match="no column is a motor voltage") as refused:
        proposed(replace(table, columns=angles))
    assert "--one-flight" in refused.value.remedy
    t_s = table.columns["t"].values
    others = {"a": Column(t_s % 3.0), "b": Column(t_s % 7.0)}
    with pytest.raises(FlightDataError, match="no two columns act like motor voltages"):
        proposed(replace(table, columns={**angles, **others}))
    setpoints = {
        f"w{axis}": Column(np.roll(table.columns[axis].values, -40)) for axis in ("elevation", "pitch")
    }
    with pytest.raises(FlightDataError, match="as an axis follows its setpoint"):
        proposed(replace(table, columns={**angles, **setpoints}))
    repeated_s = Column(np.floor(t_s * 10.0) / 10.0)
    with pytest.raises(FlightDataError, match=r"the time is uncertain .* no column is a motor voltage"):
        proposed(replace(table, columns={"w": repeated_s, **{axis: angles[axis] for axis in AXES}}))
    with pytest.raises(
        FlightDataError, match=r"left out: front \(not numbers, such as 'off'\), back \(too few"
    ):
        sparse = np.where(np.arange(t_s.size) % 600 == 0, 1.0, np.nan)
        proposed(replace(table, columns={**angles, "back": Column(sparse)}, unread={"front": "off"}))
    few = {name: table.columns[name] for name in ("t", "pitch", "travel", "front")}
    with pytest.raises(FlightDataError, match=r"the only angles are pitch \(pitch\) and travel \(travel\)"):
        proposed(replace(table, columns=few))


@pytest.mark.parametrize("role", ["pitch", "front", "time"])
def test_a_stated_column_that_no_file_has_is_named(role: str) -> None:
    known = KnownEntries({role: {"column": "pich"}}, "mine.toml")
    with pytest.raises(FlightDataError, match="unknown column 'pich'"):
        guess_by_rigs([flight_table()], RIG, known=known)
