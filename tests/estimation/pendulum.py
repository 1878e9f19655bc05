"""A cart with a hanging pendulum, simulated by SciPy: a machine other than the helicopter."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from heli_host.data.arrays import Floats
from heli_lab.fit.grey_box import DisturbanceModel, GreyBoxModel, no_reset
from scipy.integrate import solve_ivp

TRUE = {"cart_kg": 0.8, "damping_Ns_m": 1.5, "length_m": 0.35, "pivot_Nms": 0.004}
PENDULUM_kg, GRAVITY = 0.25, 9.81
STEP_s = 0.005
PARAMETERS = (*TRUE, "force_N", "torque_Nm")


def accelerations(x: Any, motor_N: Any, p: Any, functions: Any = math) -> tuple[Any, Any]:
    """Return the accelerations of cart and pendulum, from the equations of Lagrange.

    The state `x` is position, angle, velocity and angular velocity. `functions` is ``math`` for numbers and
    ``casadi`` for symbols.
    """
    cart_kg, damping_Ns_m, length_m, pivot_Nms, force_N, torque_Nm = p
    _, angle, velocity, spin = x
    moment = PENDULUM_kg * length_m
    sine, coupling = functions.sin(angle), moment * functions.cos(angle)
    push_N = motor_N + force_N - damping_Ns_m * velocity + moment * spin**2 * sine
    turn_Nm = torque_Nm - pivot_Nms * spin - moment * GRAVITY * sine
    mass, inertia = cart_kg + PENDULUM_kg, moment * length_m
    determinant = mass * inertia - coupling**2
    return (
        (inertia * push_N - coupling * turn_Nm) / determinant,
        (mass * turn_Nm - coupling * push_N) / determinant,
    )


def _dynamics(x: ca.SX, u: ca.SX, p: ca.SX, t: ca.SX) -> ca.SX:
    """Return the rates of the four states."""
    return ca.vertcat(x[2], x[3], *accelerations(ca.vertsplit(x), u[0], ca.vertsplit(p), ca))


MODEL = GreyBoxModel(
    states=("position_m", "angle_rad", "rate_m_s", "spin_rad_s"),
    inputs=("motor_N",),
    outputs=("position_m", "angle_rad"),
    parameters=PARAMETERS,
    disturbed=("force_N", "torque_Nm"),
    dynamics=_dynamics,
    measurement=lambda x, u, p, t: x[:2],
    reset_map=no_reset,
    initial_std=np.array([0.01, 0.01, 0.1, 0.1]),
    disturbance_start=DisturbanceModel.start((0.1, 0.01), (0.01, 0.001)),
    disturbance_std_range=(1e-5, 10.0),
)


@dataclass(frozen=True)
class Run:
    """A recording of the cart."""

    label: str
    t_s: Floats
    step_s: float
    outputs: Floats
    inputs: Floats
    resolution: Floats
    segments: tuple[tuple[int, int], ...]


def run(seed: int, seconds: float = 20.0) -> Run:
    """Simulate a recording: a multisine and disturbances move the cart, and two encoders are read.

    The disturbances are first-order Gauss-Markov processes with a correlation time of 0.25 s.
    """
    rng, count = np.random.default_rng(seed), round(seconds / STEP_s)
    t_s = np.asarray(np.arange(count) * STEP_s, float)
    frequencies, phases = 2 * np.pi * np.linspace(0.1, 2.5, 12), rng.uniform(0, 2 * np.pi, 12)
    disturbances, std = np.zeros((count, 2)), (0.08, 0.004)
    correlation = 0.98  # from sample to sample: exp(-STEP_s / 0.25 s)
    for k in range(1, count):
        fresh = rng.normal(0.0, std)
        disturbances[k] = correlation * disturbances[k - 1] + (1 - correlation**2) ** 0.5 * fresh

    def motor_N(t: Any) -> Floats:
        return np.asarray(0.9 * np.sin(np.multiply.outer(t, frequencies) + phases).sum(axis=-1))

    def rates(t: float, x: Floats) -> Floats:
        disturbed = [np.interp(t, t_s, values) for values in disturbances.T]
        return np.array([x[2], x[3], *accelerations(x, motor_N(t), (*TRUE.values(), *disturbed))])

    states = solve_ivp(
        rates, (0.0, seconds), np.zeros(4), t_eval=t_s, max_step=STEP_s, rtol=1e-7, atol=1e-8
    ).y.T
    resolution = np.array([1e-4, 2 * np.pi / 4096])
    outputs = np.round(states[:, :2] / resolution) * resolution
    inputs = motor_N(t_s + 0.5 * STEP_s)[:, None]
    return Run(f"run {seed}", t_s, STEP_s, outputs, inputs, resolution, ((20, count),))
