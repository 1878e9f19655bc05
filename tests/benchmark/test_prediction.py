"""Predictions of the model of an answer: relative to the true model, on flights that no fit has seen."""

from __future__ import annotations

from typing import Any

import pytest
from heli_benchmark.leaderboard.prediction import WORST_RATIO, prediction_ratio, true_errors
from heli_benchmark.task import Answer, AxisSeries, BenchmarkCase, Causes, Estimate
from heli_host.data.arrays import Floats

from tests.benchmark.test_methods import CAUSES, RIG, SPRING, STIFFNESS, flown

SIZE = 0.5
FLIGHT = flown(SIZE)
CASE = BenchmarkCase("case", RIG, (FLIGHT,), (FLIGHT,), CAUSES)
TRUTH: dict[str, Any] = {
    "causes": {SPRING: {"model_parameters": {STIFFNESS: SIZE}}},
    "unlisted": {},
    "rig": {},
}


def prediction_ratio_of(answer: Answer, *named: str) -> float:
    reference = true_errors(CASE, TRUTH)
    assert reference is not None
    return prediction_ratio(CASE, answer, named, reference)


def spring(value: float, **rig: float) -> Answer:
    numbers = {STIFFNESS: value, **rig}
    return Answer({SPRING: 1.0}, {name: Estimate(value, 0.1) for name, value in numbers.items()})


@pytest.mark.medium
def test_the_true_causes_and_sizes_predict_as_well_as_the_true_model() -> None:
    assert prediction_ratio_of(spring(SIZE), SPRING) == pytest.approx(1.0)


@pytest.mark.medium
def test_a_missing_cause_and_a_wrong_size_predict_worse() -> None:
    missing = prediction_ratio_of(Answer({"nothing": 1.0}))
    halved = prediction_ratio_of(spring(0.5 * SIZE), SPRING)
    assert 1.05 < halved < missing


@pytest.mark.medium
def test_the_rig_parameters_of_an_answer_are_used() -> None:
    gain = RIG["thrust_gain"].value
    assert prediction_ratio_of(spring(SIZE, thrust_gain=1.3 * gain), SPRING) > 1.2
    assert prediction_ratio_of(spring(SIZE, thrust_gain=-gain), SPRING) == WORST_RATIO


def predicted(angles_rad: Floats, t_s: Floats = FLIGHT.t_s) -> Answer:
    return Answer({SPRING: 1.0}, predicted_flights={"validation-1": AxisSeries(t_s, angles_rad)})


@pytest.mark.medium
def test_a_predicted_flight_is_scored_in_place_of_the_model() -> None:
    reference = true_errors(CASE, TRUTH)
    assert reference is not None
    # The errors of the true model on each axis, as a constant error.
    as_good = prediction_ratio_of(predicted(FLIGHT.angles_rad + reference), SPRING)
    assert as_good == pytest.approx(1.0)
    assert prediction_ratio_of(predicted(FLIGHT.angles_rad + 2.0 * reference), SPRING) == pytest.approx(2.0)
    assert prediction_ratio_of(predicted(FLIGHT.angles_rad), SPRING) < as_good


@pytest.mark.medium
def test_a_predicted_flight_that_ends_early_or_is_missing_counts_as_a_wrong_model() -> None:
    half = len(FLIGHT) // 2
    assert prediction_ratio_of(predicted(FLIGHT.angles_rad[:half], FLIGHT.t_s[:half]), SPRING) == WORST_RATIO
    other = Answer({}, predicted_flights={"validation-2": AxisSeries(FLIGHT.t_s, FLIGHT.angles_rad)})
    assert prediction_ratio_of(other, SPRING) == WORST_RATIO


@pytest.mark.medium
def test_the_true_model_of_a_quadratic_thrust_has_the_thrust_of_the_generator() -> None:
    size_per_V, share, pivot = 0.25, "thrust_quadratic_share", "thrust_quadratic_pivot_V"
    truth = TRUTH | {"causes": {"thrust_quadratic": {"model_parameters": {share: 0.2}}}}
    reference = true_errors(CASE, truth)
    assert reference is not None
    # k e (1 + 0.25 e), the thrust of the generator, about another voltage: at e = 2 V it is 1.5 k e.
    answer = Answer(
        {"thrust_quadratic": 1.0},
        {
            "thrust_gain": Estimate((1.0 + 2.0 * size_per_V) * RIG["thrust_gain"].value, 0.01),
            share: Estimate(2.0 * size_per_V / (1.0 + 2.0 * size_per_V), 0.01),
            pivot: Estimate(2.0, 0.01),
        },
    )
    causes = Causes(CAUSES.base_rates, {"thrust_quadratic": {share: "1", pivot: "V"}})
    case = BenchmarkCase("case", RIG, (FLIGHT,), (FLIGHT,), causes)
    assert prediction_ratio(case, answer, ["thrust_quadratic"], reference) == pytest.approx(1.0)


def test_a_case_without_a_true_model_in_the_catalogue_has_no_reference() -> None:
    assert true_errors(CASE, TRUTH | {"unlisted": {"draught": 20.0}}) is None
    periodic: dict[str, Any] = {"periodic_torque.pitch": {"model_parameters": {}}}
    assert true_errors(CASE, TRUTH | {"causes": periodic}) is None
