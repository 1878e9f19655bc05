"""A rig file is complete, in the right units, and names its sources; encoders of a rig."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from heli_sim.errors import RigError
from heli_sim.rig import RIG_QUANTITIES, load_rig, rig_names
from heli_test_native import plant
from hypothesis import given
from hypothesis import strategies as st

PAPER = Path(__file__).parents[2] / "sim/heli_sim/rig/makki2024.toml"


def spoiled(tmp_path: Path, old: str, new: str) -> Path:
    text = PAPER.read_text()
    assert old in text
    path = tmp_path / "rig.toml"
    path.write_text(text.replace(old, new, 1))
    return path


@pytest.mark.parametrize("name", rig_names())
def test_every_rig_of_the_package_is_complete_and_sourced(name: str) -> None:
    rig = load_rig(name)
    assert set(rig) == {quantity.name for quantity in RIG_QUANTITIES}
    assert all(len(number.source) > 5 for number in rig.values())


def test_the_counterweight_arm_is_the_second_length_printed_as_L_h() -> None:
    rig = load_rig("makki2024")
    assert rig["L_h"].value == 0.275
    assert rig["L_b"].value == 0.45
    assert rig["L_b"].unit == "m"


def test_a_rig_is_read_from_a_file() -> None:
    assert load_rig(PAPER) == load_rig("makki2024")


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("[M_w]", "[M_weight]", "M_weight"),
        ('unit = "kg"', 'unit = "g"', "'kg'"),
        ("value = 0.355", "value = nan", "not finite"),
        ("value = 0.355", "value = inf", "not finite"),
        ("value = 0.355", "value = -0.355", "negative"),
        ("value = 0.355", "value = 0", "0"),
        ("value = 0.355", "value = true", "number"),
        ("value = 0.355", 'value = "0.355"', "number"),
        ("tolerance = 0.004", "tolerance = -1", "tolerance"),
        ("tolerance = 0.004", "tolerance = nan", "tolerance"),
        ("tolerance = 0.004\n", "", "tolerance"),
        ('source = "Table 2"', 'source = ""', "source"),
        ('source = "Table 2"', 'source = "Table 2"\ncolour = "red"', "colour"),
        ('name = "makki2024"', "", "name"),
        ("value = -25.0", "value = 30.0", "elevation_min"),
        ('value = 0.06\nunit = "1"', 'value = 0.5\nunit = "1"', "driver_dead_band"),
        ("[M_f]", "[M_f", "TOML"),
    ],
)
def test_a_spoiled_rig_is_refused_in_one_line(tmp_path: Path, old: str, new: str, says: str) -> None:
    with pytest.raises(RigError, match=says) as error:
        load_rig(spoiled(tmp_path, old, new))
    assert "\n" not in str(error.value)


def test_a_missing_number_is_named(tmp_path: Path) -> None:
    text = PAPER.read_text()
    start = text.index("[M_l]")
    path = tmp_path / "rig.toml"
    path.write_text(text[:start] + text[text.index("# Lengths") :])
    with pytest.raises(RigError, match="lacks M_l"):
        load_rig(path)


@pytest.mark.parametrize("name", ["nosuchrig", "/no/such/file", "", "../rig/schema"])
def test_an_unknown_rig_is_refused_with_the_known_ones(name: str) -> None:
    with pytest.raises(RigError, match="makki2024"):
        load_rig(name)


def test_replace_changes_a_copy_only() -> None:
    rig = load_rig("makki2024")
    heavier = rig.replace(M_w=1.6)
    assert (rig["M_w"].value, heavier["M_w"].value) == (1.565, 1.6)
    assert heavier["M_w"].source == rig["M_w"].source
    with pytest.raises(RigError, match="M_x"):
        rig.replace(M_x=1.0)
    with pytest.raises(RigError, match="not finite"):
        rig.replace(M_w=float("nan"))


def test_a_rig_cannot_be_changed_in_place() -> None:
    rig = load_rig("makki2024")
    with pytest.raises(TypeError):
        rig.numbers["M_w"] = rig["M_f"]  # type: ignore[index]
    with pytest.raises(AttributeError):
        rig["M_w"].value = 2.0  # type: ignore[misc]


def test_a_rig_that_states_no_cable_torque_has_none_and_says_so() -> None:
    number = load_rig("makki2024")["torque_travel"]
    assert number.value == 0.0
    assert number.tolerance > 0.0
    assert number.source.startswith("not stated")


PER_RAD = [4096 / (2 * math.pi)] * 3

angles = st.lists(st.floats(-4.0, 4.0), min_size=3, max_size=3)
# At most 7 rad/s, the fastest that the board tolerates in pitch.
moves = st.lists(st.floats(-0.007, 0.007), min_size=3, max_size=3)
offsets = st.lists(st.floats(-1e5, 1e5), min_size=3, max_size=3)


@pytest.mark.medium
@given(start=angles, steps=st.lists(moves, min_size=1, max_size=20), offset=offsets)
def test_edges_add_up_to_the_counts(
    start: list[float], steps: list[list[float]], offset: list[float]
) -> None:
    at, counted = start, np.array(plant.encoder_counts(start, PER_RAD, offset))
    for step in steps:
        to = [angle + change for angle, change in zip(at, step, strict=True)]
        for _, axis, direction in plant.encoder_edges(at, to, PER_RAD, offset):
            counted[axis] += direction
        assert counted.tolist() == plant.encoder_counts(to, PER_RAD, offset)
        at = to


@pytest.mark.medium
@given(start=angles, step=moves, offset=offsets)
def test_edges_come_in_order_and_within_the_millisecond(
    start: list[float], step: list[float], offset: list[float]
) -> None:
    to = [angle + change for angle, change in zip(start, step, strict=True)]
    times = [time_us for time_us, _, _ in plant.encoder_edges(start, to, PER_RAD, offset)]
    assert times == sorted(times)
    assert all(0.0 <= time_us < 1000.0 for time_us in times)


def test_an_edge_comes_when_the_angle_crosses_the_line() -> None:
    half_count = 0.5 / PER_RAD[0]
    low, high = 0.5 * half_count, 4.5 * half_count
    up = plant.encoder_edges([low, 0, 0], [high, 0, 0], PER_RAD, [0] * 3)
    assert [(axis, direction) for _, axis, direction in up] == [(0, 1), (0, 1)]
    assert [time_us for time_us, _, _ in up] == pytest.approx([375.0, 875.0])
    down = plant.encoder_edges([high, 0, 0], [low, 0, 0], PER_RAD, [0] * 3)
    assert [(axis, direction) for _, axis, direction in down] == [(0, -1), (0, -1)]
    assert [time_us for time_us, _, _ in down] == pytest.approx([125.0, 625.0])


def test_a_revolution_is_4096_counts() -> None:
    zero = plant.encoder_counts([0.0] * 3, PER_RAD, [0.5] * 3)
    turned = plant.encoder_counts([2 * math.pi] * 3, PER_RAD, [0.5] * 3)
    assert [b - a for a, b in zip(zero, turned, strict=True)] == [4096] * 3


def test_a_count_is_the_whole_number_below() -> None:
    counts = plant.encoder_counts([-0.5 / PER_RAD[0], 0.5 / PER_RAD[0], 1.5 / PER_RAD[0]], PER_RAD, [0] * 3)
    assert counts == [-1, 0, 1]
