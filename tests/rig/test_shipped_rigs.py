"""The claims of each shipped rig follow from its parameters."""

from __future__ import annotations

import io
import re
from pathlib import Path

import numpy as np
import pytest
from heli_sim.errors import RigError
from heli_sim.model import MultibodyModel, PaperModel
from heli_sim.model.linear import linearise, trim
from heli_sim.rig import load_rig, rig_names
from heli_sim.rig.describe import number_from, numbers_from_table
from heli_sim.rig.schema import inertia_range_kg_m2, inertias_kg_m2
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.cli.terminal import Terminal, refusal, terminal

__all__ = [
    "terminal",
]


QUANSER = Path(__file__).parents[2] / "sim/heli_sim/rig/quanser-course.toml"
PER_DEG = 180.0 / np.pi


def values(name: str) -> dict[str, float]:
    return {key: number.value for key, number in load_rig(name).items()}


def file_with(tmp_path: Path, pattern: str, new: str) -> Path:
    text, count = re.subn(pattern, new, QUANSER.read_text(), count=1)
    assert count == 1
    path = tmp_path / "rig.toml"
    path.write_text(text)
    return path


@pytest.mark.parametrize("name", rig_names())
@pytest.mark.parametrize("model", [PaperModel(), MultibodyModel()], ids=lambda model: model.name)
def test_every_rig_can_hover_within_its_supply(name: str, model: PaperModel) -> None:
    rig = load_rig(name)
    assert (trim(model, rig).volts_V < rig["supply"].value).all()


@pytest.mark.slow
def test_identified_elevation_gives_back_table_4() -> None:
    rig = load_rig("makki2024-identified")
    at = trim(PaperModel(), rig)
    plant = linearise(PaperModel(), rig, at)
    gain = PER_DEG * plant.B[3].sum()
    assert gain == pytest.approx(59.201, rel=0.005)  # P_6
    assert plant.A[3, 3] == pytest.approx(-0.3366, rel=0.005)  # P_4
    # P_1 + P_2 + P_5 + P_6 U = 0 at level: hover at 7.37 V on each motor.
    assert at.volts_V.mean() == pytest.approx((56.57475 - 0.83576 + 380.789) / 59.201, rel=0.002)
    assert rig["dead_zone"].value == pytest.approx(56.57475 / 59.201, abs=1e-4)


@pytest.mark.medium
def test_identified_pitch_gives_back_table_3_without_its_input_gain() -> None:
    rig = load_rig("makki2024-identified")
    plant = linearise(PaperModel(), rig)
    assert plant.A[4, 1] == pytest.approx(-6.323, rel=0.005)  # P_8
    assert plant.A[4, 4] == pytest.approx(-1.395, rel=0.005)  # P_9
    assert (plant.B[4, 0] - plant.B[4, 1]) / 2 == pytest.approx(0.6177 * 0.275 / 0.05485, rel=0.005)
    assert abs(plant.B[4, 0]) < 96.728 / 20  # P_11 fits no unit


def test_the_courses_rig_hovers_at_the_courses_voltage_and_has_its_inertias() -> None:
    rig = load_rig("quanser-course")
    assert 7.0 <= trim(MultibodyModel(), rig).volts_V.sum() <= 7.55
    inertias = inertias_kg_m2(values("quanser-course"))
    assert inertias["J_theta"] == pytest.approx(1.034, abs=1e-3)
    assert inertias["J_phi"] == pytest.approx(0.0441, abs=1e-4)
    assert inertias["J_psi"] == pytest.approx(1.078, abs=1e-3)


def test_inertias_of_table_2_are_the_multibody_models() -> None:
    rig, model = load_rig("makki2024"), MultibodyModel()
    import casadi as ca

    x = ca.SX.sym("x", 6)
    at = model.operands(x, ca.SX.zeros(2), ca.SX(ca.DM(model.parameter_values(rig))))
    diagonal = np.diag(np.asarray(ca.Function("M", [x], [model.inertia_kg_m2(at)])(np.zeros(6))))
    assert list(inertias_kg_m2(values("makki2024")).values()) == pytest.approx(diagonal, rel=1e-12)


def test_table_2s_own_elevation_inertia_is_no_arrangement_of_its_masses(tmp_path: Path) -> None:
    paper = QUANSER.with_name("makki2024.toml").read_text()
    path = tmp_path / "rig.toml"
    path.write_text(
        paper + '\n[J_theta]\nvalue = 0.8496\nunit = "kg m2"\ntolerance = 0.0\nsource = "Table 2"\n'
    )
    with pytest.raises(RigError, match=r"makki2024.*J_theta = 0\.8496 kg m2 is impossible"):
        load_rig(path)


@pytest.mark.parametrize("name", ["J_theta", "J_phi", "J_psi"])
@pytest.mark.parametrize("value", ["2.0", "0.001", "-1.0"])
def test_an_inertia_that_the_masses_cannot_give_is_refused_by_name(
    tmp_path: Path, name: str, value: str
) -> None:
    with pytest.raises(RigError, match=f"quanser-course.*{name}.*is impossible"):
        load_rig(file_with(tmp_path, rf"(\[{name}\]\nvalue = )[\d.]+", rf"\g<1>{value}"))


def test_a_stated_inertia_in_other_units_or_not_finite_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RigError, match="J_phi is in 'g m2'"):
        load_rig(file_with(tmp_path, r'(\[J_phi\]\nvalue = 0.0441\nunit = ")kg m2', r"\g<1>g m2"))
    with pytest.raises(RigError, match="J_phi = nan"):
        load_rig(file_with(tmp_path, r"(\[J_phi\]\nvalue = )0.0441", r"\g<1>nan"))


def test_a_negative_mass_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(RigError, match=r"quanser-course': M_w = -1\.92 must not be negative"):
        load_rig(file_with(tmp_path, r"(\[M_w\]\nvalue = )", r"\g<1>-"))


def test_every_arrangement_within_the_tolerances_is_within_the_range() -> None:
    rig = load_rig("makki2024")
    names = [name for name in rig if name.startswith(("M_", "L_"))]
    centre = {name: rig[name].value for name in names}
    spread = {name: rig[name].tolerance for name in names}
    possible = inertia_range_kg_m2(centre, spread)
    random = np.random.default_rng(4)
    for _ in range(200):
        drawn = {name: centre[name] + random.uniform(-1, 1) * spread[name] for name in names}
        for name, value in inertias_kg_m2(drawn).items():
            assert possible[name][0] <= value <= possible[name][1]


@pytest.mark.medium
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


@pytest.mark.medium
@settings(max_examples=60, deadline=None)
@given(st.text(max_size=30))
def test_any_text_is_a_number_or_one_error(text: str) -> None:
    try:
        read = number_from("M_f", text)
    except RigError as error:
        assert "\n" not in str(error)
    else:
        assert read.unit == "kg"


@pytest.mark.medium
@settings(max_examples=60, deadline=None)
@given(st.text(alphabet='name,valueuntM_f1.5\n"; -', max_size=80))
def test_any_table_is_numbers_or_one_error(text: str) -> None:
    try:
        numbers_from_table(text, "table")
    except RigError as error:
        assert str(error)


@pytest.mark.medium
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


@pytest.mark.medium
def test_table_and_options_go_together_and_options_win(terminal: Terminal) -> None:
    Path("mine.csv").write_text(
        "name, value, unit, tolerance, source\nM_w, 1.6, kg, 0.01, scale\nL_a,64,cm,,\n"
    )
    assert terminal("rig", "new", "mine.toml", "--table", "mine.csv", "--set", "L_a=65 cm").code == 0
    rig = load_rig("mine.toml")
    assert (rig["M_w"].value, rig["M_w"].tolerance, rig["M_w"].source) == (1.6, 0.01, "scale")
    assert rig["L_a"].value == 0.65


@pytest.mark.medium
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


@pytest.mark.medium
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


@pytest.mark.medium
def test_rig_that_is_there_is_not_overwritten(terminal: Terminal) -> None:
    Path("mine.toml").write_text("mine")
    line = refusal(terminal("rig", "new", "mine.toml", "--set", "M_f=1"), code=5)
    assert "mine.toml exists, and heli-host did not write it" in line
    assert Path("mine.toml").read_text() == "mine"
    Path("mine.toml").unlink()
    assert terminal("rig", "new", "mine.toml", "--set", "M_f=355 g").code == 0
    assert "exists already" in refusal(terminal("rig", "new", "mine.toml", "--set", "M_f=1"), code=2)
