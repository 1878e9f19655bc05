"""Kalman filter and smoother compared with dense linear algebra.

All states and outputs of a short flight are jointly normal. The tests write them as linear maps of
independent variables, and compute conditional means and covariances directly.
"""

from dataclasses import dataclass

import numpy as np
import pytest
from heli_host.data.arrays import Floats
from heli_lab.fit import _kalman
from numpy.typing import NDArray

from tests.estimation.pendulum import log_density

STEPS, STATES, TORQUES, PARTS = 6, 4, 2, 3
ORDER = STATES + TORQUES
# Correlation of each disturbance torque from part to part of a step, and its standard deviation.
MEMORY, TORQUE_STD = np.array([0.8, 0.3]), np.array([0.5, 1.5])
INITIAL_STD = np.array([0.3, 2.0, 0.1, 1.0])


@dataclass(frozen=True)
class System:
    """A random time-varying linear system with disturbance torques, whose steps consist of `PARTS` parts."""

    # `transition` (STEPS, STATES, STATES): State after a step by state before it.
    # `part_input` (PARTS, STEPS, STATES, inputs): State after a step by a torque in each of its parts; a fast
    # and a slow torque act on each input.
    # `measurement` (STEPS, 3, STATES): Outputs by state.
    # `variance` (STEPS, 3): Variance of the measurement noise; 0 if an output is not measured.

    transition: Floats
    part_input: Floats
    measurement: Floats
    variance: Floats

    def arguments(self, columns: int = 1) -> tuple[Floats, ...]:
        """Return the arguments of filter and smoother before the measurements, with a drive of zero."""
        return (
            self.transition,
            self.part_input,
            self.measurement,
            self.variance,
            MEMORY,
            TORQUE_STD**2,
            INITIAL_STD**2,
            np.zeros((STEPS, STATES, columns)),
        )

    def dense(self) -> tuple[Floats, Floats]:
        """Return states with torques, and outputs, of all steps as linear maps of independent unit
        normals.
        """
        # The rows are those of the steps, one step after the other. The columns are the independent
        # variables: initial states and torques, `TORQUES` torque innovations per step, and 3 measurement
        # noises per step.
        width = ORDER + TORQUES * STEPS + 3 * STEPS
        state = np.zeros((ORDER, width))
        state[range(ORDER), range(ORDER)] = np.concatenate((INITIAL_STD, TORQUE_STD))
        # In each part of a step, a torque has the share MEMORY of its value in the part before.
        shares = MEMORY[None, :] ** np.arange(PARTS)[:, None]  # (parts, torques)
        fast_and_slow_input = np.concatenate((self.part_input, self.part_input), axis=3)
        torque_input = np.einsum("pkij,pj->kij", fast_and_slow_input, shares)  # summed over the parts
        step_memory = MEMORY**PARTS
        states, outputs = [], []
        for k in range(STEPS):
            noise = np.zeros((3, width))
            first_noise = ORDER + TORQUES * STEPS + 3 * k
            noise[range(3), range(first_noise, first_noise + 3)] = np.sqrt(self.variance[k])
            states.append(state)
            outputs.append(self.measurement[k] @ state[:STATES] + noise)
            next_state = self.transition[k] @ state[:STATES] + torque_input[k] @ state[STATES:]
            torque = step_memory[:, None] * state[STATES:]
            first_torque = ORDER + TORQUES * k
            innovation_std = TORQUE_STD * np.sqrt(1.0 - step_memory**2)
            torque[range(TORQUES), range(first_torque, first_torque + TORQUES)] += innovation_std
            state = np.vstack((next_state, torque))
        return np.vstack(states), np.vstack(outputs)


@pytest.fixture(scope="module")
def system() -> System:
    """A random system, the same in each run; at step 2 one output is not measured."""
    random = np.random.default_rng(3)
    variance = random.uniform(0.2, 0.6, (STEPS, 3))
    variance[2, 1] = 0.0
    return System(
        random.normal(0.0, 0.6, (STEPS, STATES, STATES)),
        random.normal(0.0, 0.5, (PARTS, STEPS, STATES, TORQUES // 2)),
        random.normal(0.0, 1.0, (STEPS, 3, STATES)),
        variance,
    )


@pytest.fixture(scope="module")
def measured() -> Floats:
    """Random outputs, one column: shape (STEPS, 3, 1)."""
    return np.random.default_rng(4).normal(0.0, 1.0, (STEPS, 3, 1))


def is_measured(system: System) -> NDArray[np.bool_]:
    """Return which outputs are measured, one step after the other, shape (3 STEPS,)."""
    result: NDArray[np.bool_] = system.variance.ravel() > 0.0
    return result


def test_innovations_give_the_log_likelihood_of_the_measurements(system: System, measured: Floats) -> None:
    innovations, log_variances = _kalman.filter(*system.arguments(), measured)
    count = is_measured(system).sum()
    log_likelihood = -0.5 * (np.sum(innovations**2) + sum(log_variances) + count * np.log(2.0 * np.pi))
    outputs = system.dense()[1][is_measured(system)]
    expected = log_density(measured.ravel()[is_measured(system)], outputs @ outputs.T)
    assert log_likelihood == pytest.approx(expected, abs=1e-9)


def test_innovations_are_white_and_of_unit_variance(system: System) -> None:
    # The filter is linear. Unit vectors as measurements give its matrix, which must whiten the outputs.
    columns = np.eye(3 * STEPS).reshape(STEPS, 3, -1)
    innovations, _ = _kalman.filter(*system.arguments(3 * STEPS), columns)
    whiten = innovations.reshape(3 * STEPS, -1)[np.ix_(is_measured(system), is_measured(system))]
    outputs = system.dense()[1][is_measured(system)]
    assert np.allclose(
        whiten @ outputs @ outputs.T @ whiten.T, np.eye(int(is_measured(system).sum())), atol=1e-9
    )


def test_smoothed_states_are_the_conditional_distribution(system: System, measured: Floats) -> None:
    mean, variance = _kalman.smooth(*system.arguments(), measured)
    states, outputs = system.dense()
    outputs = outputs[is_measured(system)]
    gain = states @ outputs.T @ np.linalg.inv(outputs @ outputs.T)
    assert np.allclose(mean.ravel(), gain @ measured.ravel()[is_measured(system)], atol=1e-9)
    covariance = states @ states.T - gain @ outputs @ states.T
    assert np.allclose(variance.ravel(), np.diag(covariance), atol=1e-9)


def test_tracked_states_are_conditional_on_earlier_measurements_only(
    system: System, measured: Floats
) -> None:
    predicted, filtered = _kalman.track(*system.arguments(), measured)
    states, outputs = system.dense()
    for k in range(STEPS):
        state = states[ORDER * k : ORDER * (k + 1)]
        # A predicted state knows the outputs before step k, a filtered state also those of step k.
        for means, output_count in ((predicted, 3 * k), (filtered, 3 * k + 3)):
            known = is_measured(system) & (np.arange(3 * STEPS) < output_count)
            if not known.any():
                assert np.allclose(means[k], 0.0)
                continue
            gain = state @ outputs[known].T @ np.linalg.inv(outputs[known] @ outputs[known].T)
            assert np.allclose(means[k], gain @ measured.ravel()[known], atol=1e-9)


def test_drive_moves_the_state_of_the_next_step(system: System) -> None:
    arguments = list(system.arguments())
    drive = np.zeros((STEPS, STATES, 1))
    drive[0, :, 0] = [1.0, -2.0, 0.5, 3.0]
    arguments[-1] = drive
    innovations, _ = _kalman.filter(*arguments, np.zeros((STEPS, 3, 1)))
    assert np.all(innovations[0] == 0.0)
    predicted, _ = _kalman.track(*arguments, np.zeros((STEPS, 3, 1)))
    assert np.allclose(predicted[1, :STATES], drive[0, :, 0])


def test_block_of_steps_gives_the_state_of_single_steps(system: System) -> None:
    random = np.random.default_rng(7)
    response = random.normal(0.0, 1.0, (STEPS, STATES, STATES))
    rates = random.normal(0.0, 1.0, (STEPS, STATES, 5))
    responses = _kalman.over_blocks(system.transition, response, rates, 3)
    assert responses.shape == (2, STATES, 5)
    for block in range(2):
        state = np.zeros((STATES, 5))
        for step in range(3 * block, 3 * block + 3):
            state = system.transition[step] @ state + response[step] @ rates[step]
        assert np.allclose(responses[block], state, atol=1e-12)


def test_block_response_moves_each_rate_to_the_end_of_its_block(system: System) -> None:
    random = np.random.default_rng(9)
    response = random.normal(0.0, 1.0, (STEPS, STATES, STATES))
    rates = random.normal(0.0, 1.0, (STEPS, STATES, 2))
    over, parts = _kalman.block_response(system.transition, response, rates, 3)
    assert over.shape == (2, STATES, STATES)
    parts = parts.reshape(3, 2, STATES, 2)
    for block in range(2):
        first, second, third = system.transition[3 * block : 3 * block + 3]
        assert np.allclose(over[block], third @ second @ first, atol=1e-12)
        for step, later_steps in enumerate((third @ second, third, np.eye(STATES))):
            row = 3 * block + step
            expected = later_steps @ response[row] @ rates[row]
            assert np.allclose(parts[step, block], expected, atol=1e-12)


def test_midpoint_rule_is_that_of_dense_algebra() -> None:
    jacobian = np.random.default_rng(8).normal(0.0, 60.0, (9, 7, 7))
    transition, response = _kalman.midpoint(jacobian, 0.01)
    # The implicit midpoint rule is a Cayley transform of half a step of 0.01 s.
    for step_jacobian, phi, gamma in zip(jacobian, transition, response, strict=True):
        half = 0.005 * step_jacobian
        assert np.allclose(phi, np.linalg.solve(np.eye(7) - half, np.eye(7) + half), rtol=1e-9, atol=1e-9)
        assert np.allclose(gamma, 0.01 * np.linalg.inv(np.eye(7) - half), rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize("states", [4, 6, 8, 12, 13])
@pytest.mark.parametrize("disturbance_models", [1, 4, 6])
@pytest.mark.parametrize("inputs", [3, 5])
def test_likelihoods_of_several_disturbance_models_are_those_of_each(
    states: int, disturbance_models: int, inputs: int
) -> None:
    random = np.random.default_rng(100 * states + disturbance_models)
    steps, torques = 41, 2 * inputs
    transition = 0.9 * np.eye(states) + random.normal(0.0, 0.05, (steps, states, states))
    part_input = random.normal(0.0, 0.5, (4, steps, states, inputs))
    measurement = random.normal(0.0, 1.0, (steps, 3, states)) * (random.random((steps, 3, states)) < 0.6)
    variance = random.uniform(0.2, 0.6, (steps, 3))
    variance[5, 1] = 0.0
    initial = random.uniform(0.1, 2.0, states)
    drive = random.normal(0.0, 0.3, (steps, states, 1))
    measured = random.normal(0.0, 1.0, (steps, 3, 1))
    memory = random.uniform(0.3, 0.99, (disturbance_models, torques))
    power = random.uniform(0.1, 2.0, (disturbance_models, torques))
    scale = random.uniform(0.3, 2.0, (disturbance_models, 3))
    fixed = transition, part_input, measurement
    log_likelihoods = _kalman.log_likelihoods(
        *fixed, variance, memory, power, scale, initial, drive, measured
    )
    for number in range(disturbance_models):
        innovations, log_variances = _kalman.filter(
            *fixed, variance * scale[number], memory[number], power[number], initial, drive, measured
        )
        expected = -0.5 * ((innovations[:, :, 0] ** 2).sum(axis=0) + log_variances)
        assert np.allclose(log_likelihoods[number], expected, rtol=1e-9)


def test_arrays_of_another_shape_are_refused(system: System, measured: Floats) -> None:
    with pytest.raises(ValueError, match="measured has another shape"):
        _kalman.filter(*system.arguments(), measured[:-1])
