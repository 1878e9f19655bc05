"""A fit finds the true parameters of a simulated rig, and predicts a held-out flight down to quantisation."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import heli_sim.compiled
import numpy as np
import pytest
from heli_host.data.flight import Flight
from heli_host.data.log.reader import read_flight
from heli_lab.fit.free_run import InterpretedKernel
from heli_lab.fit.identification import Identification, check, identify
from heli_lab.fit.problem import Budget, Problem
from heli_lab.fit.records import prepare
from heli_lab.fit.shooting import solve
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import catalogue
from heli_sim.rig import Rig, load_rig

from tests.identify.coverage import cover, share_within
from tests.identify.made import encoder_zeros_deg, flown, flown_by_plan
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
        assert result.fit.values[name] == pytest.approx(value, abs=within * result.fit.std[name]), name


def test_flight_of_the_identify_plan_gives_the_true_rig() -> None:
    rig = known().replace(**CHANGED)
    result = identify(MultibodyModel(), known(), [flown_by_plan(rig, 4)], validation=[changed_flight(3)])
    truth = {name: rig[name].value for name in result.fit.values} | encoder_zeros_deg(rig, 4)
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
    assert result.rig("new").effects["rotor_lag"]["s"].value == result.fit.values["rotor_lag_s"]


def test_residuals_of_an_incomplete_model_are_large_and_not_white() -> None:
    result = identify(MultibodyModel(), known(), [late_flight()])
    assert result.training[0].normalised > 5.0
    assert not any(result.training[0].white[axis] for axis in ("elevation", "pitch"))


def test_without_a_compiler_the_answer_is_the_same(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    flight = changed_flight(3).between(8.0, 8.0 + 0.1 * samples(25, 15))
    problem = Problem(MultibodyModel(), known(), [flight], free=tuple(CHANGED))
    compiled = solve(problem, fine=False)
    monkeypatch.setattr(heli_sim.compiled, "compiler", lambda: None)
    monkeypatch.setattr(heli_sim.compiled, "cache_folder", lambda: tmp_path)
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
        assert with_take_off.values[name] == pytest.approx(in_flight.values[name], abs=within), name


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
        assert robust.values[name] == pytest.approx(value, rel=0.05), name
        assert abs(robust.values[name] - value) < abs(plain.values[name] - value), name


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
