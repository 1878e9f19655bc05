"""Estimates of parameters and disturbances, from simulated flights whose true values are known."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from heli_host.data.arrays import Floats
from heli_lab.explain.candidates import Candidate, CandidateSignals, typical_candidate
from heli_lab.explain.comparison import Hypothesis, ModelComparison
from heli_lab.explain.screening import Screening, score_of
from heli_lab.fit.estimator import estimate, maximise
from heli_lab.fit.grey_box import DisturbanceModel, GainDisturbance
from heli_lab.fit.innovations import InnovationsModel, auxiliary_residuals, refiltered
from heli_lab.fit.model_functions import ModelFunctions
from heli_lab.fit.parameters import FreeParameter, NormalPrior, ParameterVector
from heli_lab.fit.reference_trajectory import KinematicModel, kinematic_filter
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import catalogue

from tests.estimation.pendulum import (
    MODEL,
    PARAMETERS,
    RIG,
    TRUE,
    TRUE_RIG,
    GUST_Nm,
    flight_with_disturbances,
    flown_with,
    run,
)

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
        assert abs(hypothesis.params[name] - TRUE_RIG[name].value) < 3.5 * std[name], name


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
        [CandidateSignals(np.zeros((linear.rows, 6, 3)), angles)], [1, 1, 1]
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
    assert refit.params[parameter] == pytest.approx(size, rel=0.1)


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
    assert abs(zero.params[name] - 0.1) < 3.0 * zero.std[name]
    # A reaction torque of both rotors is almost equivalent, and has an additional parameter.
    assert zero.log_likelihood > torque.log_likelihood - 1.0


KINEMATICS = KinematicModel(20.0, correlation_time_s=0.1, rate_std=2.0, position_std=0.1)


@pytest.mark.slow
def test_a_cart_with_a_pendulum_is_identified_within_its_standard_errors() -> None:
    runs = [run(1), run(2)]
    guess = {name: 1.3 * value for name, value in TRUE.items()}
    shared = [FreeParameter(name, "", NormalPrior(value, value, 1e-4), name) for name, value in guess.items()]
    per_run = [FreeParameter(name, "", NormalPrior(0.0, 0.1), name) for name in ("force_N", "torque_Nm")]
    vector = ParameterVector(
        PARAMETERS,
        np.array([*guess.values(), 0.0, 0.0]),
        shared,
        per_run,
        [recording.label for recording in runs],
    )
    assert vector.names[4:] == ("force_N[run 1]", "torque_Nm[run 1]", "force_N[run 2]", "torque_Nm[run 2]")
    functions = ModelFunctions(MODEL, vector.quantities)
    references = [kinematic_filter(recording, KINEMATICS) for recording in runs]
    first = estimate(vector, references, functions, vector.start)
    references = refiltered(first.filtered(), first.disturbances)
    second = estimate(vector, references, functions, first.theta, first.disturbances)
    truth = np.array([*TRUE.values()])
    std = np.sqrt(np.diag(second.covariance))[: len(TRUE)]
    standardised_errors = (second.theta[: len(TRUE)] - truth) / std
    assert second.converged
    assert np.abs(standardised_errors).max() < 3.0
    assert (std / truth).max() < 0.1
    # The disturbances that were added: 0.08 N and 4 mN m, correlated over 0.25 s.
    assert second.disturbances.fast_std == pytest.approx([0.08, 0.004], rel=0.3)


def test_impossible_parameters_have_minus_infinite_likelihood() -> None:
    shared = [FreeParameter(name, "", NormalPrior(value, value, 1e-4), name) for name, value in TRUE.items()]
    recording = run(1)
    start = np.array([*TRUE.values(), 0.0, 0.0])
    vector = ParameterVector(PARAMETERS, start, shared, [], [recording.label])
    functions = ModelFunctions(MODEL, vector.quantities)
    reference = kinematic_filter(recording, KINEMATICS)
    impossible = np.where(np.array(vector.names) == "length_m", np.nan, vector.start)
    worst = estimate(vector, [reference], functions, impossible)
    assert worst.log_likelihood == -np.inf
    assert not worst.converged


START = DisturbanceModel.start((0.01, 0.02), (0.001, 0.002)).with_gains(1)
MAXIMUM = DisturbanceModel(
    np.array([0.02, 0.01]),
    np.array([0.2, 1.0]),
    np.array([0.003, 0.001]),
    np.array([1.0, 0.3]),
    (GainDisturbance(0.05, 2.0),),
)


def likelihoods(models: Sequence[DisturbanceModel]) -> Floats:
    """Return quadratic log-likelihoods of two outputs, shape (models, 2)."""
    # The likelihood of an output is largest at the `MAXIMUM` of its own four parameters. The two parameters
    # of the gain change both likelihoods by opposite amounts; only the sum is largest at the `MAXIMUM`.
    values = []
    for model in models:
        distances = model.logarithms - MAXIMUM.logarithms
        output_distances, gain_distances = distances[:8].reshape(2, 4), distances[8:]
        of_outputs = -20.0 * (output_distances**2).sum(axis=1)
        of_gain = np.array([-30.0, 10.0]) * (gain_distances**2).sum()
        opposite = gain_distances[0] * np.array([3.0, -3.0])
        values.append(of_outputs + of_gain + opposite)
    return np.array(values)


def test_the_maximum_of_outputs_and_gains_is_found() -> None:
    estimate = maximise(likelihoods, START, (1e-5, 1.0))
    assert estimate.logarithms == pytest.approx(MAXIMUM.logarithms, abs=0.03)


def test_estimated_disturbances_stay_within_their_bounds() -> None:
    estimate = maximise(likelihoods, START, (1e-5, 0.015))
    assert estimate.fast_std == pytest.approx([0.015, 0.01], rel=0.03)


def test_disturbances_stay_if_no_likelihood_is_finite() -> None:
    estimate = maximise(lambda models: np.full((len(models), 2), np.nan), START, (1e-5, 1.0))
    assert estimate.logarithms == pytest.approx(START.logarithms)
    assert estimate.curvature is None


def test_logarithms_contain_all_parameters_of_the_disturbances() -> None:
    restored = START.with_logarithms(MAXIMUM.logarithms)
    assert restored.gains[0].std == pytest.approx(0.05, rel=1e-12)
    assert restored.variance == pytest.approx(MAXIMUM.variance, rel=1e-12)
    assert restored.autocorrelation(0.01) == pytest.approx(MAXIMUM.autocorrelation(0.01), rel=1e-12)


DISTURBANCES = DisturbanceModel.start((0.012, 0.004, 0.008), (2e-3, 1e-3, 1e-3))


@pytest.fixture(scope="module")
def filtered() -> InnovationsModel:
    """A flight in disturbances, filtered at the nominal parameters."""
    from heli_lab.fit.estimator import _linearised
    from heli_lab.fit.flight_model import RigParameters, filter_record, model_functions

    model = MultibodyModel()
    parameters = RigParameters(model, RIG, [flight_with_disturbances()])
    functions = model_functions(model, parameters.quantities)
    return _linearised(parameters, [filter_record(flight_with_disturbances())], functions, parameters.start)


@pytest.mark.parametrize("output", range(3))
def test_score_of_a_shock_is_that_of_its_regressor_at_every_instant(
    filtered: InnovationsModel, output: int
) -> None:
    (residuals,) = auxiliary_residuals(filtered, DISTURBANCES)
    (linearised,) = filtered.linearised_flights
    rows = np.concatenate([blocks.rows for blocks in linearised.blocks])
    innovations = filtered.innovations(DISTURBANCES).flights[0][:, 0]
    tested = np.arange(3, len(rows), 97)  # every 97th instant: all of them would take minutes
    steps = np.arange(linearised.rows)[:, None]
    # A level is a torque that acts from an instant on; an impulse acts in a single step. Shape (n, tested).
    torques_of_level, torques_of_impulse = steps >= rows[tested], steps == rows[tested]
    for shock, torques in ((residuals.level, torques_of_level), (residuals.impulse, torques_of_impulse)):
        (regressors,) = filtered.disturbance_regressors(DISTURBANCES, output, [torques.astype(float)])
        score, information = regressors.T @ innovations, np.square(regressors).sum(axis=0)
        assert np.allclose(shock.information[tested, output], information, rtol=1e-7)
        assert np.allclose(shock.score[tested, output], score, rtol=1e-6, atol=1e-7 * np.abs(score).max())
        assert np.allclose(shock.t_statistic[tested, output], score / np.sqrt(information), atol=1e-6)
