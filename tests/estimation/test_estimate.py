"""Estimates of parameters and disturbances, from simulated flights whose true values are known."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from heli_lab.explain.candidates import Candidate, typical_candidate
from heli_lab.explain.comparison import Hypothesis, ModelComparison
from heli_lab.explain.screening import Screening, score_of
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import catalogue

from tests.estimation.made import RIG, TRUE_RIG, GUST_Nm, flight_with_disturbances, flown_with

pytestmark = pytest.mark.diagnosis

KINDS = catalogue()


@cache
def comparison() -> ModelComparison:
    """Comparison on the simulated flight with disturbances."""
    return ModelComparison(MultibodyModel(), RIG, [flight_with_disturbances()], [])


@cache
def baseline() -> Hypothesis:
    """The model with which the flight was simulated, estimated."""
    return comparison().refit([])


def test_estimates_are_true_within_their_standard_errors() -> None:
    hypothesis = baseline()
    estimate = hypothesis.estimate
    std = dict(zip(estimate.parameter_vector.names, np.sqrt(np.diag(estimate.covariance)), strict=True))
    for name in ("thrust_gain", "dead_zone", "friction_elevation", "friction_pitch", "friction_travel"):
        assert abs(hypothesis.values[name] - TRUE_RIG[name].value) < 3.5 * std[name], name


def test_estimated_disturbances_have_their_true_sizes_and_times() -> None:
    disturbances = baseline().estimate.disturbances
    assert disturbances.fast_std == pytest.approx(list(GUST_Nm.values()), rel=0.35)
    # Half a minute shows a correlation time of half a second to about a factor of two.
    assert np.all((disturbances.correlation_time_s > 0.2) & (disturbances.correlation_time_s < 1.2))


def test_innovations_of_the_right_model_are_white() -> None:
    estimate = baseline().estimate
    (innovations,) = estimate.filtered().innovations(estimate.disturbances).flights
    innovation = innovations[:, 0].reshape(-1, 3)  # by measured axis
    assert innovation.std(axis=0) == pytest.approx([1.0, 1.0, 1.0], abs=0.05)
    for lag in (1, 2, 5, 12):
        correlation = (innovation[lag:] * innovation[:-lag]).mean(axis=0)
        # Four standard errors by chance, and 0.03 for the approximations of the filter.
        assert np.all(np.abs(correlation) < 4.0 / np.sqrt(len(innovation)) + 0.03), lag


def test_no_effect_has_a_high_score_about_the_right_model() -> None:
    screening = Screening(baseline().estimate)
    kinds = [kind for kind in KINDS.values() if kind.suits(MultibodyModel()) and not kind.noise_inputs]
    best = screening.effects([kind for kind in kinds if not kind.baseline])[0]
    assert best.log_likelihood_gain < 14.0, best.candidate.id
    assert screening.splines()[0].log_likelihood_gain < 20.0


def test_encoder_scale_has_no_high_score_about_the_right_model() -> None:
    # Along a smoothed trajectory, which depends on later measurements, this score is high in every flight.
    linear = baseline().estimate.filtered().linearised_flights[0]
    angles = np.zeros((linear.rows, 3, 3))
    angles[:, range(3), range(3)] = linear.nodes.state[:, :3]
    statistics = Screening(baseline().estimate).information(
        [(np.zeros((linear.rows, 6, 3)), angles)], [1, 1, 1]
    )
    scores = [score_of(information, score, np.ones(1)) for information, score in statistics]
    # A cause must gain at least 14 nats.
    assert max(gain for gain, _, _ in scores) < 14.0


def test_estimated_disturbances_are_more_likely_than_their_neighbours() -> None:
    estimate = baseline().estimate

    def log_likelihood(std_factor: float, time_factor: float) -> float:
        """Return the log-likelihood with scaled sizes and correlation times of the fast disturbances."""
        scaled = replace(
            estimate.disturbances,
            fast_std=estimate.disturbances.fast_std * std_factor,
            correlation_time_s=estimate.disturbances.correlation_time_s * time_factor,
        )
        return float(estimate.filtered().innovations(scaled).log_likelihoods.sum())

    neighbours = ((1.2, 1.0), (0.8, 1.0), (1.0, 1.3), (1.0, 0.7))
    assert log_likelihood(1.0, 1.0) > max(log_likelihood(*factors) for factors in neighbours)


@pytest.mark.parametrize("id_", ["coulomb_friction.elevation", "thrust_asymmetry", "rotor_lag"])
def test_larger_model_is_never_less_likely_than_its_submodel(id_: str) -> None:
    kind = KINDS[id_]
    larger = comparison().refit([typical_candidate(kind)], None, baseline())
    # The prior of the size costs up to 1.2 nats: a size of 0 is up to 1.4 standard deviations from its mean.
    assert larger.log_likelihood > baseline().log_likelihood - 1.2


@pytest.mark.parametrize(
    ("id_", "parameter", "size"),
    [
        # If errors of the encoder are taken for motion of a resting axis, the estimate is 0.042.
        ("coulomb_friction.travel", "coulomb_friction_travel_Nm", 0.06),
        # If the play is computed from measured angles, which contain it already, the estimate is 0.
        ("backlash.pitch", "backlash_pitch_rad", 0.006),
    ],
)
def test_friction_and_play_are_estimated_with_their_sizes(id_: str, parameter: str, size: float) -> None:
    comparison = ModelComparison(MultibodyModel(), RIG, [flown_with(f"{id_}={size}")], [])
    baseline, kind = comparison.refit([]), KINDS[id_]
    rivals = [other for other in KINDS.values() if other.acts_on == kind.acts_on]
    assert Screening(baseline.estimate).effects(rivals)[0].candidate.id == id_
    candidate = Candidate(id_, kind.make({**kind.typical, **kind.neutral}), kind.size)
    refit = comparison.refit([candidate], None, baseline)
    index = refit.estimate.parameter_vector.names.index(parameter)
    assert np.sqrt(refit.estimate.covariance[index, index]) < 0.1 * size
    assert refit.values[parameter] == pytest.approx(size, rel=0.1)


def test_a_play_of_three_degrees_does_not_pass_for_disturbances() -> None:
    size_rad = math.radians(3.0)
    comparison = ModelComparison(
        MultibodyModel(), RIG, [flown_with(f"backlash.elevation={size_rad:.6f}")], []
    )
    kind = KINDS["backlash.elevation"]
    candidate = Candidate(kind.id, kind.make({**kind.typical, **kind.neutral}), kind.size)
    estimate = comparison.refit([candidate], None, comparison.refit([])).estimate
    index = estimate.parameter_vector.names.index("backlash_elevation_rad")
    std_rad = math.sqrt(estimate.covariance[index, index])
    assert std_rad < 0.02 * size_rad
    assert abs(estimate.theta[index] - size_rad) < 3.0 * std_rad
    # The true disturbance is 0.004 N m. If measurements within the play counted as exact, the estimate would
    # be 0.069 N m.
    assert estimate.disturbances.fast_std[0] < 2.0 * GUST_Nm["elevation"]


def test_zero_error_of_an_encoder_is_as_likely_as_a_reaction_torque() -> None:
    # The reference trajectory has the angles that the encoder shows, 5.7 degrees off.
    comparison = ModelComparison(MultibodyModel(), RIG, [flown_with("zero_offset.pitch=0.1")], [])
    baseline = comparison.refit([])
    zero, torque = (
        comparison.refit([typical_candidate(KINDS[id_])], None, baseline)
        for id_ in ("zero_offset.pitch", "rotor_reaction_torque")
    )
    name = "zero_offset_pitch_rad"
    assert abs(zero.values[name] - 0.1) < 3.0 * zero.std[name]
    # A reaction torque of both rotors is almost equivalent, and has an additional parameter.
    assert zero.log_likelihood > torque.log_likelihood - 1.0
