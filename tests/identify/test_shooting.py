"""A fit finds the true parameters, predicts a held-out flight, and refuses unexplained sensor noise."""

import functools
import math
import pickle
from dataclasses import replace
from functools import cache
from pathlib import Path

import heli_sim.evaluate.compiled
import numpy as np
import pytest
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_host.data.log.reader import read_flight
from heli_host.data.log.table import write_csv
from heli_host.fly.plan import Plan
from heli_lab.errors import NotExcited
from heli_lab.fit.free_run import InterpretedKernel
from heli_lab.fit.identification import Identification, check, first_rig_name, identify, validate
from heli_lab.fit.problem import Budget, Problem, alternative_states, initial_state_guess
from heli_lab.fit.records import prepare
from heli_lab.fit.shooting import Iterate, ShootingCost, refine_states, restart_states, solve
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
from heli_sim.model.effects import RotorLag, catalogue, parse_effects
from heli_sim.rig import Rig, load_rig

from tests.cli.terminal import Terminal, refusal
from tests.identify.coverage import cover, share_within
from tests.identify.made import encoder_zeros_deg, flown, flown_by_plan, perturbed, thinned
from tests.running.long import samples

pytestmark = pytest.mark.slow

PRACTICE = Path(__file__).resolve().parents[3] / "shared" / "data" / "practice" / "none"
CHANGED = {"thrust_gain": 0.63, "friction_travel": 0.055, "friction_pitch": 0.02}


def known() -> Rig:
    """Return the rig file from which the fits start."""
    return load_rig("makki2024")


@cache
def changed_flight(seed: int, duration_s: float = 25.0) -> Flight:
    """Fly a rig whose parameters differ from the rig file by `CHANGED`."""
    return flown(known().replace(**CHANGED), seed, duration_s)


@cache
def late_flight() -> Flight:
    """Fly a rig whose thrust lags by 80 ms behind voltages that act 20 ms late."""
    effects = catalogue()
    late = effects["input_delay"].make({"input_delay_s": 0.02})
    lag = effects["rotor_lag"].make({"rotor_lag_s": 0.08})
    return flown(known(), 5, 25.0, MultibodyModel((lag, late)))


def assert_estimates(result: Identification, truth: dict[str, float], within: float = 3.0) -> None:
    """Assert that estimates are `within` some standard errors of the truth."""
    for name, value in truth.items():
        assert result.fit.params[name] == pytest.approx(value, abs=within * result.fit.std[name]), name


def test_flight_of_the_identify_plan_gives_the_true_rig() -> None:
    rig = known().replace(**CHANGED)
    result = identify(MultibodyModel(), known(), [flown_by_plan(rig, 4)], validation=[changed_flight(3)])
    truth = {name: rig[name].value for name in result.fit.params} | encoder_zeros_deg(rig, 4)
    assert_estimates(result, truth)
    residual = result.json()["normalised_residual"]
    assert residual["train"] <= 1.02
    assert residual["validation"] <= 1.05
    assert all(result.training[0].white.values())


def test_standard_errors_cover_the_truth_on_flights_of_random_rigs() -> None:
    flights = [cover(seed) for seed in (1, 5, 7)[: samples(3, 1)]]
    assert share_within(flights) >= 0.90
    assert max(flight.held_out for flight in flights) <= 1.05


def test_several_flights_share_the_rig_and_each_keeps_its_own_zeros() -> None:
    rig = known().replace(**CHANGED)
    flights = [changed_flight(seed) for seed in (3, 4)]
    one_flight = identify(MultibodyModel(), known(), flights[:1], labels=["third"])
    both = identify(MultibodyModel(), known(), flights, labels=["third", "fourth"])
    assert_estimates(both, CHANGED)
    for label, seed in (("third", 3), ("fourth", 4)):
        zeros = encoder_zeros_deg(rig, seed)
        assert_estimates(both, {f"{name}[{label}]": zero for name, zero in zeros.items()})
    for name in CHANGED:
        assert both.fit.std[name] < one_flight.fit.std[name]
    assert both.rig("new")["offset_pitch"] == known()["offset_pitch"]


def test_fit_succeeds_from_a_rig_file_with_large_errors() -> None:
    numbers = dict(known().numbers)
    for name, value, tolerance in (("thrust_gain", 0.2, 1.0), ("M_w", 0.8, 1.5), ("L_phi", -0.03, 0.2)):
        numbers[name] = replace(numbers[name], value=value, tolerance=tolerance)
    vague = Rig("vague", "hardly anything is known", numbers)
    # Windows that a step leaves behind find their own way: so long ones alone do.
    one_flight = solve(Problem(MultibodyModel(), vague, [changed_flight(3)]), fine=False)
    assert check(one_flight).normalised <= 1.03
    result = identify(MultibodyModel(), vague, [changed_flight(3)])
    assert_estimates(result, CHANGED, within=4.0)
    assert result.json()["normalised_residual"]["train"] <= 1.03


def test_a_delay_and_a_lag_are_distinguished() -> None:
    effects = catalogue()
    model = MultibodyModel((effects["rotor_lag"].make({"rotor_lag_s": 0.04}), effects["input_delay"].make()))
    result = identify(model, known(), [late_flight()])
    assert_estimates(result, {"rotor_lag_s": 0.08, "input_delay_s": 0.02})
    assert result.fit.std["rotor_lag_s"] < 1e-3 and result.fit.std["input_delay_s"] < 1e-3
    assert result.json()["normalised_residual"]["train"] <= 1.03
    assert result.rig("new").effects["rotor_lag"]["s"].value == result.fit.params["rotor_lag_s"]
    # A twin of the new rig is one of the machine that the first rig describes.
    assert first_rig_name(result.rig("new")) == first_rig_name(result.fit.problem.rig) == "makki2024"


def test_residuals_of_an_incomplete_model_are_large_and_not_white() -> None:
    result = identify(MultibodyModel(), known(), [late_flight()])
    assert result.training[0].normalised > 5.0
    assert not any(result.training[0].white[axis] for axis in ("elevation", "pitch"))


def test_without_a_compiler_the_answer_is_the_same(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    flight = changed_flight(3).between(8.0, 8.0 + 0.1 * samples(25, 15))
    problem = Problem(MultibodyModel(), known(), [flight], free=tuple(CHANGED))
    compiled = solve(problem, fine=False)
    monkeypatch.setattr(heli_sim.evaluate.compiled, "compiler", lambda: None)
    monkeypatch.setattr(heli_sim.evaluate.compiled, "cache_folder", lambda: tmp_path)
    slow = Problem(MultibodyModel(), known(), [flight], free=tuple(CHANGED))
    assert isinstance(slow.kernel, InterpretedKernel)
    interpreted = solve(slow, fine=False)
    np.testing.assert_allclose(interpreted.theta, compiled.theta, rtol=1e-6)
    np.testing.assert_allclose(interpreted.covariance, compiled.covariance, rtol=1e-4)


def test_the_take_off_is_left_out_wherever_the_log_begins() -> None:
    complete = changed_flight(3)
    bare = Flight(complete.t_s, complete.front_V, complete.back_V, *complete.angles_rad.T)
    first_fitted_s = {}
    for label, flight in (("states", complete), ("no states", bare), ("late start", bare.between(0.2, 99.0))):
        record = prepare(flight, known(), label)
        first_fitted_s[label] = record.t_s[record.segments[0][0]]
        assert np.rad2deg(record.angles_rad[record.segments[0][0], 0]) > -15.0
        assert record.cuts[0].start_s == record.t_s[0]
    assert max(first_fitted_s.values()) - min(first_fitted_s.values()) < 0.01
    with_take_off, in_flight = (
        solve(Problem(MultibodyModel(), known(), [flight])) for flight in (complete, bare.between(8.0, 99.0))
    )
    for name in CHANGED:
        within = 3 * in_flight.std[name]
        assert with_take_off.params[name] == pytest.approx(in_flight.params[name], abs=within), name


def test_a_touch_of_the_table_in_flight_is_left_out() -> None:
    complete = changed_flight(3)
    angles = complete.angles_rad.copy()
    touch = (complete.t_s > 15.0) & (complete.t_s < 15.3)
    angles[touch, 0] = np.deg2rad(-25.0)
    record = prepare(Flight(complete.t_s, complete.front_V, complete.back_V, *angles.T), known())
    assert not any(touch[start:stop].any() for start, stop in record.segments)


def test_disturbed_window_hardly_changes_the_robust_estimate() -> None:
    complete = changed_flight(3)
    angles = complete.angles_rad.copy()
    pushed = (complete.t_s > 15.0) & (complete.t_s < 15.5)
    # For half a second, pitch swings by 4 degrees without any cause in the model.
    angles[pushed, 1] += np.deg2rad(4.0) * np.sin(2 * np.pi * complete.t_s[pushed])
    flight = Flight(complete.t_s, complete.front_V, complete.back_V, *angles.T)
    problem = Problem(MultibodyModel(), known(), [flight])
    robust, plain = solve(problem, fine=False), solve(problem, fine=False, robust=False)
    assert robust.weights[0].min() < 0.1
    for name, value in CHANGED.items():
        assert robust.params[name] == pytest.approx(value, rel=0.05), name
        assert abs(robust.params[name] - value) < abs(plain.params[name] - value), name


def test_a_budget_that_runs_out_is_reported() -> None:
    fit = solve(Problem(MultibodyModel(), known(), [changed_flight(3)]), budget=Budget(max_evaluations=2))
    assert not fit.converged
    assert check(fit).normalised > 1.0


@pytest.mark.skipif(not PRACTICE.exists(), reason="skipped: no shared data")
def test_a_practice_flight_with_nothing_hidden_is_explained_down_to_the_encoder() -> None:
    flights = [read_flight(PRACTICE / name) for name in ("a.csv.gz", "b.csv.gz")]
    for train, held_out in (flights, flights[::-1])[: samples(2, 1)]:
        result = identify(MultibodyModel(), known(), [train], validation=[held_out])
        residual = result.json()["normalised_residual"]
        assert residual["train"] <= 1.02
        assert residual["validation"] <= 1.02


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
    error_Nm = fit.params["coulomb_friction_pitch_Nm"] - DRY_Nm
    assert abs(error_Nm) < 3.0 * fit.std["coulomb_friction_pitch_Nm"]
    # In another flight, no window stays in a wrong state.
    assert check(validate(fit, [dry_flight(8)])).normalised < 1.05


def iterate_at(problem: Problem, states: Floats, prior: Floats) -> tuple[ShootingCost, Iterate]:
    """Return a cost with unit variances and weights, and its iterate at these states and the start values."""
    cost = ShootingCost(problem, robust=False)
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
    assert abs(fit.params[prefix + "Hz"] - 2.25) < 3.0 * fit.std[prefix + "Hz"]
    assert abs(np.hypot(fit.params[prefix + "sin_Nm"], fit.params[prefix + "cos_Nm"]) - 0.04) < 0.002


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
    cost = ShootingCost(problem, robust=False)
    slow, fast = np.array([0.2]), np.array([0.02])
    for theta in (slow, fast, fast, slow):
        (states,) = cost.initial_state_guess(theta)
        assert np.array_equal(states, initial_state_guess(problem, theta)[0])
        # An optimiser may change the states that it received; the cached ones must not change.
        states += 1.0
    assert not np.allclose(initial_state_guess(problem, slow)[0], initial_state_guess(problem, fast)[0])


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
