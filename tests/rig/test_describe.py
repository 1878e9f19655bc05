"""A rig described by its builder: by options, by a table, by answers; units, tolerances, sources."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from heli_sim.errors import RigError
from heli_sim.rig import load_rig
from heli_sim.rig.describe import number_from, numbers_from_table
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.cli.terminal import Terminal, refusal, terminal

__all__ = ["terminal"]

pytestmark = pytest.mark.medium


@pytest.mark.parametrize(
    ("name", "text", "value", "tolerance", "source"),
    [
        ("M_f", "355 g", 0.355, 0.00355, "stated by its builder; a kitchen scale's tolerance"),
        ("M_f", "0.355+-0.004 kg; scale", 0.355, 0.004, "scale"),
        ("L_a", "64 ± 0.5 cm", 0.64, 0.005, "stated by its builder"),
        ("L_a", " 0.64 ", 0.64, 0.005, "stated by its builder; a ruler's tolerance"),
        ("thrust_gain", "60 +- 3 g/V", 0.5886, 0.02943, "stated by its builder"),
        ("elevation_min", "-27 deg", -27.0, 2.7, "stated by its builder; tolerance assumed, 10 %"),
        ("encoder_counts", "4096", 4096.0, 0.0, "stated by its builder; exact"),
        ("encoder_counts_pitch", "1000", 1000.0, 0.0, "stated by its builder; exact"),
        ("encoder_direction_pitch", "-1", -1.0, 0.0, "stated by its builder; exact"),
        ("friction_pitch", "12 mN m s/rad", 0.012, 0.0012, "stated by its builder; tolerance assumed, 10 %"),
    ],
)
def test_number_is_read_as_people_write_it(
    name: str, text: str, value: float, tolerance: float, source: str
) -> None:
    read = number_from(name, text)
    assert read.value == pytest.approx(value)
    assert read.tolerance == pytest.approx(tolerance)
    assert read.source == source


@settings(max_examples=60, deadline=None)
@given(st.text(max_size=30))
def test_any_text_is_a_number_or_one_error(text: str) -> None:
    try:
        read = number_from("M_f", text)
    except RigError as error:
        assert "\n" not in str(error)
    else:
        assert read.unit == "kg"


@settings(max_examples=60, deadline=None)
@given(st.text(alphabet='name,valueuntM_f1.5\n"; -', max_size=80))
def test_any_table_is_numbers_or_one_error(text: str) -> None:
    try:
        numbers_from_table(text, "table")
    except RigError as error:
        assert str(error)


def test_rig_of_options_has_what_was_stated_and_the_rest_wide(terminal: Terminal) -> None:
    result = terminal("rig", "new", "mine.toml", "--set", "M_w=1.6 kg", "--set", "L_b=46+-0.3 cm; ruler")
    assert result.code == 0, result
    rig, like = load_rig("mine.toml"), load_rig("makki2024")
    assert rig.name == "mine"
    assert (rig["L_b"].value, rig["L_b"].tolerance, rig["L_b"].source) == (0.46, 0.003, "ruler")
    assert rig["M_h"].value == like["M_h"].value
    assert rig["M_h"].tolerance == pytest.approx(0.3 * like["M_h"].value)
    assert rig["M_h"].source == "not stated: as makki2024"
    assert rig["g"].tolerance == like["g"].tolerance
    assert rig["encoder_counts_pitch"].tolerance == 0.0
    assert "hovers at" in result.out


def test_table_and_options_go_together_and_options_win(terminal: Terminal) -> None:
    Path("mine.csv").write_text(
        "name, value, unit, tolerance, source\nM_w, 1.6, kg, 0.01, scale\nL_a,64,cm,,\n"
    )
    assert terminal("rig", "new", "mine.toml", "--table", "mine.csv", "--set", "L_a=65 cm").code == 0
    rig = load_rig("mine.toml")
    assert (rig["M_w"].value, rig["M_w"].tolerance, rig["M_w"].source) == (1.6, 0.01, "scale")
    assert rig["L_a"].value == 0.65


def test_answers_are_asked_again_until_they_can_be(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers = ["360 lb", "360 g", *([""] * 18)]
    monkeypatch.setattr("sys.stdin", io.StringIO("\n".join(answers) + "\n"))
    result = terminal("rig", "new", "mine.toml")
    assert result.code == 0, result
    assert "give it in kg or g" in result.out
    assert load_rig("mine.toml")["M_f"].value == pytest.approx(0.36)
    assert load_rig("mine.toml")["M_b"].source == "not stated: as makki2024"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--set", "M_x=1"), "unknown rig parameter 'M_x'"),
        (("--set", "M_f"), "does not set a parameter"),
        (("--set", "M_f=heavy"), "is not a number"),
        (("--set", "M_f=1 lb"), "give it in kg or g"),
        (("--set", "M_f=-1"), "M_f"),
        (("--table", "none.csv"), "cannot read none.csv: No such file or directory; check the path"),
        (("--table", "odd.csv"), "must have the columns"),
        (("--table", "twice.csv"), "twice"),
        (("--like", "nobodys", "--set", "M_f=1"), "unknown rig 'nobodys'"),
    ],
)
def test_the_impossible_is_one_line(terminal: Terminal, arguments: tuple[str, ...], message: str) -> None:
    Path("odd.csv").write_text("a,b\n1,2\n")
    Path("twice.csv").write_text("name,value\nM_f,0.3\nM_f,0.4\n")
    assert message in refusal(terminal("rig", "new", "mine.toml", *arguments), code=2)
    assert not Path("mine.toml").exists()


def test_rig_that_is_there_is_not_overwritten(terminal: Terminal) -> None:
    Path("mine.toml").write_text("mine")
    line = refusal(terminal("rig", "new", "mine.toml", "--set", "M_f=1"), code=5)
    assert "mine.toml exists, and heli-host did not write it" in line
    assert Path("mine.toml").read_text() == "mine"
    Path("mine.toml").unlink()
    assert terminal("rig", "new", "mine.toml", "--set", "M_f=355 g").code == 0
    assert "exists already" in refusal(terminal("rig", "new", "mine.toml", "--set", "M_f=1"), code=2)
