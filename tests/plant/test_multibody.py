"""The multibody model against MuJoCo, which knows nothing of our equations, and against energy."""

from __future__ import annotations

import functools

import casadi as ca
import numpy as np
import numpy.typing as npt
import pytest
from heli_benchmark.engine.bodies import JOINTS, mujoco_rig
from heli_sim.model import MultibodyModel
from heli_sim.rig import Rig, load_rig

from tests.running.long import samples

pytestmark = pytest.mark.medium

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
    """(state, volts) -> angles after every step, by the project's equations and the same Runge-Kutta step."""
    model = MultibodyModel()
    x, u = ca.SX.sym("x", 6), ca.SX.sym("u", 2)
    f = ca.Function("f", [x, u], [model.dynamics(x, u, ca.SX(model.parameter_values(load_rig("makki2024"))))])
    return runge_kutta(f, x, u, STEP_S).mapaccum(STEPS)


def runge_kutta(f: ca.Function, x: ca.SX, u: ca.SX, step_s: float) -> ca.Function:
    k1 = f(x, u)
    k2 = f(x + step_s / 2 * k1, u)
    k3 = f(x + step_s / 2 * k2, u)
    k4 = f(x + step_s * k3, u)
    return ca.Function("step", [x, u], [ca.cse(x + step_s / 6 * (k1 + 2 * k2 + 2 * k3 + k4))])


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
