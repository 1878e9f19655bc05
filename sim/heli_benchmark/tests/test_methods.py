"""Methods of the published benchmark: the shared terms, and the selection among them."""

import casadi as ca
import numpy as np
import pytest
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_lab.diagnose import to_json
from heli_sim.model import MultibodyModel
from heli_sim.model.effect import AXES
from heli_sim.model.effects import catalogue
from heli_sim.model.linear import trim
from heli_sim.rig import load_rig
from heli_sim.rig.schema import inertias_kg_m2

from heli_benchmark.methods import base_rates, ours, stepwise
from heli_benchmark.methods.boosting import TermEvidence
from heli_benchmark.methods.stepwise import selected
from heli_benchmark.methods.terms import ResidualRegression, Standardisation, Term, torques_of_accelerations
from heli_benchmark.task import NOTHING, UNLISTED, BenchmarkCase, Causes, Estimate, check_answer
from heli_benchmark.tests.tuning import TUNED
from tests.diagnose.hidden import flights
from tests.diagnose.test_causes import diagnosed

SPRING = "cable_spring.travel"
STIFFNESS = "cable_spring_travel_Nm_per_rad"
RATES = {NOTHING: 0.5, UNLISTED: 0.1, SPRING: 0.2, "travel_drag_quadratic": 0.2, "rotor_lag": 0.2}
CAUSES = Causes(
    RATES,
    {
        SPRING: {STIFFNESS: "N m/rad"},
        "travel_drag_quadratic": {"travel_drag_quadratic_Nms2": "N m s2/rad2"},
        "rotor_lag": {"rotor_lag_s": "s"},
    },
)
RIG = load_rig("makki2024")
SCALES = Standardisation(np.ones(3), feature_mean=np.zeros(8), feature_std=np.ones(8))
NO_EXTRA = "skipped: the extra `benchmark` is not installed"


def flown(stiffness: float) -> Flight:
    """Twelve seconds of the model with a cable spring, from a hover, with small random torques."""
    model = MultibodyModel((catalogue()[SPRING].make({STIFFNESS: stiffness}),))
    x, u, p = ca.SX.sym("x", 6), ca.SX.sym("u", 2), ca.SX.sym("p", len(model.parameters))
    rates = ca.Function("rates", [x, u, p], [model.dynamics(x, u, p)])
    values, hover_V = model.parameter_values(RIG), trim(MultibodyModel(), RIG).volts_V
    rng = np.random.default_rng(4)
    t_s: Floats = 0.01 * np.arange(1200.0)
    phases = rng.uniform(-np.pi, np.pi, (2, 12))
    lines_Hz = 0.15 + 0.25 * np.arange(12)
    excited_V = 0.05 * np.sin(2.0 * np.pi * lines_Hz[:, None, None] * t_s + phases.T[:, :, None]).sum(axis=0)
    state, rows = np.array([0.0, 0.0, 0.3, 0.0, 0.0, 0.2]), []
    for k in range(len(t_s)):
        # Pitch and elevation are held near level by proportional and derivative gains.
        elevation, pitch, travel, elevation_rate, pitch_rate, travel_rate = state
        mean_V = -6.0 * elevation - 4.0 * elevation_rate
        difference_V = -3.0 * (pitch + 0.4 * travel + 0.6 * travel_rate) - 1.5 * pitch_rate
        volts = hover_V + np.array([mean_V + difference_V, mean_V - difference_V]) + excited_V[:, k]
        rows.append((*volts, elevation, pitch, travel))
        random_rate_changes = 0.002 * rng.standard_normal(3)
        state = state + 0.01 * np.asarray(rates(state, volts, values)).ravel()
        state[3:] += random_rate_changes
    return Flight(t_s, *np.ascontiguousarray(np.array(rows).T))


@pytest.mark.medium
@pytest.mark.parametrize("stiffness", [0.0, 0.5])
def test_stepwise_regression_names_a_spring_if_there_is_one(stiffness: float) -> None:
    flight = flown(stiffness)
    case = BenchmarkCase("case", rig=RIG, training=(flight,), validation=(flight,), causes=CAUSES)
    answer = check_answer(stepwise.diagnose(case), CAUSES, "stepwise")
    assert answer.equation_torques == {}
    if stiffness:
        assert answer.probabilities[SPRING] > 0.9
        estimate = answer.parameters[STIFFNESS]
        assert abs(estimate.value - stiffness) < 0.2 * stiffness
    else:
        assert answer.probabilities[SPRING] < 0.5
        assert STIFFNESS not in answer.parameters


@pytest.mark.medium
def test_the_terms_of_an_unlisted_cause_give_its_torques() -> None:
    flight = flown(0.5)
    rates = {name: rate for name, rate in RATES.items() if name != SPRING}
    unaware = Causes(rates, {name: of for name, of in CAUSES.parameters.items() if name != SPRING})
    case = BenchmarkCase("case", rig=RIG, training=(flight,), validation=(flight,), causes=unaware)
    answer = check_answer(stepwise.diagnose(case), unaware, "stepwise")
    assert answer.probabilities[UNLISTED] > 0.9
    assert answer.equation.startswith("travel torque: -")
    torques = answer.equation_torques["validation-1"]
    true_Nm = -0.5 * np.interp(torques.t_s, flight.t_s, flight.travel_rad)
    assert np.corrcoef(torques.values[:, 2], true_Nm)[0, 1] > 0.99
    assert np.ptp(torques.values[:, 2]) == pytest.approx(np.ptp(true_Nm), rel=0.2)
    assert not torques.values[:, :2].any()


@pytest.mark.medium
def test_an_equation_of_an_acceleration_becomes_a_torque_by_the_inertia() -> None:
    flight = flown(0.0)
    case = BenchmarkCase("case", rig=RIG, training=(flight,), validation=(flight,), causes=CAUSES)
    none = np.zeros((1, 3))
    # The feature is travel in units of 0.1 rad, and the residual has the unit 2 rad/s2.
    scales = Standardisation(np.full(3, 2.0), feature_mean=np.zeros(8), feature_std=np.full(8, 0.1))
    regression = ResidualRegression(none[0], none, [], none, none, {}, scales)
    content = torques_of_accelerations(case, regression, {2: lambda features: -features[:, 2]})
    of = content["equation_torques"]["validation-1"]
    accelerations = -20.0 * np.interp(of["t_s"], flight.t_s, flight.travel_rad)
    travel_kg_m2 = np.median(np.array(of["travel_Nm"]) / accelerations)
    stated = inertias_kg_m2({name: RIG[name].value for name in RIG})
    assert travel_kg_m2 == pytest.approx(stated["J_psi"], rel=0.1)
    assert torques_of_accelerations(case, regression, {}) == {}


def test_a_term_is_selected_only_if_it_explains_the_residuals() -> None:
    rng = np.random.default_rng(1)
    columns = rng.standard_normal((300, 3))
    terms = [Term(name, (name,), columns[:, [i]]) for i, name in enumerate("abc")]
    noise, nuisance = rng.standard_normal(300), rng.standard_normal((300, 2))
    none = np.zeros((1, 3))
    with_b = ResidualRegression(noise + 0.8 * columns[:, 1], nuisance, terms, none, none, {}, SCALES)
    assert [term.cause for term in selected(with_b)[0]] == ["b"]
    assert selected(ResidualRegression(noise, nuisance, terms, none, none, {}, SCALES))[0] == []


@pytest.mark.medium
@pytest.mark.parametrize("size", [0.0, 1.0])
def test_lisdd_names_the_term_that_acts_in_one_regime(size: float, monkeypatch: pytest.MonkeyPatch) -> None:
    lisdd = pytest.importorskip("heli_benchmark.methods.lisdd", reason=NO_EXTRA, exc_type=ImportError)
    rng = np.random.default_rng(2)
    count = 1500
    columns, nuisance = rng.standard_normal((3 * (count - 1), 3)), rng.standard_normal((3 * (count - 1), 2))
    # Six regimes in the plane of the first two features; the model fails in one of them.
    regime = np.arange(count) % 6
    angle = 2.0 * np.pi * regime / 6.0
    features = 0.1 * rng.standard_normal((count, 8))
    features[:, :2] += np.column_stack([np.cos(angle), np.sin(angle)])
    fails = np.repeat(regime[1:] == 4, 3)
    target = rng.standard_normal(3 * (count - 1)) + nuisance @ [1.0, -0.5] + size * fails * columns[:, 1]
    priors = {name: Estimate(1.0, 0.1) for name in ("thrust_gain", "dead_zone")}
    names = (SPRING, "travel_drag_quadratic", "rotor_lag")
    terms = [Term(name, (), columns[:, [i]]) for i, name in enumerate(names)]
    regression = ResidualRegression(target, nuisance, terms, np.zeros((1, 3)), features, priors, SCALES)
    monkeypatch.setattr(lisdd, "residual_regression", lambda case: regression)
    answer = lisdd.diagnose(BenchmarkCase("case", rig=RIG, training=(), validation=(), causes=CAUSES))
    named = [name for name, p in answer["probabilities"].items() if p > 0.5 and name != NOTHING]
    assert named == (["travel_drag_quadratic"] if size else [])


@pytest.mark.medium
def test_evidence_of_simulated_causes_is_highest_for_the_cause_that_was_drawn() -> None:
    rng = np.random.default_rng(5)
    columns, nuisance = rng.standard_normal((600, 3)), rng.standard_normal((600, 2))
    names = (SPRING, "travel_drag_quadratic", "rotor_lag")
    terms = [Term(name, (), columns[:, [i]]) for i, name in enumerate(names)]
    none = np.zeros((1, 3))
    evidence = TermEvidence(
        ResidualRegression(nuisance[:, 0], nuisance, terms, none, none, {}, SCALES), CAUSES
    )
    targets, hidden = evidence.simulated(400, rng)
    gains = evidence.features(targets)[:, : len(CAUSES.listed)]
    share = np.mean([NOTHING in of for of in hidden])
    assert abs(share - RATES[NOTHING]) < 0.1
    listed = list(CAUSES.listed)
    single_causes = [(gain, next(iter(of))) for gain, of in zip(gains, hidden, strict=True) if len(of) == 1]
    right = [
        gain.max() < 5.0 if name == NOTHING else listed[gain.argmax()] == name for gain, name in single_causes
    ]
    assert np.mean(right) > 0.95


@pytest.mark.parametrize("method", TUNED)
def test_a_tuned_constant_has_one_of_the_values_that_were_tried(method: str) -> None:
    constant, values, fixed = TUNED[method]
    module = pytest.importorskip(f"heli_benchmark.methods.{method}", reason=NO_EXTRA, exc_type=ImportError)
    assert getattr(module, constant) in values
    assert len(values) == 5
    assert all(callable(getattr(module, name)) for name in fixed)


def test_our_probabilities_of_a_verdict_follow_from_base_rates_and_its_shares() -> None:
    # 0.5 of the cases hide nothing, 0.1 an unlisted cause and 0.4 a listed one.
    explained = 0.5 * 42 / 44 + 0.4 * 2 / 50 + 0.1 * 2 / 23
    assert ours.probability(NOTHING, "explained", CAUSES) == pytest.approx(0.5 * 42 / 44 / explained)
    unexplained = 0.5 * 2 / 44 + 0.4 * 2 / 50 + 0.1 * 21 / 23
    assert ours.probability(UNLISTED, "unexplained", CAUSES) == pytest.approx(0.1 * 21 / 23 / unexplained)
    assert ours.probability(UNLISTED, "insufficient_excitation", CAUSES) == pytest.approx(0.1)


def test_base_rates_are_the_answer_without_a_look_at_the_flights() -> None:
    case = BenchmarkCase("case", rig=RIG, training=(), validation=(), causes=CAUSES)
    assert base_rates.diagnose(case)["probabilities"] == RATES


@pytest.mark.diagnosis
def test_our_answer_has_the_rig_that_predicts_with_the_torques_of_its_flights(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    diagnosis, (fit, held_out) = diagnosed("rotor_lag=0.06"), flights("rotor_lag=0.06")
    monkeypatch.setattr(ours, "lab_diagnose", lambda *args, **kwargs: diagnosis)
    case = BenchmarkCase("case", rig=RIG, training=(fit,), validation=(held_out,), causes=CAUSES)
    parameters = check_answer(ours.diagnose(case), CAUSES, "ours").parameters
    extended = diagnosis.rig("extended")
    constants = {f"torque_{axis}" for axis in AXES} | {"offset_elevation", "offset_pitch"}
    assert constants <= parameters.keys()
    for name in parameters.keys() & extended.numbers.keys():
        assert parameters[name].value == extended[name].value
    assert "rotor_lag_s" in parameters


@pytest.mark.diagnosis
def test_our_answer_gives_the_sizes_of_both_parts_of_a_lag_with_delay(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    diagnosis, (fit, held_out) = diagnosed("rotor_lag=0.06"), flights("rotor_lag=0.06")
    result = to_json(diagnosis)
    (lag,) = result["causes"]
    sizes = {"lag_s": {"value": 0.05, "std": 0.01}, "delay_s": {"value": 0.01, "std": 0.005}}
    both = {f"rotor_lag_with_delay_{name}": size for name, size in sizes.items()}
    lag = {**lag, "effect": "rotor_lag_with_delay", "parameters": both}
    monkeypatch.setattr(ours, "lab_diagnose", lambda *args, **kwargs: diagnosis)
    monkeypatch.setattr(ours, "to_json", lambda _: {**result, "causes": [lag]})
    causes = Causes(
        {**RATES, "input_delay": 0.1}, {**CAUSES.parameters, "input_delay": {"input_delay_s": "s"}}
    )
    answer = ours.diagnose(
        BenchmarkCase("case", rig=RIG, training=(fit,), validation=(held_out,), causes=causes)
    )
    parameters = check_answer(answer, causes, "ours").parameters
    assert (parameters["rotor_lag_s"].value, parameters["input_delay_s"].value) == (0.05, 0.01)


@pytest.mark.diagnosis
@pytest.mark.parametrize(("confidence", "of_other"), [(0.7, 0.3), (0.4, 0.4)])
def test_an_alternative_is_never_more_probable_in_our_answer_than_the_cause(
    monkeypatch: pytest.MonkeyPatch, confidence: float, of_other: float
) -> None:
    diagnosis, (fit, held_out) = diagnosed("rotor_lag=0.06"), flights("rotor_lag=0.06")
    result = to_json(diagnosis)
    (lag,) = result["causes"]
    lag = {**lag, "confidence": confidence, "ambiguous_with": ["input_delay"]}
    monkeypatch.setattr(ours, "lab_diagnose", lambda *args, **kwargs: diagnosis)
    monkeypatch.setattr(ours, "to_json", lambda _: {**result, "causes": [lag]})
    causes = Causes({**RATES, "input_delay": 0.1}, CAUSES.parameters)
    probabilities = ours.diagnose(
        BenchmarkCase("case", rig=RIG, training=(fit,), validation=(held_out,), causes=causes)
    )["probabilities"]
    assert probabilities["rotor_lag"] == pytest.approx(confidence)
    assert probabilities["input_delay"] == pytest.approx(of_other)
