"""The claims of each shipped rig follow from its parameters."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from heli_sim.errors import RigError
from heli_sim.model import MultibodyModel, PaperModel
from heli_sim.model.linear import linearise, trim
from heli_sim.rig import load_rig, rig_names
from heli_sim.rig.inertia import inertia_range_kg_m2, inertias_kg_m2

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
