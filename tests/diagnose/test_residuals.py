"""A remainder is unexplained only if it is no error of a parameter, and if it changes a prediction."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from heli_host.data.flight import Flight
from heli_lab.diagnose import Diagnosis, diagnose, summary, to_json
from heli_lab.explain import verdict
from heli_lab.explain.candidates import quantity_values
from heli_lab.explain.comparison import Hypothesis, ModelComparison
from heli_lab.explain.residuals import (
    Dependence,
    adjusted_p_values,
    dependences,
    kicks,
    open_loop_squares,
    with_impulse,
)
from heli_lab.explain.screening import Screening
from heli_lab.explain.stepwise import held_out_screening
from heli_lab.explain.thresholds import MATTERS_COUNTS
from heli_lab.explain.verdict import has_random_torque
from heli_lab.fit.grey_box import DisturbanceModel
from heli_lab.fit.innovations import FlightErrors, InnovationsModel
from heli_lab.fit.records import prepare
from heli_lab.report.diagnosis.text import lines
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import catalogue, parse_effects
from heli_sim.rig import load_rig

from tests.diagnose.hidden import WHOLE_S, flights, hovering
from tests.diagnose.test_causes import diagnosed
from tests.estimation.pendulum import RIG, flight_with_disturbances
from tests.identify.made import flown_by_plan
from tests.running.long import LONG

pytestmark = pytest.mark.diagnosis


def refitted_baseline(fit: Flight, held_out: Flight) -> tuple[ModelComparison, Hypothesis]:
    rig = load_rig("makki2024")
    records = [prepare(fit, rig, "fit")], [prepare(held_out, rig, "held out")]
    comparison = ModelComparison(MultibodyModel(), rig, *records)
    return comparison, comparison.refit(())


def significant(fit: Flight, held_out: Flight, *, uncertain: bool) -> list[Dependence]:
    """Test the baseline's residuals on the held-out flight, with or without the parameters' uncertainty."""
    comparison, baseline = refitted_baseline(fit, held_out)
    if uncertain:
        screening = held_out_screening(comparison, baseline)
    else:
        screening = Screening(comparison.held_out_estimate(baseline))
    return [dependence for dependence in dependences([screening]) if dependence.is_significant]


def test_parameters_that_a_hover_does_not_show_are_no_missing_effect_in_another_flight() -> None:
    hover, (_, held_out) = hovering(20.0), flights()
    # As if the hover had shown them exactly, their error is structure.
    assert significant(hover, held_out, uncertain=False)
    assert not significant(hover, held_out, uncertain=True)


@pytest.mark.slow
def test_gusts_about_pitch_are_no_friction_near_rest() -> None:
    """A count that repeats looks like a torque towards rest: 47 nats about pitch, and 48 about travel."""
    model, rig = MultibodyModel(parse_effects(("random_torque.pitch",))), load_rig("makki2024")
    comparison, baseline = refitted_baseline(*(flown_by_plan(rig, seed, model=model) for seed in (51, 52)))
    tested = dependences([Screening(baseline.estimate), held_out_screening(comparison, baseline)])
    assert {d.what for d in tested if d.log_likelihood_gain > 40.0} == {
        "torque.pitch on pitch_rate near rest",
        "torque.travel on travel_rate near rest",
    }
    assert not any(dependence.is_significant for dependence in tested)


def test_unlisted_effect_remains_significant_on_another_flight() -> None:
    strongest, *_ = significant(*flights(unlisted=True), uncertain=True)
    assert strongest.what == "torque.pitch on elevation"
    assert strongest.change_counts > 10.0 * MATTERS_COUNTS


def test_linear_change_of_the_prediction_is_that_of_simulations() -> None:
    diagnosis = diagnosed(unlisted=True)
    (linear,) = Screening(diagnosis.search.baseline.estimate).filtered.linearised_flights
    hidden_Nm = 0.05 * quantity_values(linear.model.source, linear.trajectory)["elevation"]
    rates = linear.steps.by_disturbance[:, :, 1] * hidden_Nm[:, None]
    constant_rates = linear.steps.by_disturbance[:, :, 1]
    squares, rows = open_loop_squares(linear, np.stack((rates, constant_rates), axis=2))
    # Without the hidden torque, simulations of the baseline have this error in addition to the rounding.
    error_counts = np.sqrt((diagnosis.assessment.before.train.axes[1] ** 2 - 1.0) / 12.0)
    assert np.sqrt(squares[1, 0] / rows) == pytest.approx(error_counts, rel=0.15)
    # A constant torque is estimated for each flight, so that it changes no prediction.
    assert squares[:, 1] == pytest.approx(0.0, abs=1e-6)


def judged(change_counts: float, total: float = 1.4) -> Diagnosis:
    """Judge a right cause again whose model leaves a significant dependence of this size."""
    diagnosis = diagnosed("rotor_lag=0.06")
    assessment = diagnosis.assessment
    dependence = Dependence(
        "torque.pitch on travel_rate", log_likelihood_gain=24.0, penalty=22.0, change_counts=change_counts
    )
    residual = replace(assessment.residual_analysis, dependences=(dependence,))
    after = replace(assessment.after, held_out=replace(assessment.after.held_out, total=total))
    new_verdict = verdict.judge(diagnosis.search, residual, after, diagnosis.kinds, absent=False)
    return replace(
        diagnosis,
        assessment=replace(assessment, residual_analysis=residual, after=after, verdict=new_verdict),
    )


def test_remainder_that_changes_no_prediction_is_listed_and_the_cause_stands() -> None:
    diagnosis = judged(0.9 * MATTERS_COUNTS)
    assert diagnosis.label == "cause_found"
    assert summary(diagnosis).startswith("The rotors' thrust lags")
    numbers = to_json(diagnosis)
    (remaining,) = numbers["small_remainder"]
    assert (remaining["dependence"], remaining["change_counts"]) == (
        "torque.pitch on travel_rate",
        0.9 * MATTERS_COUNTS,
    )
    assert numbers["unexplained"] is None
    assert (
        "too small to matter: a torque about pitch that depends on travel rate, which no effect of the "
        "catalogue explains; it changes the 2 s open-loop prediction by 0.09 encoder counts rms, less than "
        "0.1"
    ) in lines(diagnosis)


def test_estimate_that_did_not_converge_is_stated() -> None:
    diagnosis = diagnosed("rotor_lag=0.06")
    assert to_json(diagnosis)["converged"] is True
    final = diagnosis.search.final
    rough = replace(final, estimate=replace(final.estimate, converged=False))
    numbers = to_json(replace(diagnosis, search=replace(diagnosis.search, final=rough)))
    assert numbers["converged"] is False
    assert any(
        "the estimate of the final model did not converge" in caution for caution in numbers["cautions"]
    )
    after = diagnosis.assessment.after
    unfinished = replace(after, fit=replace(after.fit, converged=False))
    assessment = replace(diagnosis.assessment, after=unfinished)
    numbers = to_json(replace(diagnosis, assessment=assessment))
    assert numbers["converged"] is False
    assert any("the free runs of the extended model did not converge" in c for c in numbers["cautions"])


def test_remainder_that_changes_the_prediction_stays_unexplained() -> None:
    diagnosis = judged(1.1 * MATTERS_COUNTS)
    assert diagnosis.label == "unexplained"
    assert diagnosis.verdict.negligible_dependences == ()
    # In large disturbances, every significant effect matters, and so does what remains.
    after = diagnosis.assessment.after
    disturbed = replace(after, train=replace(after.train, total=6.0))
    small = judged(0.9 * MATTERS_COUNTS).assessment.residual_analysis
    args = diagnosis.search, small, disturbed, diagnosis.kinds
    assert verdict.judge(*args, absent=False).label == "unexplained"


def test_adjusted_p_values_are_those_of_benjamini_and_hochberg() -> None:
    # Computed with scipy.stats.false_discovery_control (SciPy 1.16), whose import takes half a second.
    p_values = np.array([0.04, 0.001, 0.04, 0.9, 0.012, 0.3])
    np.testing.assert_allclose(adjusted_p_values(p_values), [0.06, 0.006, 0.06, 0.9, 0.036, 0.36], rtol=1e-12)
    assert len(adjusted_p_values(np.zeros(0))) == 0


KICKS_Nms = {5.0: 30e-3, 11.0: -40e-3, 17.5: 25e-3, 24.0: -25e-3}


@pytest.fixture(scope="module")
def model() -> tuple[InnovationsModel, DisturbanceModel]:
    """A flight in gusts about all axes, with its estimate."""
    estimate = ModelComparison(MultibodyModel(), RIG, [flight_with_disturbances()], []).refit([]).estimate
    return estimate.filtered(), estimate.disturbances


@pytest.mark.slow
def test_gusts_of_constant_strength_contain_no_kicks(
    model: tuple[InnovationsModel, DisturbanceModel],
) -> None:
    assert kicks(*model) == {}


@pytest.mark.slow
def test_kicks_about_one_axis_are_counted_with_their_size(
    model: tuple[InnovationsModel, DisturbanceModel],
) -> None:
    filtered, disturbances = model
    (linearised,) = filtered.linearised_flights
    t_s = np.concatenate([linearised.nodes.t_s[blocks.rows] for blocks in linearised.blocks])
    error: FlightErrors = filtered.perturbed_residual()
    for at_s, size_Nms in KICKS_Nms.items():
        interval = int(np.argmin(np.abs(t_s - at_s)))
        # The torque of the model that is missing in the flight has the opposite sign of a kick.
        torque_Nm = -size_Nms / linearised.reference.step_s
        error = with_impulse(filtered, error, flight=0, interval=interval, axis=2, torque_Nm=torque_Nm)
    kicks_by_axis = kicks(filtered, disturbances, error)
    assert kicks_by_axis.keys() == {"travel"}
    assert kicks_by_axis["travel"].count == len(KICKS_Nms)
    assert kicks_by_axis["travel"].largest_Nms == pytest.approx(40e-3, rel=0.3)


_RANDOM_TORQUE = "random_torque.travel=0.03"
_DISTURBANCES = ("random_torque.elevation=0.012", "random_torque.pitch=0.004", "random_torque.travel=0.008")


@cache
def diagnosed_under_disturbances(*effects: str) -> Diagnosis:
    """Diagnose long flights with disturbances and other effects."""
    # In flights of half the length, more candidates must be tried to distinguish disturbances from a cause.
    fit, held_out = flights(*effects, seconds=WHOLE_S)
    return diagnose(MultibodyModel(), load_rig("makki2024"), [fit], [held_out], labels=["fit", "held out"])


def assert_disturbances_are_estimated(numbers: dict[str, Any]) -> None:
    """Assert that the JSON of a diagnosis has the sizes of `_DISTURBANCES`."""
    for axis, size in (("elevation", 0.012), ("pitch", 0.004), ("travel", 0.008)):
        assert numbers["disturbances"][axis]["fast_std_Nm"] == pytest.approx(size, rel=0.4)
        assert numbers["disturbances"][axis]["log_likelihood_ratio"] > 100.0


def test_disturbances_alone_are_explained_and_their_size_is_estimated() -> None:
    numbers = to_json(diagnosed_under_disturbances(*_DISTURBANCES))
    assert numbers["verdict"] == "explained"
    assert numbers["causes"] == []
    assert_disturbances_are_estimated(numbers)
    assert "mN m about elevation" in summary(diagnosed_under_disturbances(*_DISTURBANCES))


@pytest.mark.skipif(not LONG, reason="heli_benchmark/tests finds a lag, too; this one runs in make long")
def test_lag_under_disturbances_is_named_with_its_size_and_nothing_else() -> None:
    numbers = to_json(diagnosed_under_disturbances(*_DISTURBANCES, "rotor_lag=0.06"))
    assert numbers["verdict"] == "cause_found"
    (cause,) = numbers["causes"]
    assert cause["effect"] == "rotor_lag"
    lag = cause["parameters"]["rotor_lag_s"]
    assert abs(lag["value"] - 0.06) < 3.0 * lag["std"]
    assert cause["confidence"] > 0.9
    assert_disturbances_are_estimated(numbers)


def test_disturbance_about_a_single_axis_is_a_random_torque_of_its_size() -> None:
    numbers = to_json(diagnosed_under_disturbances(_RANDOM_TORQUE))
    assert numbers["verdict"] == "cause_found"
    (cause,) = numbers["causes"]
    assert cause["effect"] == "random_torque.travel"
    sigma = cause["parameters"]["random_torque_travel_Nm"]
    assert abs(sigma["value"] - 0.03) < 3.0 * sigma["std"]
    assert numbers["residual"]["innovations"]["predicted_by"] == []


def test_disturbance_without_correlation_in_time_is_no_random_torque() -> None:
    remaining = diagnosed_under_disturbances(_RANDOM_TORQUE).assessment.residual_analysis
    assert has_random_torque(remaining, catalogue())
    # Dry friction that holds for moments leaves torques like these.
    short = replace(remaining.disturbances, correlation_time_s=np.full(3, 0.03))
    assert not has_random_torque(replace(remaining, disturbances=short), catalogue())
