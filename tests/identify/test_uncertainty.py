"""`identify` refuses sensor noise that no voltage explains, and accepts a hover, also under disturbances."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_host.data.log.table import write_csv
from heli_host.fly.plan import Plan
from heli_lab.errors import NotExcited
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
from heli_sim.model.effects import RotorLag, parse_effects
from heli_sim.rig import load_rig

from tests.cli.terminal import Terminal, refusal
from tests.identify.made import flown, flown_by_plan, perturbed

pytestmark = pytest.mark.slow

ROWS, STEP_S = 6000, 0.002
COUNT_RAD = 2.0 * np.pi / 4096
HOLD = 'title = "hold"\n[[segment]]\nkind = "hold"\nduration_s = 12\n'
STRONGEST = ("random_torque.elevation=0.02", "random_torque.pitch=0.006", "random_torque.travel=0.012")
"""The strongest disturbances of heli_benchmark, N m."""


def smoothed(values: Floats, pole: float) -> Floats:
    """Filter each column by a first-order low-pass with a pole, without normalising the gain."""
    outputs = np.empty_like(values)
    state = np.zeros(values.shape[1])
    for k, row in enumerate(values):
        state = pole * state + row
        outputs[k] = state
    return outputs


def noise(kind: str, seed: int, *, in_counts: bool = False) -> Flight:
    """Make twelve seconds of angles of an IMU that lies still, with voltages that are independent of them."""
    # Kinds are white noise, a random walk, slow noise, and a random walk of the rate ("drift").
    random = np.random.default_rng(seed)
    white = random.standard_normal((ROWS, 3))
    angles = {
        "white": lambda: np.radians(2.0) * white,
        "walk": lambda: np.radians(0.05) * np.cumsum(white, axis=0),
        "slow": lambda: np.radians(0.2) * smoothed(white, 0.995),
        "drift": lambda: np.radians(0.004) * np.cumsum(smoothed(white, 0.98), axis=0),
    }[kind]()
    if in_counts:
        angles = COUNT_RAD * np.round(angles / COUNT_RAD)
    t_s: Floats = STEP_S * np.arange(ROWS, dtype=np.float64)
    sine = 1.7 + 0.3 * np.sin(2.0 * np.pi * np.column_stack((t_s / 3.0, t_s / 3.0 + 0.2)))
    volts: Floats = sine if seed % 2 else 1.7 + 0.2 * random.standard_normal((ROWS, 2))
    columns = np.array([*volts.T, *angles.T], np.float64)
    return Flight(t_s, columns[0], columns[1], columns[2], columns[3], columns[4])


@pytest.mark.parametrize("rig", ["makki2024", "quanser-course"])
@pytest.mark.parametrize("kind", ["white", "walk", "slow", "drift"])
def test_noise_is_not_accepted_as_a_flight(kind: str, rig: str) -> None:
    for seed in (101, 102):
        log = noise(kind, seed, in_counts=seed == 102)
        with pytest.raises(NotExcited, match="the voltages do not explain the motion"):
            identify(MultibodyModel(), load_rig(rig), [log], max_fit_s=20.0)


def test_noise_is_refused_in_a_line_and_writes_no_rig(terminal: Terminal, tmp_path: Path) -> None:
    write_csv(noise("white", 103), tmp_path / "imu.csv")
    arguments = ("identify", "imu.csv", "--save-rig", "new.toml", "--free", "thrust_gain")
    line = refusal(terminal(*arguments), code=2)
    assert line.startswith("error: imu.csv: the voltages do not explain the motion: ")
    assert not (tmp_path / "new.toml").exists()
    assert terminal(*arguments, "--skip-sign-check").code == 0 and (tmp_path / "new.toml").exists()


@pytest.mark.parametrize("effects", [(), STRONGEST], ids=["no disturbances", "the strongest disturbances"])
def test_hover_is_accepted_as_a_flight(effects: tuple[str, ...]) -> None:
    # With two free parameters the others keep their errors, but the shape of the motion is explained.
    for seed in (201, 202):
        rig = load_rig("makki2024") if effects else perturbed(seed)
        model = MultibodyModel(parse_effects(effects)) if effects else None
        hover = flown_by_plan(rig, seed, Plan.parse(HOLD, "hold"), model)
        known = load_rig("makki2024")
        identified = identify(MultibodyModel(), known, [hover], free=("thrust_gain", "friction_pitch"))
        assert identified.training[0].seconds_used > 8.0


def test_validation_on_noise_is_refused_with_the_name_of_the_noise() -> None:
    hover = flown_by_plan(perturbed(203), 203, Plan.parse(HOLD, "hold"))
    with pytest.raises(NotExcited, match=r"^validation 1: the voltages do not explain"):
        identify(
            MultibodyModel(),
            load_rig("makki2024"),
            [hover],
            validation=[noise("white", 104)],
            free=("thrust_gain",),
        )


UNCERTAINTY_STEP_S = 0.002
WINDOWS = [slice(1000 * k, 1000 * (k + 1)) for k in range(20)]
UNCERTAINTY_ROWS = WINDOWS[-1].stop


@cache
def identified(*free: str) -> Identification:
    """Identify the free parameters, by default all, from a flight of 25 s."""
    rig = load_rig("makki2024")
    return identify(MultibodyModel(), rig, [flown(rig, 3, 25.0)], free=free or None)


def coloured(share: float) -> Floats:
    """Make first-order autocorrelated residuals of variance 1; `share` is the correlation of neighbours."""
    values: Floats = np.random.default_rng(1).standard_normal((UNCERTAINTY_ROWS, 3))
    for k in range(1, UNCERTAINTY_ROWS):
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
    factor = long_run_variance(coloured(share), WINDOWS, UNCERTAINTY_STEP_S)
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
