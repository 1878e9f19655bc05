"""Initial states of windows: a window that a joint step does not improve is optimised separately."""

from __future__ import annotations

import functools
import pickle

import numpy as np
import pytest
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_lab.fit.identification import check, validate
from heli_lab.fit.problem import Problem, alternative_states, initial_state_guess
from heli_lab.fit.records import prepare
from heli_lab.fit.shooting import Iterate, ShootingCost, refine_states, restart_states, solve
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import catalogue
from heli_sim.rig import load_rig

from tests.identify.made import flown, thinned

pytestmark = pytest.mark.slow

FLIGHT_S = 24.0
DRY_Nm = 0.04
RIG = load_rig("makki2024")
KIND = catalogue()["coulomb_friction.pitch"]


@functools.cache
def dry_flight(seed: int) -> Flight:
    """Fly a rig with so much dry friction about pitch that its torque jumps by a rotor's at each reversal."""
    true = KIND.make({"coulomb_friction_pitch_Nm": DRY_Nm, "coulomb_friction_pitch_hold_s": 0.01})
    return flown(RIG, seed, FLIGHT_S, MultibodyModel((true,)))


def fit_with_friction(size_Nm: float, seed: int = 7) -> Problem:
    """Pose the fit of a flight with dry friction, which starts from friction of this size."""
    effect = KIND.make({"coulomb_friction_pitch_Nm": size_Nm})
    record = prepare(dry_flight(seed), RIG, f"flight {seed}")
    return Problem(MultibodyModel((effect,)), RIG, [record], step_s=0.004)


def test_hard_dry_friction_of_the_light_axis_is_found_from_a_start_without_any() -> None:
    fit = solve(fit_with_friction(0.0))
    assert check(fit).normalised < 1.03
    error_Nm = fit.values["coulomb_friction_pitch_Nm"] - DRY_Nm
    assert abs(error_Nm) < 3.0 * fit.std["coulomb_friction_pitch_Nm"]
    # In another flight, no window stays in a wrong state.
    assert check(validate(fit, [dry_flight(8)])).normalised < 1.05


def iterate_at(problem: Problem, states: Floats, prior: Floats) -> tuple[ShootingCost, Iterate]:
    """Return a cost with unit variances and weights, and its iterate at these states and the start values."""
    cost = ShootingCost(problem, False)
    cost.variance, cost.weights, cost.state_prior = [np.ones(3)], [np.ones(len(states))], [prior]
    return cost, cost.evaluate(problem.parameter_vector.start, [states])


def test_window_in_a_wrong_state_is_refined_without_the_others() -> None:
    problem = fit_with_friction(DRY_Nm)
    theta = problem.parameter_vector.start
    (states,) = initial_state_guess(problem, theta)
    cost, refined = iterate_at(problem, states, states)
    refine_states(cost, refined, 0, np.arange(len(states)), max_steps=20)
    right_cost = cost.window_cost(refined, 0)
    # The pitch rate of window 3 is wrong by 0.3 rad/s.
    wrong = refined.states[0].copy()
    wrong[3, 4] += 0.3
    cost, iterate = iterate_at(problem, wrong, states)
    assert cost.window_cost(iterate, 0)[3] > 100.0 * right_cost[3]
    refine_states(cost, iterate, 0, np.array([3]), max_steps=20)
    assert cost.window_cost(iterate, 0)[3] < 1.05 * right_cost[3]
    np.testing.assert_array_equal(np.delete(iterate.states[0], 3, axis=0), np.delete(wrong, 3, axis=0))
    evaluation = problem.evaluation(0, theta, iterate.states[0])
    np.testing.assert_allclose(iterate.evaluations[0].residual, evaluation.residual, atol=1e-9)


def test_diverged_window_restarts_from_both_sides_of_a_play() -> None:
    kind, play_rad = catalogue()["backlash.travel"], 0.02
    true = kind.make({"backlash_travel_rad": play_rad})
    problem = Problem(
        MultibodyModel((true,)),
        RIG,
        [thinned(flown(RIG, 7, 8.0, MultibodyModel((true,))), 2)],
        step_s=0.004,
        state_std={"backlash_travel_shaft_rad": 0.02},
    )
    theta = problem.parameter_vector.start
    (guess,) = initial_state_guess(problem, theta)
    cost, refined = iterate_at(problem, guess, guess)
    refine_states(cost, refined, 0, np.arange(len(guess)), max_steps=20)
    right_cost = cost.window_cost(refined, 0)
    # The rates of the first window are so wrong that it diverges.
    diverged = refined.states[0].copy()
    diverged[0, 3:6] += 5.0
    alternatives = alternative_states(problem, 0, theta, diverged)
    # The arm may be on either side of the play, half a play from the angle that the encoder shows.
    travel_shifts_rad = sorted(float(states[0, 2] - guess[0, 2]) for states in alternatives[2:])
    assert travel_shifts_rad == pytest.approx([-0.5 * play_rad, 0.5 * play_rad])
    cost, iterate = iterate_at(problem, diverged, guess)
    for states in alternatives:
        restart_states(cost, iterate, 0, np.array([0]), states)
    assert cost.window_cost(iterate, 0)[0] < 1.05 * right_cost[0]
    np.testing.assert_array_equal(iterate.states[0][1:], diverged[1:])


def test_periodic_torque_is_fitted_from_a_small_size_and_wrong_phase() -> None:
    kind, prefix = catalogue()["periodic_torque.travel"], "periodic_torque_travel_"
    true = {prefix + "sin_Nm": 0.04, prefix + "cos_Nm": 0.0, prefix + "Hz": 2.25}
    flight = thinned(flown(RIG, 7, FLIGHT_S, MultibodyModel((kind.make(true),))), 2)
    # The start is small, and has a wrong phase.
    start = kind.make({prefix + "sin_Nm": -0.002, prefix + "cos_Nm": -0.002, prefix + "Hz": 2.26})
    fit = solve(Problem(MultibodyModel((start,)), RIG, [flight], step_s=0.004))
    assert check(fit).normalised < 1.03
    assert abs(fit.values[prefix + "Hz"] - 2.25) < 3.0 * fit.std[prefix + "Hz"]
    assert abs(np.hypot(fit.values[prefix + "sin_Nm"], fit.values[prefix + "cos_Nm"]) - 0.04) < 0.002


def test_refined_states_fall_back_to_better_earlier_states() -> None:
    problem = fit_with_friction(DRY_Nm)
    theta = problem.parameter_vector.start
    (states,) = initial_state_guess(problem, theta)
    diverged = states.copy()
    diverged[2, 3:] = np.nan
    cost, iterate = iterate_at(problem, diverged, states)
    refine_states(cost, iterate, 0, np.array([2]), before=states, max_steps=0)
    np.testing.assert_array_equal(iterate.states[0][2], states[2])


def test_a_window_may_start_where_the_one_before_it_ends() -> None:
    problem = fit_with_friction(DRY_Nm)
    theta = problem.parameter_vector.start
    (states,) = initial_state_guess(problem, theta)
    states[2] = np.nan
    windows = np.array(problem.windows(0))
    _, ends = problem.kernel.predict(
        problem.grid(0, False, theta).inputs, states, problem.parameters(theta, 0)
    )
    start = alternative_states(problem, 0, theta, states)[0]
    assert np.all(windows[:-1].sum(axis=1) == windows[1:, 0])
    # No window is before the first one, and the third one diverges, so the fourth has no start from it.
    unchanged = [0, 3]
    np.testing.assert_array_equal(start[unchanged], states[unchanged])
    np.testing.assert_array_equal(np.delete(start, unchanged, axis=0), np.delete(ends[:-1], 2, axis=0))


def test_residuals_agree_with_the_products_of_the_kernel() -> None:
    problem = fit_with_friction(DRY_Nm)
    theta = problem.parameter_vector.start
    (states,) = initial_state_guess(problem, theta)
    residual, evaluation = problem.residual(0, theta, states), problem.evaluation(0, theta, states)
    np.testing.assert_allclose(residual, evaluation.residual, atol=1e-9)
    squares = [np.sum(residual[window] ** 2, axis=0) for window in problem.grid(0, False, theta).slices]
    np.testing.assert_allclose(evaluation.squares, squares, rtol=1e-9)


def test_variants_of_a_problem_share_its_kernel() -> None:
    problem = fit_with_friction(0.01)
    for other in (problem.with_windows(1.0), problem.with_split_windows(2), problem.with_free(problem.free)):
        assert other.kernel is problem.kernel
        assert other.grid(0, False, problem.parameter_vector.start) is not problem.grid(
            0, False, problem.parameter_vector.start
        )
    assert pickle.loads(pickle.dumps(problem)).kernel is not problem.kernel


def test_initial_states_are_computed_once_for_each_parameter_vector() -> None:
    lag = catalogue()["rotor_lag"].make({"rotor_lag_s": 0.05})
    record = prepare(dry_flight(7), RIG, "flight 7")
    problem = Problem(MultibodyModel((lag,)), RIG, [record], free=["rotor_lag_s"], step_s=0.004)
    cost = ShootingCost(problem, False)
    slow, fast = np.array([0.2]), np.array([0.02])
    for theta in (slow, fast, fast, slow):
        (states,) = cost.initial_state_guess(theta)
        assert np.array_equal(states, initial_state_guess(problem, theta)[0])
        # An optimiser may change the states that it received; the cached ones must not change.
        states += 1.0
    assert not np.allclose(initial_state_guess(problem, slow)[0], initial_state_guess(problem, fast)[0])
