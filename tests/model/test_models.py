"""Models against the paper's numbers, MuJoCo, and finite differences of their symbols."""

import functools
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import numpy.typing as npt
import pytest
from heli_benchmark.plant import JOINTS, mujoco_rig
from heli_sim.errors import PlantError
from heli_sim.model import Model, MultibodyModel, PaperModel
from heli_sim.model.effects import RotorLag
from heli_sim.model.linear import derivatives, linearise, trim
from heli_sim.model.mjcf import left_out, mjcf
from heli_sim.model.plant import Plant
from heli_sim.rig import Rig, load_rig

from tests.cli.terminal import Terminal
from tests.model.toys import WIDE, ConstantTorque, FirstOrderLag, TiltedEncoder, paper_rig, rates
from tests.running.long import samples

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
    shown = measured(PaperModel((TiltedEncoder(),)), paper_rig(), [0.1, 0.5, -0.2, 0, 0, 0])
    assert shown == pytest.approx([0.15, 0.5, -0.2])


def measured(model: Model, rig: Rig, state: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Angles that the encoders show."""
    x, u = ca.SX.sym("x", 6), ca.SX.sym("u", 2)
    p = ca.SX.sym("p", len(model.parameters))
    show = ca.Function("show", [x, u, p], [model.measurement(x, u, p)])
    return np.asarray(show(np.asarray(state), [0, 0], model.parameter_values(rig))).ravel()


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
    shown = measured(PaperModel(), paper_rig(offset_pitch=2.0), [0.1, 0.2, 0.3, 0, 0, 0])
    assert np.rad2deg(shown - [0.1, 0.2, 0.3]) == pytest.approx([0.0, 2.0, 0.0])


mujoco = pytest.importorskip("mujoco")

STEP_S = 0.001
STEPS = 10_000


def fly_mujoco(
    rig: Rig, state: npt.NDArray[np.float64], thrust_N: npt.NDArray[np.float64], steps: int
) -> npt.NDArray[np.float64]:
    """Angles after every step, (steps, 3)."""
    model = mujoco_rig(rig)
    data = mujoco.MjData(model)
    address = [model.joint(name).qposadr[0] for name in JOINTS]
    data.qpos[address], data.qvel[address] = state[:3], state[3:]
    data.ctrl[:] = thrust_N
    out = np.empty((steps, 3))
    for k in range(steps):
        mujoco.mj_step(model, data)
        out[k] = data.qpos[address]
    return out


@functools.cache
def ten_seconds() -> ca.Function:
    return by_runge_kutta(load_rig("makki2024"), STEPS)


def by_runge_kutta(rig: Rig, steps: int) -> ca.Function:
    """(state, volts) -> states after every step, by the project's equations and MuJoCo's Runge-Kutta step."""
    model = MultibodyModel()
    x, u = ca.SX.sym("x", 6), ca.SX.sym("u", 2)
    f = ca.Function("f", [x, u], [model.dynamics(x, u, ca.SX(model.parameter_values(rig)))])
    return runge_kutta(f, x, u, STEP_S).mapaccum(steps)


def runge_kutta(f: ca.Function, x: ca.SX, u: ca.SX, step_s: float) -> ca.Function:
    k1 = f(x, u)
    k2 = f(x + step_s / 2 * k1, u)
    k3 = f(x + step_s / 2 * k2, u)
    k4 = f(x + step_s * k3, u)
    return ca.Function("step", [x, u], [ca.cse(x + step_s / 6 * (k1 + 2 * k2 + 2 * k3 + k4))])


@pytest.mark.medium
@pytest.mark.parametrize("seed", range(samples(50, 10)))
def test_angles_agree_with_mujoco_over_ten_seconds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rig = load_rig("makki2024")
    state = np.concatenate([rng.uniform(-0.4, 0.4, 3), rng.uniform(-0.5, 0.5, 3)])
    volts_V = rng.uniform(1.0, 2.4, 2)
    volts_V[1] = volts_V[0] + rng.uniform(-0.15, 0.15)
    thrust_N = rig["thrust_gain"].value * np.maximum(volts_V - rig["dead_zone"].value, 0)
    ours = np.asarray(ten_seconds()(state, ca.repmat(ca.DM(volts_V), 1, STEPS))).T[:, :3]
    theirs = fly_mujoco(rig, state, thrust_N, STEPS)
    np.testing.assert_allclose(ours, theirs, atol=1e-5)


@pytest.mark.medium
def test_mass_matrix_agrees_with_mujoco_and_with_the_papers_inertias() -> None:
    rig = load_rig("makki2024")
    model = MultibodyModel()
    x = ca.SX.sym("x", 6)
    at = model.operands(x, ca.SX.zeros(2), ca.SX(model.parameter_values(rig)))
    inertia = ca.Function("inertia", [x], [model.inertia_kg_m2(at)])
    physics = mujoco_rig(rig)
    data = mujoco.MjData(physics)
    address = [physics.joint(name).qposadr[0] for name in JOINTS]
    rng = np.random.default_rng(0)
    for _ in range(20):
        angles = rng.uniform(-1, 1, 3)
        data.qpos[address] = angles
        mujoco.mj_forward(physics, data)
        full = np.empty((3, 3))
        mujoco.mj_fullM(physics, data, full)
        np.testing.assert_allclose(inertia([*angles, 0, 0, 0]), full[np.ix_(address, address)], atol=1e-9)
    level = np.asarray(inertia(np.zeros(6)))
    # (28) and (29) of the paper; (27) leaves out that the rotors hang below the axes.
    assert level[1, 1] == pytest.approx(0.0546, abs=1e-4)
    assert level[2, 2] == pytest.approx(0.8195, abs=1e-3)


@pytest.mark.medium
def test_energy_is_conserved_without_friction_and_thrust() -> None:
    rig = load_rig("makki2024").replace(friction_elevation=0.0, friction_pitch=0.0, friction_travel=0.0)
    model = MultibodyModel()
    x, u = ca.SX.sym("x", 6), ca.SX.sym("u", 2)
    p = ca.SX(model.parameter_values(rig))
    at = model.operands(x, u, p)
    rates = x[3:6]
    kinetic_J = 0.5 * rates.T @ model.inertia_kg_m2(at) @ rates
    energies_J = ca.Function("energies", [x], [model.energy_J(at), kinetic_J])
    f = ca.Function("f", [x, u], [model.dynamics(x, u, p)])
    steps = 20_000
    path = runge_kutta(f, x, u, 0.0005).mapaccum(steps)
    rng = np.random.default_rng(3)
    for _ in range(5):
        start = np.concatenate([rng.uniform(-0.6, 0.6, 3), rng.uniform(-1, 1, 3)])
        total, kinetic = (
            np.asarray(e).ravel() for e in energies_J.map(steps)(path(start, ca.DM.zeros(2, steps)))
        )
        assert np.ptp(total) < 1e-8 * kinetic.max()


MODELS = [PaperModel(), MultibodyModel(), MultibodyModel((RotorLag(0.12),))]


@pytest.mark.slow
@pytest.mark.parametrize("model", MODELS, ids=["paper", "multibody", "lag"])
@pytest.mark.parametrize("elevation_deg", [-15.0, 0.0, 15.0])
def test_a_trimmed_rig_stays_for_ten_seconds(model: Model, elevation_deg: float) -> None:
    rig = load_rig("makki2024").replace(**WIDE, M_f=0.36)
    at = trim(model, rig, np.radians(elevation_deg))
    plant = Plant(model, rig)
    ten_seconds = plant.function.fold(10_000)
    state, *_ = ten_seconds(at.state, at.volts_V, np.zeros(3), plant.parameters)
    np.testing.assert_allclose(np.ravel(state), at.state, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("model", MODELS, ids=["paper", "multibody", "lag"])
def test_jacobians_are_those_of_finite_differences(model: Model) -> None:
    rig = load_rig("makki2024")
    random = np.random.default_rng(5)
    state = random.uniform(-0.4, 0.4, len(model.states))
    volts_V = np.array([1.9, 2.3])
    exact, step = derivatives(model, rig, state, volts_V), 1e-6
    for column in range(len(state)):
        up, down = state.copy(), state.copy()
        up[column] += step
        down[column] -= step
        slope = derivatives(model, rig, up, volts_V).rates - derivatives(model, rig, down, volts_V).rates
        np.testing.assert_allclose(exact.A[:, column], slope / (2 * step), atol=1e-7)
    for column, name in enumerate(model.parameter_names):
        if name == "rotor_lag_s":
            continue
        number = rig[name].value
        up_rig, down_rig = (
            rig.replace(**{name: number + step}),
            rig.replace(**{name: max(number - step, 0.0)}),
        )
        slope = (
            derivatives(model, up_rig, state, volts_V).rates
            - derivatives(model, down_rig, state, volts_V).rates
        ) / (up_rig[name].value - down_rig[name].value)
        if number > 0.0:
            np.testing.assert_allclose(exact.P[:, column], slope, atol=1e-5)


@pytest.mark.slow
def test_the_linear_model_predicts_small_motions_of_the_plant() -> None:
    # It reads pyplot and scipy.signal: a second for every worker, were it read with this file.
    import control

    model, rig = MultibodyModel((RotorLag(0.12),)), load_rig("makki2024").replace(**WIDE)
    at = trim(model, rig)
    linear = linearise(model, rig, at)
    times = np.arange(2001) * 1e-3
    pushed_V = np.column_stack((0.01 * np.sin(3 * times), 0.01 * np.sin(2 * times)))
    plant, state = Plant(model, rig), at.state
    seen = [state[:3]]
    for volts_V in pushed_V[:-1]:
        state, angles_rad = plant.step(state, at.volts_V + volts_V)
        seen.append(angles_rad)
    predicted = control.forced_response(linear, times, pushed_V.T).outputs
    moved = np.array(seen) - at.state[:3]
    assert np.abs(moved).max() > 2e-3
    np.testing.assert_allclose(moved, predicted.T, atol=0.01 * np.abs(moved).max())


@pytest.mark.slow
def test_names_go_with_the_numbers() -> None:
    linear = linearise(MultibodyModel((RotorLag(0.1),)), load_rig("makki2024"))
    assert linear.input_labels == ["front_V", "back_V"]
    assert linear.output_labels == ["elevation_rad", "pitch_rad", "travel_rad"]
    assert linear.state_labels[:2] == ["elevation_rad", "pitch_rad"]
    assert linear.state_labels[6:] == ["rotor_lag_front_N", "rotor_lag_back_N"]


@pytest.mark.slow
def test_travel_follows_pitch_and_hover_leans_against_a_heavier_front() -> None:
    level = derivatives(MultibodyModel(), load_rig("makki2024"), np.zeros(6), trim_volts())
    assert level.A[5, 1] == pytest.approx(0.5, abs=0.01)  # rad/s2 of travel for each rad of pitch
    heavier = trim(MultibodyModel(), load_rig("makki2024").replace(M_f=0.36))
    assert heavier.volts_V[0] > heavier.volts_V[1]


def trim_volts() -> np.ndarray:
    return trim(MultibodyModel(), load_rig("makki2024")).volts_V


@pytest.mark.slow
def test_a_rig_that_cannot_hover_is_named() -> None:
    with pytest.raises(PlantError, match="makki2024' cannot hover at 0 degrees with model 'multibody'"):
        trim(MultibodyModel(), load_rig("makki2024").replace(M_w=1.8))


SECONDS = 3.0


def volts_V(t_s: float) -> np.ndarray:
    """Around hover, and once below the dead zone."""
    front = 1.75 + 0.4 * np.sin(3.0 * t_s)
    return np.array([front, 0.3 if 1.0 < t_s < 1.2 else 1.65])


def in_mujoco(rig: Rig, start: np.ndarray) -> np.ndarray:
    model = mujoco.MjModel.from_xml_string(mjcf(rig, STEP_S, stops=False))
    data = mujoco.MjData(model)
    for joint, angle in zip(JOINTS, start, strict=True):
        data.joint(joint).qpos[0] = angle
    observed = []
    for step in range(round(SECONDS / STEP_S)):
        observed.append([data.joint(joint).qpos[0] for joint in JOINTS])
        for side, volts in zip(("front", "back"), volts_V(step * STEP_S), strict=True):
            data.actuator(side).ctrl[0] = volts
        mujoco.mj_step(model, data)
    return np.array(observed)


def by_equations(rig: Rig, start: np.ndarray) -> np.ndarray:
    steps = round(SECONDS / STEP_S)
    flown_V = np.column_stack([volts_V(step * STEP_S) for step in range(steps)])
    after = by_runge_kutta(rig, steps)(np.concatenate((start, np.zeros(3))), flown_V)
    return np.vstack((start, np.asarray(after).T[:-1, :3]))


@pytest.mark.medium
@pytest.mark.parametrize("name", ["makki2024", "quanser-course"])
def test_exported_rig_flies_in_mujoco_as_the_equations_do(name: str) -> None:
    rig = load_rig(name).replace(torque_travel=0.02, torque_pitch=-0.003, reverse_thrust=0.0)
    start = np.array([0.1, -0.05, 0.3])
    theirs, ours = in_mujoco(rig, start), by_equations(rig, start)
    assert np.ptp(ours, axis=0).min() > 0.1
    assert np.abs(theirs - ours).max() < 1e-6


@pytest.mark.medium
def test_arm_falls_onto_its_stop_and_no_further() -> None:
    rig = load_rig("makki2024").replace(M_w=1.3)
    model = mujoco.MjModel.from_xml_string(mjcf(rig))
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 4000)
    assert np.rad2deg(data.joint("elevation").qpos[0]) == pytest.approx(-25.0, abs=1.0)


@pytest.mark.medium
def test_what_the_file_does_not_say_is_said_in_it_and_on_the_terminal(terminal: Terminal) -> None:
    rig = load_rig("quanser-course")
    assert any("reversed voltage" in line for line in left_out(rig))
    lagging = replace(rig, effects={"rotor_lag": {}}, description="odd -- <name> & more")
    ET.fromstring(mjcf(lagging))
    assert "the effect rotor_lag" in mjcf(lagging)
    export_result = terminal("rig", "export", "makki2024", "--format", "mjcf", "-o", "m.xml")
    assert "air drag" in export_result.out
    mujoco.MjModel.from_xml_path(str(Path("m.xml")))
    piped = terminal("rig", "export", "makki2024", "--format", "mjcf", "-o", "-")
    # The last line of the file is the mark of heli-host.
    assert Path("m.xml").read_text().startswith(piped.out.rstrip("\n"))
    assert "air drag" in piped.err
