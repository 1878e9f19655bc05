"""A rig file is complete, and the claims of each shipped rig follow from its parameters."""

import io
import math
import re
from pathlib import Path

import numpy as np
import pytest
from heli_sim.errors import RigError
from heli_sim.model import MultibodyModel, PaperModel
from heli_sim.model.linear import linearise, trim
from heli_sim.rig import RIG_QUANTITIES, load_rig, rig_names
from heli_sim.rig.describe import number_from, numbers_from_table
from heli_sim.rig.schema import inertia_range_kg_m2, inertias_kg_m2
from heli_test_native import plant
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.cli.terminal import Terminal, refusal

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
