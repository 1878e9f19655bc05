"""Parameters and disturbances of a flight whose truth is known."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from heli_lab.diagnose.search import (
    Candidate,
    Hypothesis,
    ModelComparison,
    Screening,
    score_of,
    typical_candidate,
)
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import catalogue

from tests.estimation.made import RIG, TRUE_RIG, GUST_Nm, flown_with, windy

pytestmark = pytest.mark.diagnosis

KINDS = catalogue()


@cache
def comparison() -> ModelComparison:
    """The flight alone."""
    return ModelComparison(MultibodyModel(), RIG, [windy()], [])


@cache
def baseline() -> Hypothesis:
    """The right model."""
    return comparison().refit([])


def test_estimates_are_true_within_their_standard_errors() -> None:
    found = baseline()
    std = dict(
        zip(found.estimate.parameter_vector.names, np.sqrt(np.diag(found.estimate.covariance)), strict=True)
    )
    for name in ("thrust_gain", "dead_zone", "friction_elevation", "friction_pitch", "friction_travel"):
        assert abs(found.values[name] - TRUE_RIG[name].value) < 3.5 * std[name], name


def test_estimated_disturbances_have_their_true_sizes_and_times() -> None:
    disturbances = baseline().estimate.disturbances
    assert disturbances.fast_std == pytest.approx(list(GUST_Nm.values()), rel=0.35)
    # Half a minute shows a correlation time of half a second to about a factor of two.
    assert np.all((disturbances.correlation_time_s > 0.2) & (disturbances.correlation_time_s < 1.2))


def test_innovations_of_the_right_model_are_white() -> None:
    estimate = baseline().estimate
    (innovations,) = estimate.filtered().innovations(estimate.disturbances).flights
    value = innovations[:, 0].reshape(-1, 3)
    assert value.std(axis=0) == pytest.approx([1.0, 1.0, 1.0], abs=0.05)
    for lag in (1, 2, 5, 12):
        correlation = (value[lag:] * value[:-lag]).mean(axis=0)
        assert np.all(np.abs(correlation) < 4.0 / np.sqrt(len(value)) + 0.03), lag


def test_no_effect_has_a_high_score_about_the_right_model() -> None:
    screening = Screening(baseline().estimate)
    kinds = [kind for kind in KINDS.values() if kind.suits(MultibodyModel()) and not kind.noise_inputs]
    best = screening.effects([kind for kind in kinds if not kind.baseline])[0]
    assert best.log_likelihood_gain < 14.0, best.candidate.id
    assert screening.splines()[0].log_likelihood_gain < 20.0


def test_encoder_scale_has_no_high_score_about_the_right_model() -> None:
    # About a smoothed course, which knows what is to come, every flight wants its encoders stretched.
    linear = baseline().estimate.filtered().linearised_flights[0]
    angles = np.zeros((linear.rows, 3, 3))
    angles[:, range(3), range(3)] = linear.nodes.state[:, :3]
    statistics = Screening(baseline().estimate).information(
        [(np.zeros((linear.rows, 6, 3)), angles)], [1, 1, 1]
    )
    scores = [score_of(information, score, np.ones(1)) for information, score in statistics]
    # A cause has to gain 14 nats.
    assert max(gain for gain, _, _ in scores) < 14.0


def test_estimated_disturbances_are_more_likely_than_their_neighbours() -> None:
    estimate = baseline().estimate

    def value(gust: float, memory: float) -> float:
        from dataclasses import replace

        at = replace(
            estimate.disturbances,
            fast_std=estimate.disturbances.fast_std * gust,
            correlation_time_s=estimate.disturbances.correlation_time_s * memory,
        )
        return float(estimate.filtered().innovations(at).log_likelihoods.sum())

    best = value(1.0, 1.0)
    assert best > max(value(1.2, 1.0), value(0.8, 1.0), value(1.0, 1.3), value(1.0, 0.7))


@pytest.mark.parametrize("id_", ["coulomb_friction.elevation", "thrust_asymmetry", "rotor_lag"])
def test_larger_model_is_never_less_likely_than_its_submodel(id_: str) -> None:
    kind = KINDS[id_]
    more = comparison().refit([typical_candidate(kind)], None, baseline())
    # The prior of the size remains: at zero it is up to 1.4 standard deviations away.
    assert more.log_likelihood > baseline().log_likelihood - 1.2


@pytest.mark.parametrize(
    ("id_", "parameter", "size"),
    [
        # By rates that the encoder's errors make of rest the friction is 0.042.
        ("coulomb_friction.travel", "coulomb_friction_travel_Nm", 0.06),
        # By a play operator along the measured angles it is nothing at all.
        ("backlash.pitch", "backlash_pitch_rad", 0.006),
    ],
)
def test_friction_and_play_are_estimated_with_their_sizes(id_: str, parameter: str, size: float) -> None:
    among = ModelComparison(MultibodyModel(), RIG, [flown_with(f"{id_}={size}")], [])
    nothing, kind = among.refit([]), KINDS[id_]
    best = Screening(nothing.estimate).effects([one for one in KINDS.values() if one.acts_on == kind.acts_on])
    assert best[0].candidate.id == id_
    candidate = Candidate(id_, kind.make({**kind.typical, **kind.neutral}), kind.size)
    found = among.refit([candidate], None, nothing)
    place = found.estimate.parameter_vector.names.index(parameter)
    assert np.sqrt(found.estimate.covariance[place, place]) < 0.1 * size
    assert found.values[parameter] == pytest.approx(size, rel=0.1)


def test_a_play_of_three_degrees_does_not_pass_for_disturbances() -> None:
    size_rad = math.radians(3.0)
    comparison = ModelComparison(
        MultibodyModel(), RIG, [flown_with(f"backlash.elevation={size_rad:.6f}")], []
    )
    kind = KINDS["backlash.elevation"]
    candidate = Candidate(kind.id, kind.make({**kind.typical, **kind.neutral}), kind.size)
    estimate = comparison.refit([candidate], None, comparison.refit([])).estimate
    place = estimate.parameter_vector.names.index("backlash_elevation_rad")
    std_rad = math.sqrt(estimate.covariance[place, place])
    assert std_rad < 0.02 * size_rad
    assert abs(estimate.theta[place] - size_rad) < 3.0 * std_rad
    # It is 0.004 N m in the flight. With exact measurements within the play the estimate is 0.069 N m.
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
    # A reaction torque of both rotors is almost equivalent, and has one parameter more.
    assert zero.log_likelihood > torque.log_likelihood - 1.0
