"""The paper's model gives the numbers that follow from its Table 2, and effects act where they say."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from heli_sim.errors import PlantError
from heli_sim.model import PaperModel

from tests.plant.toys import ConstantTorque, FirstOrderLag, TiltedEncoder, paper_rig, rates

LEVEL = np.zeros(6)
HOVER_V = 1.7028


def test_inertias_are_those_of_27_to_29_and_not_table_2s_elevation() -> None:
    model = PaperModel()
    p = ca.SX.sym("p", len(model.parameters))
    at = model.operands(ca.SX.zeros(6), ca.SX.zeros(2), p)
    values = ca.Function("J", [p], [model.inertia_kg_m2(at)])(model.parameter_values(paper_rig()))
    assert np.asarray(values).ravel() == pytest.approx([0.7675, 0.0547, 0.8195], abs=5e-5)


def test_hover_at_level_needs_1_70_V_on_each_motor() -> None:
    from scipy.optimize import brentq

    model, rig = PaperModel(), paper_rig()
    hover_V = brentq(lambda volts: rates(model, rig, LEVEL, (volts, volts))[3], 1.0, 5.0)
    assert hover_V == pytest.approx(1.70, abs=0.005)


def test_at_rest_the_arm_presses_on_the_table_and_below_the_dead_zone_voltage_does_nothing() -> None:
    model, rig = PaperModel(), paper_rig()
    on_table = np.array([np.deg2rad(-25.0), 0, 0, 0, 0, 0])
    off = rates(model, rig, on_table, (0.0, 0.0))
    assert off[3] < 0.0
    assert rates(model, rig, on_table, (1.0, 1.0)) == pytest.approx(off)
    assert rates(model, rig, on_table, (-12.0, -12.0)) == pytest.approx(off)


def test_pitch_coefficients_are_those_printed_below_30() -> None:
    model, rig = PaperModel(), paper_rig()
    tilted = np.array([0.0, np.pi / 2, 0, 0, 0, 0])
    assert rates(model, rig, tilted, (0.0, 0.0))[4] == pytest.approx(-5.81, abs=0.01)  # P_8
    gain = rates(model, rig, LEVEL, (3.0, 2.0))[4]
    assert gain == pytest.approx(0.5839 * 0.275 / 0.05466, rel=1e-3)  # P_11


def test_elevation_and_travel_gains_are_those_printed_below_30() -> None:
    model, rig = PaperModel(), paper_rig()
    step = rates(model, rig, LEVEL, (2.5, 2.5)) - rates(model, rig, LEVEL, (2.0, 2.0))
    assert step[3] == pytest.approx(0.5839 * 0.64 / 0.76753, rel=1e-4)  # P_6
    tilted = np.array([0.0, 0.3, 0, 0, 0, 0])
    step = rates(model, rig, tilted, (2.5, 2.5)) - rates(model, rig, tilted, (2.0, 2.0))
    assert step[5] == pytest.approx(0.5839 * 0.64 / 0.81951 * np.sin(0.3), rel=1e-4)  # P_17


def test_positive_pitch_accelerates_travel_and_a_differential_voltage_alone_does_not() -> None:
    model, rig = PaperModel(), paper_rig()
    tilted = np.array([0.0, 0.2, 0, 0, 0, 0])
    assert rates(model, rig, tilted, (HOVER_V, HOVER_V))[5] > 0.0
    same_sum = rates(model, rig, tilted, (HOVER_V + 0.5, HOVER_V - 0.5))
    assert same_sum[5] == pytest.approx(rates(model, rig, tilted, (HOVER_V, HOVER_V))[5])  # no P_18


@pytest.mark.parametrize("pitch_rad", [-0.5, 0.0, 0.5])
@pytest.mark.parametrize("rate_rad_s", [-1.0, 1.0])
def test_drag_opposes_travel_at_either_pitch(pitch_rad: float, rate_rad_s: float) -> None:
    model, still = PaperModel(), paper_rig(friction_travel=0.0)
    moving = np.array([0.0, pitch_rad, 0.0, 0.0, 0.0, rate_rad_s])
    assert rates(model, still, moving, (0.0, 0.0))[5] * rate_rad_s < 0.0


def test_an_effect_may_bring_states_that_the_thrust_follows() -> None:
    model, rig = PaperModel((FirstOrderLag(0.1),)), paper_rig()
    assert [state.name for state in model.states[6:]] == ["front_N", "back_N"]
    start = rates(model, rig, np.zeros(8), (2.0, 3.0))
    assert start[6:] == pytest.approx([5.839, 11.678])
    settled = rates(model, rig, [0, 0, 0, 0, 0, 0, 0.5839, 1.1678], (2.0, 3.0))
    assert settled[:6] == pytest.approx(rates(PaperModel(), rig, LEVEL, (2.0, 3.0)))


def test_an_effect_may_add_a_torque() -> None:
    rig = paper_rig()
    pushed = rates(PaperModel((ConstantTorque(0.0819512),)), rig, LEVEL, (0.0, 0.0))
    assert pushed[5] == pytest.approx(0.1, rel=1e-4)


def test_an_effect_may_change_what_an_encoder_sees() -> None:
    model = PaperModel((TiltedEncoder(),))
    x, u = ca.SX.sym("x", 6), ca.SX.sym("u", 2)
    p = ca.SX.sym("p", len(model.parameters))
    see = ca.Function("see", [x, u, p], [model.measurement(x, u, p)])
    seen = see([0.1, 0.5, -0.2, 0, 0, 0], [0, 0], model.parameter_values(paper_rig()))
    assert np.asarray(seen).ravel() == pytest.approx([0.15, 0.5, -0.2])


def test_effects_that_share_a_name_are_refused() -> None:
    with pytest.raises(PlantError, match="front_N"):
        PaperModel((FirstOrderLag(0.1), FirstOrderLag(0.2)))


def test_a_reversed_rotor_pushes_down_only_on_a_rig_whose_drivers_reverse() -> None:
    model = PaperModel()
    non_negative, two_way = paper_rig(), paper_rig(reverse_thrust=0.6)
    backwards = (
        rates(model, two_way, LEVEL, (-3.0, -3.0))[3] - rates(model, non_negative, LEVEL, (-3.0, -3.0))[3]
    )
    forwards = rates(model, two_way, LEVEL, (3.0, 3.0))[3] - rates(model, two_way, LEVEL, (0.0, 0.0))[3]
    assert backwards == pytest.approx(-0.6 * forwards)


def test_a_constant_torque_accelerates_its_own_axis() -> None:
    still = rates(PaperModel(), paper_rig(), LEVEL, (HOVER_V, HOVER_V))
    pulled = rates(PaperModel(), paper_rig(torque_travel=0.05), LEVEL, (HOVER_V, HOVER_V))
    assert pulled - still == pytest.approx([0, 0, 0, 0, 0, 0.05 / 0.8195], abs=1e-4)


def test_an_encoder_zeroed_while_the_arm_was_not_level_shows_its_offset() -> None:
    model, rig = PaperModel(), paper_rig(offset_pitch=2.0)
    x, u = ca.SX.sym("x", 6), ca.SX.sym("u", 2)
    p = ca.SX.sym("p", len(model.parameters))
    shown = ca.Function("shown", [x, u, p], [model.measurement(x, u, p)])
    angles = np.asarray(shown([0.1, 0.2, 0.3, 0, 0, 0], [1, 1], model.parameter_values(rig))).ravel()
    assert np.rad2deg(angles - [0.1, 0.2, 0.3]) == pytest.approx([0.0, 2.0, 0.0])
