"""A locked axis: the others move as on a rig that has no such joint, reaction included."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from heli_sim.model import MultibodyModel
from heli_sim.model.plant import Plant
from heli_sim.rig import load_rig

mujoco = pytest.importorskip("mujoco")

from heli_benchmark.plant import JOINTS, mujoco_rig  # noqa: E402

from tests.model.test_models import STEP_S, runge_kutta  # noqa: E402

pytestmark = pytest.mark.medium

SECONDS = 3
# Inertia of a joint that nothing here could turn.
IMMOVABLE = 1e9
LOCKS = [(1, 0, 1), (0, 1, 1), (1, 0, 0), (0, 1, 0), (0, 0, 1)]


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


def test_a_pin_on_travel_makes_pitch_heavier_than_a_travel_that_yields() -> None:
    """Only at elevation are the two coupled; there the free travel gives way and pitch turns more easily."""
    plant = Plant(MultibodyModel(), load_rig("makki2024"))
    high = np.array([0.4, 0.0, 0.0, 0.0, 0.0, 0.0])
    held, _ = plant.step(high, (2.2, 1.8), locked=(True, False, True))
    free, _ = plant.step(high, (2.2, 1.8), locked=(True, False, False))
    assert held[4] > 0.0
    assert free[4] > held[4] * 1.001
