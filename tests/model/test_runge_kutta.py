"""A Runge-Kutta step has an error of fifth order, and integrates time-dependent derivatives too."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest
from heli_host.data.arrays import Floats
from heli_sim.runge_kutta import runge_kutta_step


def oscillator(state: Floats, later_s: float) -> Floats:
    """A mass on a spring under a force that grows with time."""
    return np.array([state[1], later_s - state[0]])


def error(step_s: float) -> float:
    after = runge_kutta_step(oscillator, np.array([1.0, 0.0]), step_s)
    exact = step_s + math.cos(step_s) - math.sin(step_s)
    return abs(float(after[0]) - exact)


def test_half_the_step_has_a_thirty_second_of_the_error() -> None:
    assert error(0.2) / error(0.1) == pytest.approx(32.0, rel=0.1)


def test_symbols_and_numbers_take_the_same_step() -> None:
    x = ca.SX.sym("x", 2)
    step = ca.Function(
        "step", [x], [runge_kutta_step(lambda at, later_s: ca.vertcat(at[1], later_s - at[0]), x, 0.1)]
    )
    numbers = runge_kutta_step(oscillator, np.array([1.0, 0.5]), 0.1)
    assert np.asarray(step([1.0, 0.5])).ravel() == pytest.approx(numbers, rel=1e-15)
