"""A rig as MuJoCo's XML flies in MuJoCo as the equations of motion do, and says what it leaves out."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from heli_sim.model import MultibodyModel
from heli_sim.model.mjcf import left_out, mjcf
from heli_sim.rig import Rig, load_rig

from tests.cli.terminal import Terminal, terminal

__all__ = ["terminal"]

pytestmark = pytest.mark.medium

mujoco = pytest.importorskip("mujoco")
JOINTS = ("elevation", "pitch", "travel")
STEP_s, SECONDS = 0.001, 3.0


def volts_V(t_s: float) -> np.ndarray:
    """Around hover, and once below the dead zone."""
    front = 1.75 + 0.4 * np.sin(3.0 * t_s)
    return np.array([front, 0.3 if 1.0 < t_s < 1.2 else 1.65])


def in_mujoco(rig: Rig, start: np.ndarray) -> np.ndarray:
    model = mujoco.MjModel.from_xml_string(mjcf(rig, STEP_s, stops=False))
    data = mujoco.MjData(model)
    for joint, angle in zip(JOINTS, start, strict=True):
        data.joint(joint).qpos[0] = angle
    observed = []
    for step in range(round(SECONDS / STEP_s)):
        observed.append([data.joint(joint).qpos[0] for joint in JOINTS])
        for side, volts in zip(("front", "back"), volts_V(step * STEP_s), strict=True):
            data.actuator(side).ctrl[0] = volts
        mujoco.mj_step(model, data)
    return np.array(observed)


def by_equations(rig: Rig, start: np.ndarray) -> np.ndarray:
    model = MultibodyModel()
    x, u = ca.SX.sym("x", 6), ca.SX.sym("u", 2)
    rates = ca.Function("f", [x, u], [model.dynamics(x, u, ca.SX(model.parameter_values(rig)))])
    state, seen = np.concatenate((start, np.zeros(3))), []
    for step in range(round(SECONDS / STEP_s)):
        seen.append(state[:3])
        u_now = volts_V(step * STEP_s)
        k1 = np.array(rates(state, u_now)).ravel()
        k2 = np.array(rates(state + 0.5 * STEP_s * k1, u_now)).ravel()
        k3 = np.array(rates(state + 0.5 * STEP_s * k2, u_now)).ravel()
        k4 = np.array(rates(state + STEP_s * k3, u_now)).ravel()
        state = state + STEP_s / 6.0 * (k1 + 2 * k2 + 2 * k3 + k4)
    return np.array(seen)


@pytest.mark.parametrize("name", ["makki2024", "quanser-course"])
def test_exported_rig_flies_in_mujoco_as_the_equations_do(name: str) -> None:
    rig = load_rig(name).replace(torque_travel=0.02, torque_pitch=-0.003, reverse_thrust=0.0)
    start = np.array([0.1, -0.05, 0.3])
    theirs, ours = in_mujoco(rig, start), by_equations(rig, start)
    assert np.ptp(ours, axis=0).min() > 0.1
    assert np.abs(theirs - ours).max() < 1e-6


def test_arm_falls_onto_its_stop_and_no_further() -> None:
    rig = load_rig("makki2024").replace(M_w=1.3)
    model = mujoco.MjModel.from_xml_string(mjcf(rig))
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 4000)
    assert np.rad2deg(data.joint("elevation").qpos[0]) == pytest.approx(-25.0, abs=1.0)


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
