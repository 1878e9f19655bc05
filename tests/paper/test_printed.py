"""The equations as printed: right where the corrected ones are, and each slip does what it says."""

from __future__ import annotations

import math

import numpy as np
import pytest
from heli_lab.apps.paper.lumped import analytic, printed_inertias_kg_m2
from heli_sim.model import MultibodyModel, PaperModel, PaperPrintedModel
from heli_sim.rig import load_rig

from tests.model.toys import rates

RIG = load_rig("makki2024")
PRINTED, CORRECTED = PaperPrintedModel(), PaperModel()
HOVER = (1.7028, 1.7028)


@pytest.mark.parametrize("elevation", [-0.4, 0.0, 0.3])
def test_14_and_16_are_the_same_equation(elevation: float) -> None:
    state = np.array([elevation, 0.0, 0.0, 0.2, 0.0, 0.0])
    assert rates(PRINTED, RIG, state, HOVER)[3] == pytest.approx(rates(CORRECTED, RIG, state, HOVER)[3])


def test_19_adds_metres_to_an_angle_and_so_turns_a_level_arm_with_equal_rotors() -> None:
    level = rates(PRINTED, RIG, np.zeros(6), HOVER)
    assert level[4] == pytest.approx(-0.558, abs=0.001)
    assert rates(CORRECTED, RIG, np.zeros(6), HOVER)[4] == 0.0


def test_31_without_a_dead_zone_pulls_the_arm_down_at_0_V_by_P_1() -> None:
    state = np.zeros(6)
    pulled = rates(PRINTED, RIG, state, (0.0, 0.0))[3] - rates(CORRECTED, RIG, state, (0.0, 0.0))[3]
    assert pulled == pytest.approx(analytic(RIG)["P_1"])
    assert analytic(RIG)["P_1"] == pytest.approx(-1.1678 * 0.64 / 0.76753, rel=1e-4)


def test_drag_as_printed_drives_a_negative_travel_on() -> None:
    coasting = np.array([0.0, 0.0, 0.0, 0.0, 0.0, -1.0])
    still = RIG.replace(friction_travel=0.0)
    assert rates(PRINTED, still, coasting, (0.0, 0.0))[5] < 0.0
    assert rates(CORRECTED, still, coasting, (0.0, 0.0))[5] > 0.0


def test_drag_as_printed_lacks_its_arm() -> None:
    coasting = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    still = RIG.replace(friction_travel=0.0)
    printed, corrected = (rates(m, still, coasting, (0.0, 0.0))[5] for m in (PRINTED, CORRECTED))
    assert printed * 0.64 == pytest.approx(corrected)


def test_24_turns_travel_by_a_difference_of_thrusts_at_level_elevation_and_a_multibody_model_does_not() -> (
    None
):
    """At elevation, a difference turns travel, with the arm -L_h sin(elevation)."""
    tilted = np.array([0.0, 0.3, 0.0, 0.0, 0.0, 0.0])
    more, less = (HOVER[0] + 0.2, HOVER[1] - 0.2), (HOVER[0] - 0.2, HOVER[1] + 0.2)
    turned = rates(PRINTED, RIG, tilted, more)[5] - rates(PRINTED, RIG, tilted, less)[5]
    inertia = printed_inertias_kg_m2(RIG, 0.0, 0.3)["J_psi"]
    assert turned == pytest.approx(2 * 0.5839 * 0.4 * 0.275 * math.sin(0.3) / inertia)
    assert rates(CORRECTED, RIG, tilted, more)[5] == pytest.approx(rates(CORRECTED, RIG, tilted, less)[5])

    import casadi as ca

    model = MultibodyModel()
    x, thrust = ca.SX.sym("x", 6), ca.SX.sym("F", 2)
    at = model.operands(x, ca.SX.zeros(2), ca.SX(model.parameter_values(RIG)))
    forces = ca.Function("Q", [x, thrust], [model.thrust_torque_Nm(at, thrust)])
    assert float(forces(tilted, [0.2, -0.2])[2]) == 0.0
    raised = np.array([0.35, 0.3, 0.0, 0.0, 0.0, 0.0])
    assert float(forces(raised, [0.2, -0.2])[2]) == pytest.approx(-0.275 * 0.4 * math.sin(0.35))


def test_no_pitch_gives_table_2s_J_theta() -> None:
    lowest, highest = (printed_inertias_kg_m2(RIG, 0.0, angle)["J_theta"] for angle in (0.0, math.pi / 2))
    assert (lowest, highest) == (pytest.approx(0.7675, abs=5e-5), pytest.approx(0.8219, abs=5e-5))
    assert highest < 0.8496


def test_phi_minus_delta_holds_at_either_sign_of_phi() -> None:
    """(11) compared with (10): a mass L_1 next to and L_1 tan(delta) below the axis, turned by a signed
    phi."""
    beside, delta = 0.275, math.atan(0.03 / 0.275)
    for phi in (-0.3, 0.1, 0.4):
        below = beside * math.tan(delta)
        horizontal = beside * math.cos(phi) + below * math.sin(phi)
        assert beside / math.cos(delta) * math.cos(phi - delta) == pytest.approx(horizontal)
