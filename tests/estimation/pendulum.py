"""Oracles and machines for the estimation core: the normal density written out, flights, and a pendulum."""

import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_lab.fit.grey_box import DisturbanceModel, GreyBoxModel, no_reset
from heli_lab.fit.records import Record, prepare
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import parse_effects
from heli_sim.rig import load_rig
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from tests.identify import made
from tests.identify.made import flown, thinned
from tests.running.kept import FLOWN, KEPT


def log_density(values: NDArray[np.float64], covariance: NDArray[np.float64]) -> float:
    """Logarithm of the density of N(0, covariance) at values, shape (n,)."""
    # scipy.stats has it, and takes a second of CPU to import.
    log_determinant = np.linalg.slogdet(covariance)[1]
    squares = values @ np.linalg.solve(covariance, values)
    return float(-0.5 * (squares + log_determinant + len(values) * np.log(2.0 * np.pi)))


GUST_Nm = {"elevation": 0.012, "pitch": 0.004, "travel": 0.008}
RIG = load_rig("makki2024")
TRUE_RIG = RIG.replace(thrust_gain=0.62, friction_travel=0.05)
SECONDS = 34.0
MADE_BY = (Path(__file__), Path(made.__file__))


def _flown(share: float = 1.0, *further: str) -> Flight:
    """Fly with a `share` of the disturbances `GUST_Nm`, and with `further` effects."""
    disturbances = parse_effects([f"random_torque.{axis}={share * size}" for axis, size in GUST_Nm.items()])
    return thinned(flown(TRUE_RIG, 21, SECONDS, MultibodyModel((*disturbances, *parse_effects(further)))), 2)


@cache
def flight_with_disturbances() -> Record:
    """Return a flight of `TRUE_RIG` with disturbances that are correlated over half a second."""
    flight = KEPT(f"windy {GUST_Nm} {SECONDS}", _flown, made_by=MADE_BY, rooms=FLOWN)
    return prepare(flight, RIG, "windy")


@cache
def flown_with(effect: str) -> Record:
    """Return a flight of `TRUE_RIG` with an effect, and with a third of those disturbances."""
    flight = KEPT(
        f"{effect} {GUST_Nm} {SECONDS}", lambda: _flown(1 / 3, effect), made_by=MADE_BY, rooms=FLOWN
    )
    return prepare(flight, RIG, effect)


TRUE = {"cart_kg": 0.8, "damping_Ns_m": 1.5, "length_m": 0.35, "pivot_Nms": 0.004}
PENDULUM_kg, GRAVITY = 0.25, 9.81
STEP_s = 0.005
PARAMETERS = (*TRUE, "force_N", "torque_Nm")


def accelerations(x: Any, motor_N: Any, p: Any, functions: Any = math) -> tuple[Any, Any]:
    """Return the accelerations of cart and pendulum, from the equations of Lagrange."""
    # The state `x` is position, angle, velocity and angular velocity. `functions` is ``math`` for numbers and
    # ``casadi`` for symbols.
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
    """Simulate a recording: a multisine and disturbances move the cart, and two encoders are read."""
    # The disturbances are first-order Gauss-Markov processes with a correlation time of 0.25 s.
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
