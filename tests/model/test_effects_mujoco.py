"""Effects against MuJoCo, where each is made by MuJoCo's own means and not by our equations."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from heli_benchmark.plant import JOINTS, mujoco_rig
from heli_host.data.arrays import Floats
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import parse_effects
from heli_sim.model.plant import Plant
from heli_sim.rig import load_rig

from tests.model.toys import WIDE
from tests.running.long import samples

pytestmark = pytest.mark.slow

mujoco = pytest.importorskip("mujoco")

TICKS = samples(5000, 2500)
RIG = load_rig("makki2024").replace(**WIDE)
Control = Callable[[Any, Any, Floats], Floats]
ReferenceTrajectory = Callable[[int, float], Floats]
T_s = 0.1


def voltages_V() -> Floats:
    t = np.arange(TICKS) * 1e-3
    return np.column_stack((1.75 + 0.2 * np.sin(3 * t + 0.3), 1.74 + 0.2 * np.sin(2.3 * t)))


def initial_state() -> Floats:
    return np.array([-0.05, 0.1, 0.2, 0.1, 0.0, 0.4])


def simulate_with_casadi(effect: str) -> Floats:
    plant = Plant(MultibodyModel(parse_effects([effect])), RIG)
    state = plant.rest_state()
    state[:6] = initial_state()
    step = plant.function.mapaccum(TICKS)
    after, _ = step(state, voltages_V().T, np.zeros(3), plant.parameters)
    return np.asarray(after).T[:, :3]


def flown_by_mujoco(
    change: Callable[[Any], None] | None = None,
    control: Control | None = None,
    at_tick: int = 0,
    course: ReferenceTrajectory | None = None,
) -> Floats:
    """Fly MuJoCo's rig, and return its angles, (ticks, 3)."""
    # `change` changes its description at `at_tick`. `control` makes the thrusts depend on its motion.
    # `course` gives the thrusts at a time after a tick [s].
    model = mujoco_rig(RIG)
    data = mujoco.MjData(model)
    address = [model.joint(name).qposadr[0] for name in JOINTS]
    data.qpos[address], data.qvel[address] = initial_state()[:3], initial_state()[3:]
    static_N = RIG["thrust_gain"].value * (voltages_V() - RIG["dead_zone"].value)
    tick = 0

    # MuJoCo calls this in each of the four stages of a step.
    def push(model: Any, data: Any) -> None:
        now_N = static_N[tick] if course is None else course(tick, data.time - 1e-3 * tick)
        data.ctrl[:] = now_N if control is None else control(model, data, now_N)

    angles = np.empty((TICKS, 3))
    mujoco.set_mjcb_control(push)
    try:
        for tick in range(TICKS):
            if tick == at_tick and change is not None:
                change(model)
            mujoco.mj_step(model, data)
            angles[tick] = data.qpos[address]
    finally:
        mujoco.set_mjcb_control(None)
    return angles


def lagged(commanded: Floats) -> ReferenceTrajectory:
    """Response to each row of `commanded`, from zero, with a lag of T_s: exactly, also between the ticks."""
    remaining_share = np.exp(-1e-3 / T_s)
    reached = np.zeros((len(commanded) + 1, 2))
    for tick, row in enumerate(commanded):
        reached[tick + 1] = row + (reached[tick] - row) * remaining_share

    def course(tick: int, later_s: float) -> Floats:
        now: Floats = commanded[tick] + (reached[tick] - commanded[tick]) * np.exp(-later_s / T_s)
        return now

    return course


def climb_m_s(model: Any, data: Any) -> Floats:
    speeds = np.empty(2)
    for index, name in enumerate(("front", "back")):
        velocity = np.empty(6)
        site = model.site(name).id
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, site, velocity, 1)
        speeds[index] = velocity[5]
    return speeds


def body_velocity(model: Any, data: Any, *, local: bool) -> Floats:
    """Angular and linear velocity of the short arm, in its own frame or in the world's."""
    velocity = np.empty(6)
    body = model.body("body").id
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body, velocity, int(local))
    return velocity


def push_wheel(model: Any, data: Any, momentum_Nms: float, spin_up_Nm: float = 0.0) -> None:
    """Apply the torque of a wheel that spins about the short arm's upward axis."""
    body = model.body("body").id
    up = data.xmat[body].reshape(3, 3)[:, 2]
    turned = body_velocity(model, data, local=False)[:3]
    data.xfrc_applied[body, 3:] = -np.cross(turned, momentum_Nms * up) - spin_up_Nm * up


def agree(effect: str, witness: Floats, within_rad: float = 1e-6) -> None:
    mine = simulate_with_casadi(effect)
    assert np.abs(mine - flown_by_mujoco()).max() > 1e-3, "the effect does nothing here"
    np.testing.assert_allclose(mine, witness, atol=within_rad)


def test_without_effects_both_fly_alike() -> None:
    np.testing.assert_allclose(simulate_with_casadi("thrust_asymmetry=0"), flown_by_mujoco(), atol=1e-6)


def test_asymmetry_is_one_rotor_stronger_and_one_weaker() -> None:
    agree("thrust_asymmetry=0.04", flown_by_mujoco(control=lambda model, data, F: F * [1.04, 0.96]))


def test_a_speed_that_lags_gives_its_square_as_thrust() -> None:
    speed_V, gain = lagged(voltages_V()), RIG["thrust_gain"].value
    agree("rotor_speed_lag=0.1", flown_by_mujoco(course=lambda tick, s: gain * speed_V(tick, s) ** 2 / 4.0))
    above_V, dead_V = lagged(voltages_V()), RIG["dead_zone"].value
    agree(
        "rotor_speed_lag=s:0.1,begins:1",
        flown_by_mujoco(course=lambda tick, s: gain * np.maximum(above_V(tick, s) - dead_V, 0.0) ** 2),
    )


def test_a_lag_with_dead_time_is_the_lag_of_what_was_asked_for_a_while_ago() -> None:
    asked_V = np.vstack((np.zeros((20, 2)), voltages_V()))[:TICKS]
    asked_N = RIG["thrust_gain"].value * np.maximum(asked_V - RIG["dead_zone"].value, 0.0)
    agree("rotor_lag_with_delay=lag_s:0.1,delay_s:0.02", flown_by_mujoco(course=lagged(asked_N)))


def test_a_supply_that_fades_lowers_voltages_and_not_the_dead_zone() -> None:
    def course(tick: int, later_s: float) -> Floats:
        left_V = voltages[tick] * (1 - 0.01 * (1e-3 * tick + later_s))
        thrust_N: Floats = RIG["thrust_gain"].value * (left_V - RIG["dead_zone"].value)
        return thrust_N

    voltages = voltages_V()
    agree("supply_fade=0.01", flown_by_mujoco(course=course))


def test_inflow_is_thrust_lost_to_the_speed_of_the_rotors_site_along_its_own_axis() -> None:
    agree(
        "inflow_damping=0.2",
        flown_by_mujoco(control=lambda model, data, F: F * (1 - 0.2 * climb_m_s(model, data))),
    )


def test_inflow_may_cost_the_same_at_any_thrust() -> None:
    agree(
        "inflow_damping=s_per_m:0.1,loaded:0",
        flown_by_mujoco(control=lambda model, data, F: F - 0.1 * climb_m_s(model, data)),
    )


def test_ground_effect_goes_by_the_height_of_each_rotors_site() -> None:
    def control(model: Any, data: Any, thrust_N: Floats) -> Floats:
        height_m = data.site_xpos[[model.site("front").id, model.site("back").id], 2]
        gained: Floats = thrust_N * (1 + 0.3 * np.exp(-(height_m + 0.25) / 0.15))
        return gained

    agree("ground_effect=0.3", flown_by_mujoco(control=control))


def test_tilt_is_gravity_in_another_direction() -> None:
    lean = np.array([0.05, -0.03])

    def change(model: Any) -> None:
        size = np.hypot(*lean)
        up = np.array([*(lean * np.sin(size) / size), np.cos(size)])
        model.opt.gravity[:] = -RIG["g"].value * up

    agree("axis_tilt=x_rad:0.05,y_rad:-0.03", flown_by_mujoco(change))


@pytest.mark.parametrize("back", [0.04, -0.04], ids=["same_sense", "opposite_sense"])
def test_reaction_torque_is_an_actuators_moment_about_its_thrust(back: float) -> None:
    def change(model: Any) -> None:
        model.actuator_gear[:, 5] = (0.04, back)

    agree(f"rotor_reaction_torque=front_m:0.04,back_m:{back}", flown_by_mujoco(change))


def test_edgewise_flow_goes_by_the_speed_of_the_pitch_axis_along_the_short_arm() -> None:
    def control(model: Any, data: Any, thrust_N: Floats) -> Floats:
        along_m_s = body_velocity(model, data, local=True)[4]
        moved: Floats = thrust_N * (1 + 0.1 * along_m_s * np.array([-1.0, 1.0]))
        return moved

    agree("edgewise_flow=0.1", flown_by_mujoco(control=control))


def test_gyroscopic_torque_is_that_of_a_spinning_wheel_on_the_short_arm() -> None:
    def control(model: Any, data: Any, thrust_N: Floats) -> Floats:
        push_wheel(model, data, 0.05 * thrust_N.sum())
        return thrust_N

    agree("gyroscopic_torque=0.05", flown_by_mujoco(control=control))


@pytest.mark.parametrize("spin_up", [0.0, 1.0])
def test_a_flywheel_is_a_wheel_whose_speed_lags(spin_up: float) -> None:
    volts_V = voltages_V()
    speed_V = lagged(volts_V)
    sums_V = np.zeros(2)

    def course(tick: int, later_s: float) -> Floats:
        sums_V[:] = volts_V[tick].sum(), speed_V(tick, later_s).sum()
        thrust_N: Floats = RIG["thrust_gain"].value * (volts_V[tick] - RIG["dead_zone"].value)
        return thrust_N

    def control(model: Any, data: Any, thrust_N: Floats) -> Floats:
        push_wheel(model, data, 0.02 * sums_V[1], spin_up * 0.02 * (sums_V[0] - sums_V[1]) / T_s)
        return thrust_N

    agree(f"flywheel=Nms_per_V:0.02,spin_up:{spin_up}", flown_by_mujoco(control=control, course=course))


@pytest.mark.parametrize("axis", JOINTS)
def test_drag_is_a_torque_that_goes_with_the_square_of_a_joints_speed(axis: str) -> None:
    def control(model: Any, data: Any, thrust_N: Floats) -> Floats:
        place = model.joint(axis).dofadr[0]
        data.qfrc_applied[place] = -0.2 * data.qvel[place] * abs(data.qvel[place])
        return thrust_N

    agree(f"{axis}_drag_quadratic=0.2", flown_by_mujoco(control=control))


@pytest.mark.parametrize("axis", ["elevation", "travel"])
def test_a_cable_is_a_joints_spring(axis: str) -> None:
    def change(model: Any) -> None:
        joint = model.joint(axis)
        model.jnt_stiffness[joint.id] = 0.1
        model.qpos_spring[joint.qposadr[0]] = 0.3

    agree(f"cable_spring.{axis}=Nm_per_rad:0.1,rest_rad:0.3", flown_by_mujoco(change))


@pytest.mark.parametrize("axis", JOINTS)
def test_dry_friction_is_mujocos_friction_loss(axis: str) -> None:
    def change(model: Any) -> None:
        model.dof_frictionloss[model.joint(axis).dofadr[0]] = 0.02

    # MuJoCo's friction gives way a little like a spring where it should hold.
    witness = flown_by_mujoco(change)
    error_rad = np.abs(simulate_with_casadi(f"coulomb_friction.{axis}=0.02") - witness).max()
    assert error_rad < 0.003 * np.abs(flown_by_mujoco() - witness).max()


def test_a_counterweight_that_slips_is_one_that_mujoco_moves() -> None:
    def change(model: Any) -> None:
        model.body_pos[model.body("counterweight").id, 0] -= 0.005

    # Ours takes some 20 ms to slip.
    half = TICKS // 2
    agree(
        f"counterweight_shift=0.005@{1e-3 * half:g}", flown_by_mujoco(change, at_tick=half), within_rad=2e-5
    )
