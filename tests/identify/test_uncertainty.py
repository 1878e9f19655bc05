"""Standard errors, parameters that flights cannot separate, and whether the residuals are random."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from heli_host.data.arrays import Floats
from heli_lab.fit.identification import Identification, identify
from heli_lab.fit.problem import Problem
from heli_lab.fit.records import prepare
from heli_lab.fit.shooting import solve
from heli_lab.fit.uncertainty import (
    combinations,
    correlation_at,
    floor_axes,
    long_run_variance,
    timing_variance,
    uninformed_parameters,
    window_weights,
)
from heli_lab.report.identification_page import verdict
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import RotorLag
from heli_sim.rig import load_rig

from tests.identify.made import flown

pytestmark = pytest.mark.slow

STEP_S = 0.002
WINDOWS = [slice(1000 * k, 1000 * (k + 1)) for k in range(20)]
ROWS = WINDOWS[-1].stop


@cache
def identified(*free: str) -> Identification:
    """Identify the free parameters, by default all, from a flight of 25 s."""
    rig = load_rig("makki2024")
    return identify(MultibodyModel(), rig, [flown(rig, 3, 25.0)], free=free or None)


def coloured(share: float) -> Floats:
    """Make first-order autocorrelated residuals of variance 1; `share` is the correlation of neighbours."""
    values: Floats = np.random.default_rng(1).standard_normal((ROWS, 3))
    for k in range(1, ROWS):
        values[k] = share * values[k - 1] + math.sqrt(1.0 - share**2) * values[k]
    return values


def test_only_the_unidentified_combination_of_parameters_is_reported() -> None:
    information = 1e4 * np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    unidentifiable = combinations(("a", "b", "c"), information, np.ones(3))
    assert len(unidentifiable) == 1 and unidentifiable[0].std_over_prior == pytest.approx(1.0)
    assert set(unidentifiable[0].change) == {"a", "b"}
    assert unidentifiable[0].change["a"] == pytest.approx(-unidentifiable[0].change["b"])
    assert combinations(("a", "b"), 1e4 * np.eye(2), np.ones(2)) == []


def test_a_verdict_says_which_axis_did_not_move_and_what_is_uninformed() -> None:
    moving = identified("M_w", "torque_elevation", "friction_elevation")
    assert "did not move" not in verdict(moving)
    (flight,) = moving.training_traces
    still = flight.measured_rad * [1.0, 0.0, 1.0]
    without_pitch = replace(moving, training_traces=(replace(flight, measured_rad=still),))
    assert "pitch did not move there, so the error shows nothing about pitch" in verdict(without_pitch)
    # A slow turn of 25 degrees is nearly a line in each window.
    turning = still + [[0.0, np.radians(25.0), 0.0]] * np.linspace(0.0, 1.0, len(still))[:, None]
    turned = replace(moving, training_traces=(replace(flight, measured_rad=turning),))
    assert "pitch moved there by 25 degrees so evenly that any model predicts it" in verdict(turned)
    assert "did not move" not in verdict(turned)
    nothing = replace(
        moving,
        training=(replace(moving.training[0], normalised=0.9),),
        training_traces=(replace(flight, measured_rad=0.0 * still),),
    )
    assert "No axis moves on the fitted flights" in verdict(nothing)
    assert "Only the encoders' quantisation" not in verdict(nothing)


def test_counterweight_and_constant_torque_are_inseparable_near_level() -> None:
    both = identified("M_w", "torque_elevation", "friction_elevation")
    (first, second, value), *others = both.strong_correlations
    assert {first, second} == {"M_w", "torque_elevation"} and value < -0.99 and not others
    assert [set(combination.change) for combination in both.combinations] in (
        [],
        [{"M_w", "torque_elevation"}],
    )
    two_parameters = identified("M_w", "friction_elevation")
    assert two_parameters.strong_correlations == []
    assert two_parameters.fit.std["M_w"] < 0.3 * both.fit.std["M_w"]


def test_correlations_are_those_of_the_covariance() -> None:
    result = identified()
    names = result.fit.problem.names
    matrix = np.array([[result.json()["correlations"][a][b] for b in names] for a in names])
    np.testing.assert_allclose(np.diag(matrix), 1.0)
    np.testing.assert_allclose(matrix, matrix.T)
    assert np.linalg.eigvalsh(result.fit.covariance).min() > 0.0
    std = np.array(list(result.fit.std.values()))
    np.testing.assert_allclose(matrix * np.outer(std, std), result.fit.covariance, atol=1e-4 * std.max() ** 2)


def test_parameters_that_a_flight_does_not_inform_are_named() -> None:
    result = identified()
    assert "M_l" in result.uninformed_parameters and "thrust_gain" not in result.uninformed_parameters
    assert uninformed_parameters(("a", "b"), np.diag([0.99, 0.01]), np.ones(2)) == ["a"]
    assert result.json()["uninformed_parameters"] == result.uninformed_parameters


def test_no_standard_error_exceeds_that_of_the_prior() -> None:
    result = identified()
    for parameter, std in zip(result.fit.problem.free, result.fit.std.values(), strict=True):
        # Quantisation adds up to 2 % to the prior's standard deviation if the flight shows nothing.
        assert std <= 1.03 * parameter.prior.std, parameter.name


def test_standard_error_of_a_time_is_at_least_that_of_a_voltage_step() -> None:
    record = prepare(flown(load_rig("makki2024"), 3, 25.0), load_rig("makki2024"), "a")
    model = MultibodyModel((RotorLag(0.05),))
    problem = Problem(model, load_rig("makki2024"), [record])
    added_variance = timing_variance(problem)
    # A voltage is held over a step: the variance of a uniform distribution over it.
    assert added_variance[problem.names.index("rotor_lag_s")] == pytest.approx(record.step_s**2 / 12.0)
    assert np.count_nonzero(added_variance) == 1
    assert solve(problem).std["rotor_lag_s"] >= record.step_s / math.sqrt(12.0)


@pytest.mark.parametrize("share", [0.0, 0.5, 0.9])
def test_autocorrelated_residuals_count_as_fewer_samples(share: float) -> None:
    factor = long_run_variance(coloured(share), WINDOWS, STEP_S)
    np.testing.assert_allclose(factor, (1.0 + share) / (1.0 - share), rtol=0.35)


def test_white_residuals_pass_the_test_and_coloured_residuals_fail() -> None:
    lag = 50
    # After 50 rows, a correlation of 0.9 between neighbours has decayed, and one of 0.99 has not.
    for share, is_white in ((0.0, True), (0.9, True), (0.99, False)):
        correlations, bound = correlation_at(coloured(share), WINDOWS, lag)
        assert bool(np.all(np.abs(correlations) < bound)) is is_white, share


def test_an_outlying_window_loses_weight() -> None:
    residual = coloured(0.0)
    residual[WINDOWS[7]] *= 6.0
    residual[WINDOWS[8]] *= 100.0
    weights = window_weights(residual, WINDOWS, np.ones(3))
    assert weights[7] == pytest.approx(0.25, rel=0.1)
    assert weights[8] == pytest.approx(9e-4 * 1e-2, rel=0.1)
    assert np.all(np.delete(weights, [7, 8]) == 1.0)


def test_no_axis_of_a_wrong_model_counts_as_exact() -> None:
    sigma = np.array([4e-4, 4e-4, 4e-4])
    exact = floor_axes(np.ones(3), np.ones(3), sigma)
    np.testing.assert_array_equal(exact, 1.0)
    wrong = floor_axes(np.array([1.0, 1000.0, 1.0]), np.array([1.0, 900.0, 1.0]), sigma)
    assert wrong[1] == 1000.0 and np.all(wrong[[0, 2]] > 400.0)
