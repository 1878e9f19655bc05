"""The equations as printed, an axis that is locked, and the readings of Table 6."""

import json
import math
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from heli_host.board.parameters import paper_gains
from heli_host.ui.cli import app
from heli_lab.apps.paper.experiments import fly_plan
from heli_lab.apps.paper.lumped import analytic, printed_inertias_kg_m2
from heli_lab.apps.paper.table6 import LoopVerdict, verdicts
from heli_lab.control.tune import cascade_gains_of, is_stable, linear_plant
from heli_sim.model import MultibodyModel, PaperModel, PaperPrintedModel
from heli_sim.model.plant import Plant
from heli_sim.rig import load_rig
from typer.testing import CliRunner

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


mujoco = pytest.importorskip("mujoco")

from heli_benchmark.plant import JOINTS, mujoco_rig  # noqa: E402

from tests.model.test_models import STEP_S, runge_kutta  # noqa: E402

SECONDS = 3
# Inertia of a joint that nothing here could turn.
IMMOVABLE = 1e9
LOCKS = [(1, 0, 1), (0, 1, 1), (1, 0, 0), (0, 1, 0), (0, 0, 1)]


@pytest.mark.medium
@pytest.mark.parametrize(
    "locked", LOCKS, ids=lambda p: "".join(j[0] for j, on in zip(JOINTS, p, strict=True) if on)
)
def test_the_free_axes_move_as_mujocos_do_with_the_pinned_joints_immovable(locked: tuple[int, ...]) -> None:
    rig, model = load_rig("makki2024"), MultibodyModel()
    state = np.array([0.15, 0.25, -0.2, 0.3, -0.4, 0.5])
    state[3:] *= 1 - np.array(locked)
    volts_V = np.array([1.9, 1.6])
    x, u = ca.SX.sym("x", 6), ca.SX.sym("u", 2)
    f = ca.Function(
        "f", [x, u], [model.dynamics(x, u, ca.SX(model.parameter_values(rig)), locked=ca.SX(locked))]
    )
    steps = round(SECONDS / STEP_S)
    path = runge_kutta(f, x, u, STEP_S).mapaccum(steps)
    ours = np.asarray(path(state, ca.repmat(ca.DM(volts_V), 1, steps))).T[:, :3]

    physics = mujoco_rig(rig)
    data = mujoco.MjData(physics)
    address = [physics.joint(name).qposadr[0] for name in JOINTS]
    for name, held in zip(JOINTS, locked, strict=True):
        if held:
            physics.dof_armature[physics.joint(name).dofadr[0]] = IMMOVABLE
    data.qpos[address], data.qvel[address] = state[:3], state[3:]
    data.ctrl[:] = rig["thrust_gain"].value * (volts_V - rig["dead_zone"].value)
    theirs = np.empty((steps, 3))
    for k in range(steps):
        mujoco.mj_step(physics, data)
        theirs[k] = data.qpos[address]
    np.testing.assert_allclose(ours, theirs, atol=1e-5)


@pytest.mark.medium
def test_a_pin_on_travel_makes_pitch_heavier_than_a_travel_that_yields() -> None:
    """Only at elevation are the two coupled; there the free travel gives way and pitch turns more easily."""
    plant = Plant(MultibodyModel(), load_rig("makki2024"))
    high = np.array([0.4, 0.0, 0.0, 0.0, 0.0, 0.0])
    held, _ = plant.step(high, (2.2, 1.8), locked=(True, False, True))
    free, _ = plant.step(high, (2.2, 1.8), locked=(True, False, False))
    assert held[4] > 0.0
    assert free[4] > held[4] * 1.001


def of(rows: list[LoopVerdict]) -> dict[tuple[str, str, str], LoopVerdict]:
    return {(row.gains, row.reading, row.derivative): row for row in rows}


@pytest.fixture(scope="module")
def on_30() -> dict[tuple[str, str, str], LoopVerdict]:
    return of(verdicts(PaperModel(), RIG))


@pytest.fixture(scope="module")
def on_multibody() -> dict[tuple[str, str, str], LoopVerdict]:
    return of(verdicts(MultibodyModel(), RIG))


@pytest.mark.slow
@pytest.mark.parametrize("derivative", ["error", "measurement"])
def test_printed_as_a_pitch_setpoint_in_degrees_travel_swings_up_on_either_model(
    on_30: dict[tuple[str, str, str], LoopVerdict],
    on_multibody: dict[tuple[str, str, str], LoopVerdict],
    derivative: str,
) -> None:
    for verdicts_by_reading in (on_30, on_multibody):
        row = verdicts_by_reading["printed", "degrees", derivative]
        assert row.growth_1_per_s == pytest.approx(0.118, abs=0.002)
        assert row.period_s == pytest.approx(10.5, abs=0.1)
        assert verdicts_by_reading["corrected", "degrees", derivative].growth_1_per_s < -0.3


@pytest.mark.slow
def test_printed_as_u3_on_30_is_stable_by_a_hair_and_only_with_the_exact_derivative_of_the_error(
    on_30: dict[tuple[str, str, str], LoopVerdict],
) -> None:
    exact, standard = on_30["printed", "u3", "error"], on_30["printed", "u3", "measurement"]
    assert -0.035 < exact.growth_1_per_s < -0.025
    assert exact.lag_s < 0.09  # the shortest lag of any real rig
    assert standard.growth_1_per_s > 1.5


@pytest.mark.slow
def test_printed_as_u3_is_stable_on_a_multibody_rig_because_the_body_hangs_below_the_pitch_axis(
    on_multibody: dict[tuple[str, str, str], LoopVerdict],
) -> None:
    assert on_multibody["printed", "u3", "measurement"].growth_1_per_s < 0.0
    no_pendulum = of(verdicts(MultibodyModel(), RIG.replace(L_phi=1e-4, L_theta=1e-4)))
    assert no_pendulum["printed", "u3", "measurement"].growth_1_per_s > 1.0


@pytest.mark.slow
def test_corrected_a_step_of_15_degrees_overshoots_to_20_and_printed_as_u3_it_takes_two_minutes(
    on_30: dict[tuple[str, str, str], LoopVerdict],
) -> None:
    corrected, printed = on_30["corrected", "degrees", "measurement"], on_30["printed", "u3", "error"]
    assert corrected.peak_deg == pytest.approx(20.4, abs=0.1)
    assert corrected.settling_time_s == pytest.approx(12.7, abs=0.2)
    assert printed.settling_time_s > 100.0
    assert math.isinf(on_30["printed", "degrees", "error"].settling_time_s)


@pytest.mark.slow
def test_verdicts_that_are_infinite_are_null_in_json(tmp_path: Path) -> None:
    target = tmp_path / "gains.json"
    assert CliRunner().invoke(app, ["paper", "gains", "--json", str(target)]).exit_code == 0
    rows = json.loads(target.read_text())["models"]["paper"]
    assert [row["settling_time_s"] is None for row in rows] == [row["growth_1_per_s"] > 0.0 for row in rows]


@pytest.mark.slow
def test_both_analyses_of_table_6_agree_where_they_overlap(
    on_multibody: dict[tuple[str, str, str], LoopVerdict],
) -> None:
    """`heli_lab.control.tune` knows filters and the board's law; this one knows (33) and (34)."""
    for gains in ("printed", "corrected"):
        row = on_multibody[gains, "degrees", "measurement"]
        assert (row.growth_1_per_s < 0.0) == is_stable(
            linear_plant(RIG), cascade_gains_of(paper_gains(gains))
        )


@pytest.mark.slow
def test_the_growth_of_the_printed_travel_row_is_the_one_that_is_flown() -> None:
    """A swing that grows by 0.118 a second is 3.3 times as large after each 10.5 s."""
    flown = fly_plan("sine", Plant(MultibodyModel(), RIG), "printed", "paper-printed")
    assert math.exp(0.118 * 10.5) == pytest.approx(3.45, abs=0.01)
    t_s, error = flown.flight.t_s, np.abs(flown.error_deg[:, 2])
    early, late = error[(t_s > 6) & (t_s < 17)].max(), error[t_s > t_s[-1] - 11.0].max()
    assert late > 4.0 * early


@pytest.mark.slow
def test_corrected_table_6_flies_the_sines_and_own_gains_fly_them_better() -> None:
    plant = Plant(MultibodyModel(), RIG)
    rms = []
    for gains in ("paper", None):
        flown = fly_plan("sine", plant, "sine", gains)
        assert flown.outcome == "completed" or "landing" in flown.outcome
        rms.append(float(np.sqrt(np.mean(flown.error_deg[flown.flight.t_s > 8.0, 2] ** 2))))
    assert rms[0] < 6.0
    assert rms[1] < 1.0


@pytest.mark.slow
def test_gains_of_the_paper_are_refused_on_a_real_board_and_by_a_wrong_name() -> None:
    for arguments, wanted in (
        (["--port", "/dev/nowhere", "--gains", "paper"], "add --sil"),
        (["--sil", "--gains", "best"], "paper-printed"),
    ):
        result = CliRunner().invoke(app, ["fly", "hover", *arguments])
        assert result.exit_code != 0
        assert wanted in result.output
