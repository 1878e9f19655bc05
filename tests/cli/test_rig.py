"""`heli-host rig`: numbers with unit, tolerance and source; a rig that cannot be is refused by name."""

import json
import math
import re
from pathlib import Path

import pytest
from heli_sim.rig import RIG_QUANTITIES, load_rig, rig_names, write_rig
from heli_sim.rig.describe import Difference, compare_rigs
from heli_sim.rig.rig import Number
from hypothesis import given
from hypothesis import strategies as st

from tests.cli.terminal import Terminal, refusal

pytestmark = pytest.mark.medium

ASKED = 2
PAPER = Path(__file__).parents[2] / "sim/heli_sim/rig/makki2024.toml"


def spoiled(tmp_path: Path, old: str, new: str) -> Path:
    text = PAPER.read_text()
    assert old in text
    path = tmp_path / "mine.toml"
    path.write_text(text.replace(old, new, 1))
    return path


def test_list_names_every_rig_of_the_package(terminal: Terminal) -> None:
    lines = terminal("rig", "list").out.splitlines()
    assert [line.partition(":")[0] for line in lines] == rig_names()


@pytest.mark.parametrize("name", rig_names())
def test_show_has_value_tolerance_unit_and_source_of_every_number(terminal: Terminal, name: str) -> None:
    result = terminal("rig", "show", name)
    assert result.code == 0, result
    words = " ".join(result.out.split())
    for quantity in RIG_QUANTITIES:
        number = load_rig(name)[quantity.name]
        width = f"{number.tolerance:g}" if number.tolerance else "exact"
        assert f"{quantity.name} {number.value:g} {width} {quantity.unit} " in words
        assert number.source.split()[-1] in words


def test_show_finds_some_numbers_by_a_part_of_their_name(terminal: Terminal) -> None:
    out = terminal("rig", "show", "makki2024", "friction").out
    assert "friction_pitch" in out
    assert "thrust_gain" not in out
    assert "frictoin" in refusal(terminal("rig", "show", "makki2024", "frictoin"), code=ASKED)


def test_check_says_what_the_numbers_give(terminal: Terminal) -> None:
    out = terminal("rig", "check", "makki2024").out
    # Table 2 prints J_phi = 0.0546 and J_psi = 0.8195, and 1.7 V at hover follows from it.
    assert re.search(r"J_phi 0\.0546\d?, J_psi 0\.81", out)
    assert "hovers at 1.70 and 1.70 V" in out


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("value = 1.565", "value = -1.565", "M_w"),
        ('[g]\nvalue = 9.81\nunit = "m/s2"', '[g]\nvalue = 9.81\nunit = "m/s"', "m/s2"),
        (
            "# Rotors\n",
            '[J_theta]\nvalue = 0.8496\nunit = "kg m2"\ntolerance = 0\nsource = "Table 2"\n',
            "J_theta",
        ),
    ],
    ids=["negative mass", "unit", "inertia of Table 2"],
)
def test_check_refuses_a_rig_that_cannot_be_by_name(
    terminal: Terminal, tmp_path: Path, old: str, new: str, says: str
) -> None:
    line = refusal(terminal("rig", "check", spoiled(tmp_path, old, new)), code=ASKED)
    assert "makki2024" in line
    assert says in line


def test_check_goes_on_after_a_rig_that_cannot_be(terminal: Terminal, tmp_path: Path) -> None:
    bad = spoiled(tmp_path, "value = 1.565", "value = nan")
    result = terminal("rig", "check", bad, "makki2024")
    assert "1 of 2" in refusal(result, code=ASKED)
    assert "M_w = nan is not finite" in result.out
    assert "makki2024: 3" in result.out


def test_check_ends_with_1_when_a_rig_is_too_heavy_for_its_supply(terminal: Terminal, tmp_path: Path) -> None:
    for old, new, says in (
        ("value = 0.5839", "value = 0.02", "it cannot fly"),
        ("value = 1.565", "value = 9.0", "does not hover"),
    ):
        rig = spoiled(tmp_path, old, new)
        result = terminal("rig", "check", rig, "quanser-course")
        assert result.code == 1 and says in result.out and not result.err
        result = terminal("rig", "check", rig, "--json", "-")
        [report] = json.loads(result.out)["rigs"]
        assert result.code == 1 and report["is_valid"] and not report["can_fly"]
    assert terminal("rig", "check", *rig_names()).code == 0


@pytest.mark.parametrize("what", ["value", "tolerance"])
@pytest.mark.parametrize("number", ["1e308", "-1e308", "1e-308"])
def test_a_number_beyond_calculation_is_refused_by_name(
    terminal: Terminal, tmp_path: Path, what: str, number: str
) -> None:
    text = PAPER.read_text()
    name = ""
    lines = text.splitlines()
    for k, line in enumerate(lines):
        name = line.strip("[]") if line.startswith("[") else name
        if line.startswith(f"{what} = "):
            path = tmp_path / "mine.toml"
            path.write_text("\n".join([*lines[:k], f"{what} = {number}", *lines[k + 1 :]]))
            message = refusal(terminal("rig", "check", path), code=ASKED)
            assert f"mine.toml: {name} has the {what} {float(number):g} " in message
            assert "; give 0 or a size from 1e-09 to " in message


def test_a_number_beyond_calculation_of_an_effect_is_refused_by_name(
    terminal: Terminal, tmp_path: Path
) -> None:
    path = tmp_path / "mine.toml"
    lag = '[effects.rotor_lag.time_constant]\nvalue = 1e308\nunit = "s"\ntolerance = 0.0\nsource = "x"\n'
    path.write_text(PAPER.read_text() + lag)
    message = refusal(terminal("rig", "check", path), code=ASKED)
    assert "effects.rotor_lag.time_constant has the value 1e+308 s; give 0 or a size from" in message


def test_numbers_that_no_table_bears_are_named(terminal: Terminal, tmp_path: Path) -> None:
    result = terminal("rig", "check", spoiled(tmp_path, "value = 0.45", "value = 45.0"))
    assert "L_b = 45 m is outside 0.02 to 3 m, the range of a table-top rig" in result.out
    for stated in ("L_a=64", "M_w=1565", "M_f=0.0035", "thrust_gain=58", "encoder_counts_pitch=4"):
        arguments = ("rig", "new", "new.toml", "--set", stated)
        line = refusal(terminal(*arguments), code=ASKED)
        assert f"{stated.partition('=')[0]} = " in line and "the range of a table-top rig; " in line
        assert not Path("new.toml").exists()
    assert terminal("rig", "new", "new.toml", "--set", "L_a=3.5", "--force").code == 0
    assert "L_a = 3.5 m is outside 0.1 to 3 m" in terminal("rig", "check", "new.toml").out
    for name in rig_names():
        assert "range of a table-top rig" not in terminal("rig", "check", name).out


def test_diff_counts_in_tolerances_and_marks_what_is_beyond(terminal: Terminal) -> None:
    out = terminal("rig", "diff", "makki2024", "makki2024-identified").out
    [gain] = [line for line in out.splitlines() if line.startswith("thrust_gain")]
    # (0.6177 - 0.5839) / hypot(0.12, 0.0104)
    assert gain.split()[-1] == "+0.3"
    [torque] = [line for line in out.splitlines() if line.startswith("torque_elevation")]
    assert torque.rstrip().endswith("*")
    assert "M_w" not in out


def test_a_rig_does_not_differ_from_itself_written_and_read(terminal: Terminal, tmp_path: Path) -> None:
    write_rig(load_rig("quanser-course"), tmp_path / "same.toml")
    result = terminal("rig", "diff", "quanser-course", "same.toml")
    assert result.code == 0, result
    assert result.out.startswith("0 of ")
    assert "thrust_gain" in terminal("rig", "diff", "quanser-course", "same.toml", "--all").out


def test_two_rigs_of_one_name_are_named_by_their_files(terminal: Terminal, tmp_path: Path) -> None:
    write_rig(load_rig("makki2024").replace(M_w=1.6), tmp_path / "heavy.toml")
    head = terminal("rig", "diff", "makki2024", "heavy.toml").out.splitlines()[0]
    assert head.split() == ["name", "makki2024", "heavy.toml", "unit", "tolerances"]


def test_an_unknown_rig_lists_those_that_there_are(terminal: Terminal) -> None:
    for verb in (("show", "mars"), ("check", "mars"), ("diff", "makki2024", "mars")):
        assert "makki2024" in refusal(terminal("rig", *verb), code=ASKED)


NUMBERS = st.builds(
    Number, value=st.floats(-1e3, 1e3), unit=st.just("m"), tolerance=st.floats(0.0, 10.0), source=st.just("s")
)


@given(NUMBERS, NUMBERS)
def test_a_difference_is_the_same_from_either_side(left: Number, right: Number) -> None:
    there, back = Difference("L_a", left, right), Difference("L_a", right, left)
    assert there.same == back.same
    assert there.tolerances == -back.tolerances


def test_what_only_one_rig_has_and_what_is_exact_differ_without_measure() -> None:
    exact, other = Number(4096.0, "count", 0.0, "s"), Number(8192.0, "count", 0.0, "s")
    assert math.isinf(Difference("encoder_counts", exact, other).tolerances)
    assert math.isinf(Difference("lag", None, exact).tolerances)


def test_the_largest_difference_comes_first() -> None:
    rig = load_rig("makki2024")
    other = rig.replace(M_w=1.565 + 0.1, L_a=0.65)
    names = [difference.name for difference in compare_rigs(rig, other)]
    assert names[:2] == ["M_w", "L_a"]
