"""Filter and smoother against dense algebra: states and outputs of a window in one normal distribution."""

from __future__ import annotations

import numpy as np
import pytest
from heli_lab.diagnose.kalman import StateSpace, filter_outputs, smooth
from scipy.stats import multivariate_normal

pytestmark = pytest.mark.diagnosis

STEPS, ORDER, OUTPUTS = 7, 4, 2
LENGTHS = (7, 4)


@pytest.fixture(scope="module")
def system() -> StateSpace:
    """Two windows, the second one shorter, of a random time-varying system with two disturbances."""
    random = np.random.default_rng(3)
    alive = np.arange(STEPS)[:, None] < np.array(LENGTHS)
    within = alive[:, :, None, None]
    shape = (STEPS, len(LENGTHS))
    return StateSpace.with_disturbance(
        random.normal(0.0, 0.6, (*shape, 2, 2)),
        random.normal(0.0, 1.0, (*shape, 2, 2)),
        random.normal(0.0, 1.0, (*shape, OUTPUTS, ORDER)) * within,
        alive,
        rho=0.8,
        sigma=np.array([0.5, 1.5]),
        state_std=np.array([0.3, 2.0]),
        measurement_variance=0.4,
    )


@pytest.fixture(scope="module")
def outputs() -> np.ndarray:
    """One column of outputs, zero after a window's end."""
    alive = np.arange(STEPS)[:, None] < np.array(LENGTHS)
    random = np.random.default_rng(4)
    return random.normal(0.0, 1.0, (STEPS, len(LENGTHS), OUTPUTS, 1)) * alive[:, :, None, None]


def dense(system: StateSpace, window: int) -> tuple[np.ndarray, np.ndarray]:
    """States and outputs of a window as linear maps of independent unit variables."""
    count = LENGTHS[window]
    roots = [np.linalg.cholesky(matrix + 1e-15 * np.eye(ORDER)) for matrix in (system.P0, system.Q)]
    width = ORDER * (count + 1) + OUTPUTS * count
    state = np.zeros((ORDER, width))
    state[:, :ORDER] = roots[0]
    states, measured = [], []
    for k in range(count):
        noise = np.zeros((OUTPUTS, width))
        place = ORDER * (count + 1) + OUTPUTS * k
        noise[:, place : place + OUTPUTS] = np.linalg.cholesky(system.R)
        states.append(state)
        measured.append(system.C[k, window] @ state + noise)
        state = system.Phi[k, window] @ state
        state[:, ORDER * (k + 1) : ORDER * (k + 2)] += roots[1]
    return np.vstack(states), np.vstack(measured)


def test_innovations_are_the_log_likelihood_of_the_outputs(system: StateSpace, outputs: np.ndarray) -> None:
    filtered = filter_outputs(system, outputs)
    values = filtered.value[system.alive]
    found = -0.5 * (np.sum(values**2) + filtered.log_determinant + values.size * np.log(2.0 * np.pi))
    expected = 0.0
    for window, count in enumerate(LENGTHS):
        _, measured = dense(system, window)
        expected += multivariate_normal.logpdf(outputs[:count, window].ravel(), cov=measured @ measured.T)
    assert found == pytest.approx(expected, abs=1e-9)


def test_innovations_are_white_and_of_unit_variance(system: StateSpace) -> None:
    # The filter is linear: its matrix whitens the outputs' covariance.
    for window, count in enumerate(LENGTHS):
        columns = np.zeros((STEPS, len(LENGTHS), OUTPUTS, OUTPUTS * count))
        columns[:count, window] = np.eye(OUTPUTS * count).reshape(count, OUTPUTS, -1)
        whiten = filter_outputs(system, columns).value[:count, window].reshape(OUTPUTS * count, -1)
        _, measured = dense(system, window)
        assert np.allclose(whiten @ measured @ measured.T @ whiten.T, np.eye(OUTPUTS * count), atol=1e-9)


def test_smoothed_states_are_the_conditional_distribution(system: StateSpace, outputs: np.ndarray) -> None:
    mean, covariance = smooth(system, filter_outputs(system, outputs, keep=True))
    for window, count in enumerate(LENGTHS):
        states, measured = dense(system, window)
        gain = states @ measured.T @ np.linalg.inv(measured @ measured.T)
        expected = gain @ outputs[:count, window].ravel()
        left = states @ states.T - gain @ measured @ states.T
        for k in range(count):
            place = slice(ORDER * k, ORDER * (k + 1))
            assert np.allclose(mean[k, window, :, 0], expected[place], atol=1e-9)
            assert np.allclose(covariance[k, window], left[place, place], atol=1e-9)


def test_disturbances_keep_their_standard_deviation_and_forget_by_rho(system: StateSpace) -> None:
    moved = system.Phi[0, 0] @ system.P0
    after = (moved @ system.Phi[0, 0].T + system.Q)[2:, 2:]
    assert np.allclose(after, np.diag([0.5**2, 1.5**2]))
    assert np.allclose(moved[2:, 2:], 0.8 * after)
