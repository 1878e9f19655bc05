"""Effects that flights hardly distinguish have one comparable number, whatever their equation."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import casadi as ca
import numpy as np
import pytest
from heli_host.data.flight import Flight
from heli_lab.diagnose import Diagnosis, diagnose, summary, to_json
from heli_lab.explain import assessment
from heli_lab.explain.assessment import (
    Influence,
    absence_probability,
    absent_terms,
    influences,
    justified_thrust_noise,
)
from heli_lab.explain.candidates import ScoredCandidate, typical_candidate
from heli_lab.explain.comparison import Hypothesis, ModelComparison
from heli_lab.explain.forward import tightly_specified_terms
from heli_lab.explain.prediction import Prediction, predict
from heli_lab.explain.residuals import gain_ratios
from heli_lab.explain.screening import Score, ScoreStatistics, Screening
from heli_lab.explain.stepwise import Search
from heli_lab.explain.thresholds import DISTURBED_STD
from heli_lab.explain.verdict import (
    CauseParameter,
    FamilyNumber,
    describe_negligible_effects,
    family_number,
    judge,
    prior_conflicts,
    tried_without,
)
from heli_lab.fit.parameters import ValueAndStd
from heli_lab.fit.records import prepare
from heli_lab.report.diagnosis.text import cautions, lines, prior_conflict_sentence, thrust_noise_in_words
from heli_sim.model import MultibodyModel
from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.model.effects import catalogue, effects_of, parse_effects
from heli_sim.rig import Quantity, Rig, load_rig
from typing_extensions import override

from tests.diagnose.hidden import WHOLE_S, flights
from tests.diagnose.schema import conforms
from tests.diagnose.test_causes import diagnosed
from tests.estimation.pendulum import RIG, TRUE_RIG, GUST_Nm, flight_with_disturbances
from tests.identify import made
from tests.identify.made import flown, thinned
from tests.running.kept import FLOWN, KEPT
from tests.running.long import samples

pytestmark = pytest.mark.diagnosis

KINDS = catalogue()
LAG, DELAY = "rotor_lag_with_delay_lag_s", "rotor_lag_with_delay_delay_s"


def test_lag_and_dead_time_add_up_with_their_covariance() -> None:
    covariance = np.array([[4e-6, 0.0, -3.5e-6], [0.0, 1.0, 0.0], [-3.5e-6, 0.0, 4e-6]])
    problem = SimpleNamespace(names=(LAG, "thrust_gain", DELAY))
    std = dict(zip(problem.names, np.sqrt(np.diag(covariance)), strict=True))
    fit = cast(Any, SimpleNamespace(problem=problem, covariance=covariance, std=std))
    parameters = {
        LAG: CauseParameter(0.11, std=2e-3, unit="s"),
        DELAY: CauseParameter(0.02, std=2e-3, unit="s"),
    }
    lag = family_number(fit, KINDS["rotor_lag_with_delay"], KINDS, parameters)
    assert lag is not None
    assert (lag.value, lag.unit) == (pytest.approx(0.13), "s")
    # The variances add up to 8e-6 s^2, less twice the covariance of 3.5e-6 s^2.
    assert lag.std == pytest.approx(1e-3)
    assert "0.1300 ± 0.0010 s" in lag.sentence
    assert lag.members == ("rotor_lag", "rotor_speed_lag", "rotor_lag_with_delay")
    assert family_number(fit, KINDS["axis_tilt"], KINDS, {}) is None


TILT_rad = 0.1


def number(id_: str, arm_m: float, *ambiguous_with: str, **sizes: float) -> FamilyNumber | None:
    """Return the family's number of an effect with these sizes; the standard error of each is 1 % of the
    arm.
    """
    kind = KINDS[id_]
    values = {kind.full(name): value for name, value in sizes.items()}
    std = dict.fromkeys(values, 0.01 * arm_m)
    fit = SimpleNamespace(
        problem=SimpleNamespace(names=(*values, "L_a"), rig=load_rig("makki2024")),
        covariance=np.diag([error**2 for error in (*std.values(), 0.0)]),
        params={**values, "L_a": arm_m},
        std=std,
    )
    parameters = {name: CauseParameter(value, std[name], "") for name, value in values.items()}
    return family_number(cast(Any, fit), kind, KINDS, parameters, ambiguous_with)


def test_zero_error_of_pitch_and_reaction_torque_have_the_same_tilt() -> None:
    arm_m = 0.7
    zero, torque = KINDS["zero_offset.pitch"], KINDS["rotor_reaction_torque"]
    of_zero = number(zero.id, 1.0, torque.id, rad=TILT_rad)
    torque_per_thrust_m = -TILT_rad * arm_m
    of_torque = number(torque.id, arm_m, zero.id, front_m=torque_per_thrust_m, back_m=torque_per_thrust_m)
    assert of_zero is not None
    assert of_torque is not None
    assert of_zero.value == pytest.approx(TILT_rad)
    assert of_torque.value == pytest.approx(TILT_rad)
    assert of_torque.std == pytest.approx(0.01 / np.sqrt(2.0))
    assert of_zero.unit == of_torque.unit == "rad"
    assert "5.7 \u00b1 0.6 deg" in of_zero.sentence
    assert of_zero.members == of_torque.members == (torque.id, zero.id)


def test_a_tilt_has_no_number_where_flights_distinguish_its_causes() -> None:
    id_ = "rotor_reaction_torque"
    assert number(id_, 0.7, front_m=0.05, back_m=-0.05) is None
    assert number(id_, 0.7, "encoder_eccentricity.pitch", front_m=0.05, back_m=-0.05) is None


def test_a_zero_error_of_elevation_has_no_family() -> None:
    assert KINDS["zero_offset.elevation"].family is None
    assert KINDS["zero_offset.pitch"].family == KINDS["rotor_reaction_torque"].family is not None


FRICTION = 0.05
"""Friction of travel in `flights`, N m s/rad."""


def with_tight_prior(value: float) -> Rig:
    """Return a rig whose file has this friction of travel with a small tolerance."""
    rig = load_rig("makki2024")
    number = replace(rig["friction_travel"], value=value, tolerance=0.1 * value)
    return Rig(rig.name, rig.description, {**rig.numbers, "friction_travel": number}, rig.effects, rig.model)


def test_estimate_without_a_tight_wrong_prior_is_right() -> None:
    fit, _ = flights()
    rig = with_tight_prior(2.0 * FRICTION)
    comparison = ModelComparison(MultibodyModel(), rig, [prepare(fit, rig, "fit")], [])
    estimate = comparison.refit([]).estimate
    conflicts = tried_without(prior_conflicts(predict(estimate, comparison.train, ()).fit), estimate)
    conflict = next(conflict for conflict in conflicts if conflict.name == "friction_travel")
    assert conflict.freed is not None
    assert abs(conflict.freed.value - FRICTION) < 3.0 * conflict.freed.std < 0.01
    assert conflict.freed.value < conflict.value < 2.0 * FRICTION
    assert conflict.freed.log_likelihood_gain > 30.0
    assert "these flights alone give 0.0" in prior_conflict_sentence(conflict)


def test_an_effect_that_a_wrong_parameter_replaces_has_a_score() -> None:
    fit, _ = flights()
    rig = with_tight_prior(2.0 * FRICTION)
    comparison = ModelComparison(MultibodyModel(), rig, [prepare(fit, rig, "fit")], [])
    baseline = comparison.refit([])
    (scored,) = Screening(baseline.estimate).effects([KINDS["removed.friction.travel"]])
    refitted_nats = comparison.refit([scored.candidate]).log_likelihood - baseline.log_likelihood
    assert 0.25 * refitted_nats < scored.log_likelihood_gain < 1.2 * refitted_nats


def test_without_prior_conflicts_nothing_is_refitted() -> None:
    fit, _ = flights()
    rig = load_rig("makki2024")
    comparison = ModelComparison(MultibodyModel(), rig, [prepare(fit, rig, "fit")], [])
    estimate = comparison.refit([]).estimate
    assert tried_without(prior_conflicts(predict(estimate, comparison.train, ()).fit), estimate) == ()


@cache
def refitted(effect: str) -> tuple[ModelComparison, Hypothesis]:
    """Refit the baseline to flights of a rig that lacks a term."""
    rig = load_rig("makki2024")
    # Flights of 34 s show whether the rig has a pendulum; half of the time is not enough.
    fit, held_out = flights(effect, seconds=WHOLE_S)
    comparison = ModelComparison(
        MultibodyModel(), rig, [prepare(fit, rig, "fit")], [prepare(held_out, rig, "held out")]
    )
    return comparison, comparison.refit([])


def free_run(effect: str) -> Prediction:
    """Free runs of that baseline."""
    comparison, baseline = refitted(effect)
    return predict(baseline.estimate, comparison.train, ())


@cache
def diagnosed_without_term(effect: str) -> Diagnosis:
    """Diagnose flights of a rig that lacks a term; few candidates, to be quick."""
    fit, held_out = flights(effect)
    few = {id_: kind for id_, kind in KINDS.items() if kind.baseline or id_ in ("rotor_lag", "axis_tilt")}
    return diagnose(
        MultibodyModel(), load_rig("makki2024"), [fit], [held_out], kinds=few, labels=["fit", "held out"]
    )


@pytest.mark.parametrize("axis", ["travel", "elevation", "pitch"][: samples(3, 1)])
def test_absent_friction_is_named_from_its_estimate(axis: str) -> None:
    comparison, _ = refitted(f"removed.friction.{axis}=1")
    (term,) = absent_terms(free_run(f"removed.friction.{axis}=1").fit, comparison.rig, KINDS)
    assert term.id == f"removed.friction.{axis}"
    assert abs(term.share - 1.0) < 3.0 * term.std
    assert term.confidence > 0.9
    assert term.z_from_zero < 3.0
    assert term.z_from_rig > 10.0


def test_absent_pendulum_with_a_tight_prior_has_a_high_score() -> None:
    comparison, baseline = refitted("removed.pendulum.elevation=1")
    terms = tightly_specified_terms(comparison, KINDS.values(), Screening(baseline.estimate))
    best = max(terms, key=lambda term: term.log_likelihood_gain)
    assert best.candidate.id == "removed.pendulum.elevation"
    assert best.log_likelihood_gain > 15.0
    without_pendulum = comparison.refit([best.candidate], best.start, baseline)
    assert without_pendulum.log_likelihood > baseline.log_likelihood + 100.0


def test_pendulum_far_below_its_prior_is_tried_as_absent(monkeypatch: pytest.MonkeyPatch) -> None:
    comparison, baseline = refitted("removed.pendulum.elevation=1")
    screening = Screening(baseline.estimate)
    prior = comparison.rig["L_theta"]
    # A tolerance is two standard deviations.
    deviation = (baseline.params["L_theta"] - prior.value) / (0.5 * prior.tolerance)
    # No term has a score, so only the distance from the prior counts.
    score = Score(0.0, np.zeros(1), np.ones(1))
    monkeypatch.setattr(screening, "score", lambda candidates: [score for _ in candidates])
    terms = tightly_specified_terms(comparison, KINDS.values(), screening)
    assert [term.candidate.id for term in terms] == ["removed.pendulum.elevation"]
    assert terms[0].log_likelihood_gain == pytest.approx(0.5 * deviation**2)


def test_clearly_absent_pendulum_is_named_despite_its_tight_prior() -> None:
    comparison, _ = refitted("removed.pendulum.pitch=1")
    (term,) = absent_terms(free_run("removed.pendulum.pitch=1").fit, comparison.rig, KINDS)
    assert term.id == "removed.pendulum.pitch"


def test_other_effect_makes_no_term_absent() -> None:
    comparison, _ = refitted("rotor_lag=0.06")
    assert absent_terms(free_run("rotor_lag=0.06").fit, comparison.rig, KINDS) == ()


@pytest.mark.parametrize("term", ["friction.travel", "pendulum.elevation"][: samples(2, 1)])
def test_removed_term_is_the_cause_and_in_the_extended_rig(term: str) -> None:
    diagnosis = diagnosed_without_term(f"removed.{term}=1")
    numbers = to_json(diagnosis)
    assert numbers["verdict"] == "cause_found"
    (cause,) = numbers["causes"]
    assert cause["effect"] == f"removed.{term}"
    (share,) = cause["parameters"].values()
    assert share["value"] == pytest.approx(1.0, abs=0.02)
    assert cause["confidence"] > 0.9
    assert "is missing" in summary(diagnosis)
    # Friction of 0 is a value of the rig's parameter; a pendulum needs an effect that removes it.
    effect_ids = {effect.name for effect in effects_of(diagnosis.rig("extended"))}
    assert effect_ids == ({f"removed.{term}"} if term.startswith("pendulum") else set())


@pytest.mark.parametrize(
    ("value", "std", "low", "high"),
    [
        (0.0, 0.003, 0.95, 0.99),
        (0.0, 0.1, 0.0, 0.5),  # friction of 0.07 of its value in the rig file, in slow logs
        (0.04, 0.02, 0.0, 0.5),
        (0.0, 0.5, 0.0, 0.1),
        (0.1, 0.02, 0.0, 0.01),
        (0.5, 0.05, 0.0, 0.01),
        (1.0, 0.01, 0.0, 1e-6),
    ],
)
def test_term_is_absent_only_if_its_parameter_is_precisely_zero(
    value: float, std: float, low: float, high: float
) -> None:
    assert low <= absence_probability(value, std, rig_std=0.5) <= high


def test_parameter_that_deviates_from_a_tight_rig_file_is_not_absent() -> None:
    assert absence_probability(0.1, 0.05, rig_std=0.03) < 0.2


def test_held_out_flights_make_a_small_friction_present() -> None:
    rig = load_rig("makki2024")
    friction = rig["friction_travel"].value
    fit: Any = SimpleNamespace(
        params={"friction_travel": 0.004 * friction}, std={"friction_travel": 0.004 * friction}, at_bound=()
    )
    (term,) = absent_terms(fit, rig, KINDS)
    assert term.id == "removed.friction.travel"
    joint = {"friction_travel": ValueAndStd(0.02 * friction, 0.003 * friction)}
    assert absent_terms(fit, rig, KINDS, joint) == ()


_NO_REFIT: Any = SimpleNamespace()
"""A single cause needs no refit: the model without it is the baseline."""


def test_lag_changes_the_prediction_by_many_counts() -> None:
    diagnosis = diagnosed("rotor_lag=0.06")
    before, after = diagnosis.assessment.before, diagnosis.assessment.after
    changes = influences(_NO_REFIT, diagnosis.search, diagnosis.assessment.extended, before, after)
    assert changes.keys() == {"rotor_lag"}
    # As much as the baseline's error: 11 standard deviations of the quantisation and more, on pitch.
    largest = max(before.train.axes[1], before.held_out.axes[1])
    assert changes["rotor_lag"].change_counts == pytest.approx(largest / 12.0**0.5, rel=0.1)
    # A model compared with itself changes nothing.
    same = influences(_NO_REFIT, diagnosis.search, diagnosis.assessment.extended, after, after)
    assert same == {"rotor_lag": Influence(0.0, ())}
    assert not same["rotor_lag"].matters


def test_cause_matters_if_only_the_held_out_flights_are_predicted_worse_without_it() -> None:
    diagnosis = diagnosed("rotor_lag=0.06")
    extended, after = diagnosis.assessment.extended, diagnosis.assessment.after
    axes = np.sqrt(after.held_out.axes**2 + 12.0 * np.array([0.0, 0.0, 0.3**2]))
    worse = replace(after, held_out=replace(after.held_out, axes=axes))
    changes = influences(_NO_REFIT, diagnosis.search, extended, worse, after)
    assert changes["rotor_lag"].change_counts == pytest.approx(0.3)
    # A model that predicts these flights better without the cause adds no error.
    changes = influences(_NO_REFIT, diagnosis.search, extended, after, worse)
    assert changes["rotor_lag"].change_counts == 0.0


def test_cause_matters_if_a_number_of_the_rig_leaves_its_prior_without_it() -> None:
    diagnosis = diagnosed("rotor_lag=0.06")
    extended, after = diagnosis.assessment.extended, diagnosis.assessment.after
    free = after.fit.problem.free
    index = [parameter.name for parameter in free].index("L_theta")
    theta = after.fit.theta.copy()
    theta[index] = free[index].prior.mean + 4.1 * free[index].prior.std
    elsewhere = replace(after, fit=replace(after.fit, theta=theta))
    without_lag = influences(_NO_REFIT, diagnosis.search, extended, elsewhere, after)["rotor_lag"]
    assert Influence(0.0, without_lag.conflicts).matters
    assert [conflict.name for conflict in without_lag.conflicts] == ["L_theta"]
    instead = replace(diagnosis.assessment, instead={"rotor_lag": without_lag.conflicts})
    (caution,) = (line for line in cautions(replace(diagnosis, assessment=instead)) if "L_theta" in line)
    assert "L_theta = 0.0341 m (rig file: 0.03 \N{PLUS-MINUS SIGN} 0.001 m)" in caution


def test_every_significant_cause_matters_under_disturbances() -> None:
    diagnosis = diagnosed("rotor_lag=0.06")
    before, after = diagnosis.assessment.before, diagnosis.assessment.after
    disturbed = replace(after, train=replace(after.train, total=1.01 * DISTURBED_STD))
    assert influences(_NO_REFIT, diagnosis.search, diagnosis.assessment.extended, before, disturbed) == {}


def test_effect_that_is_too_small_is_listed_and_is_no_cause() -> None:
    diagnosis = diagnosed("rotor_lag=0.06")
    assert diagnosis.verdict.negligible_effects == ()
    after, kinds = diagnosis.assessment.after, diagnosis.kinds
    small = describe_negligible_effects(diagnosis.search, {"rotor_lag": 0.11}, kinds, after.fit)
    verdict = judge(
        diagnosis.search,
        diagnosis.assessment.residual_analysis,
        after,
        kinds,
        absent=False,
        negligible_effects=small,
    )
    assert verdict.label == "explained"
    assert verdict.causes == ()
    minor = replace(diagnosis, assessment=replace(diagnosis.assessment, verdict=verdict))
    numbers = to_json(minor)
    conforms(numbers)
    assert numbers["causes"] == []
    (effect,) = numbers["too_small"]
    assert effect["effect"] == "rotor_lag"
    assert effect["change_counts"] == 0.11
    (line,) = [line for line in lines(minor) if line.startswith("too small to matter: rotor_lag")]
    assert "by 0.11 encoder counts rms" in line
    assert "lag" not in summary(minor)


STD, CORRELATION_s = 0.03, 1.5


class _WanderingSupply(Effect):
    """The voltage of both motors varies by an Ornstein-Uhlenbeck process."""

    @override
    def voltage_V(self, at: Operands, volts_V: ca.SX) -> ca.SX:
        return volts_V * (1 + self.value(at, "now"))

    @override
    def state_rates(self, at: Operands) -> ca.SX:
        return -self.value(at, "now") / CORRELATION_s

    @override
    def diffusion(self, at: Operands, step_s: float, normal: ca.SX) -> ca.SX:
        return STD * ca.sqrt(1 - ca.exp(-2 * step_s / CORRELATION_s)) * normal


def _flown() -> Flight:
    """Fly a rig whose supply wanders, in weak gusts."""
    gusts = parse_effects([f"random_torque.{axis}={size / 3}" for axis, size in GUST_Nm.items()])
    state = (Quantity("wandering_now", "1", "relative change of the voltage"),)
    wander = _WanderingSupply("wandering", states=state, stage=Stage.TORQUE, noise_inputs=1)
    return thinned(flown(TRUE_RIG, 21, 34.0, MultibodyModel((*gusts, wander))), 2)


@cache
def wandering() -> ModelComparison:
    """A flight whose supply wanders, in weak gusts."""
    flight = KEPT("wandering supply", _flown, made_by=(Path(__file__), Path(made.__file__)), rooms=FLOWN)
    return ModelComparison(MultibodyModel(), RIG, [prepare(flight, RIG, "wandering")], [])


def _justified(comparison: ModelComparison, verdict: str, gain_nats: float = 20.0) -> ModelComparison | None:
    """Ask for the noise after a search without causes, whose innovations a predictor explains by a gain."""
    dependences = (SimpleNamespace(log_likelihood_gain=gain_nats),)
    residual: Any = SimpleNamespace(dependences=dependences)
    assessment: Any = SimpleNamespace(verdict=SimpleNamespace(label=verdict), residual_analysis=residual)
    search: Any = SimpleNamespace(baseline=comparison.filtering_baseline, final=comparison.filtering_baseline)
    return justified_thrust_noise(comparison, search, assessment)


def test_a_wandering_supply_is_estimated_with_its_size_and_time() -> None:
    noisy = _justified(wandering(), "unexplained")
    assert noisy is not None
    estimate = noisy.filtering_baseline.estimate
    supply, difference = estimate.disturbances.gains
    assert supply.std == pytest.approx(STD, rel=0.4)
    assert 0.4 * CORRELATION_s < supply.correlation_time_s < 2.5 * CORRELATION_s
    assert difference.std < 0.3 * STD
    assert gain_ratios(Screening(estimate))[0] > 100.0


def test_no_thrust_noise_without_need_or_evidence() -> None:
    assert _justified(wandering(), "explained") is None
    assert _justified(wandering(), "unexplained", gain_nats=1000.0) is None
    gusts_alone = ModelComparison(MultibodyModel(), RIG, [flight_with_disturbances()], [])
    assert _justified(gusts_alone, "unexplained") is None


def test_a_supply_that_varies_is_stated_in_words() -> None:
    noise = {
        "supply": {"std": 0.021, "correlation_time_s": 2.1, "log_likelihood_ratio": 80.0},
        "difference": {"std": 0.004, "correlation_time_s": 0.3, "log_likelihood_ratio": 1.0},
    }
    assert thrust_noise_in_words(noise) == ["the supply varies by 2 % with a correlation time of 2 s"]


DRAG, STEP = "travel_drag_quadratic", "thrust_step.front"
TRIED = {id_: KINDS[id_] for id_ in (DRAG, "pitch_drag_quadratic", STEP)}


def hypothesis(*ids: str, nats: float = 0.0) -> Hypothesis:
    """A model with these causes."""
    candidates = tuple(typical_candidate(KINDS[id_]) for id_ in ids)
    return cast(
        Hypothesis,
        SimpleNamespace(
            candidates=candidates, ids=ids, log_likelihood=nats, estimate=nats, params={}, std={}
        ),
    )


class Scores:
    """Stand-in for a screening of one set of flights, with given gains of the effects."""

    # Each coefficient has a Fisher information of 1e6. The gain is score^2 / (2 information), which gives the
    # score.

    gains: dict[str, float]

    def __init__(self, gains: dict[str, float]) -> None:
        self.gains = gains

    def effects(self, kinds: Any) -> list[ScoredCandidate]:
        """Candidates of typical size."""
        zeros = np.zeros(1)
        return [
            ScoredCandidate(
                typical_candidate(kind),
                log_likelihood_gain=self.gains.get(kind.id, 0.0),
                coefficients=zeros,
                std=zeros,
                grid_points=1,
            )
            for kind in kinds
        ]

    def statistics(self, candidates: Any) -> list[ScoreStatistics]:
        """Statistics whose score test has the gains."""
        result = []
        for candidate in candidates:
            size = len(candidate.linear_parameters)
            gain = self.gains.get(candidate.id, 0.0)
            score = np.sign(gain) * np.sqrt(2.0 * abs(gain) * 1e6)
            result.append(ScoreStatistics(np.eye(size) * 1e6, np.full(size, score)))
        return result

    def release(self) -> None:
        """Nothing is kept."""


def explained_remainder(
    monkeypatch: pytest.MonkeyPatch,
    fitted: dict[str, float],
    held_out: dict[str, float] | None,
    min_nats: float = 0.0,
    nats: float = 5.0,
) -> Any:
    """Search the remainder of a flight for one more cause; return the search with it, or None."""
    # `fitted`, `held_out`: Gain of each effect on the fitted and on the held-out flights, nats. Gains of
    # opposite signs belong to sizes of opposite signs.
    # `min_nats`: Smallest score on the fitted flights.
    # `nats`: Gain of the refit on the fitted flights, a third of that on the held-out flights.
    # The screening of the refitted model is not used.
    monkeypatch.setattr(assessment, "Screening", lambda _: Scores({}))

    def refit(candidates: Any, *_: object) -> Hypothesis:
        return hypothesis(*(candidate.id for candidate in candidates), nats=nats)

    train, held_out_flight = SimpleNamespace(), SimpleNamespace()
    comparison = ModelComparison(*cast(Any, (None, None, [train], [held_out_flight])))
    monkeypatch.setattr(comparison, "refit", refit)
    comparison.__dict__["rows"] = 1000
    monkeypatch.setattr(
        comparison, "held_out_estimate", lambda of: SimpleNamespace(log_likelihood=3.0 * of.log_likelihood)
    )
    final = hypothesis("axis_tilt")
    search = Search(final, final, (), (), cast(Any, Scores(fitted)), complete=True)
    screenings = () if held_out is None else (Scores(held_out),)
    return assessment.with_remainder(comparison, search, TRIED, cast(Any, screenings), min_nats)


def test_an_effect_that_all_flights_show_together_is_a_cause_with_little_evidence(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    wider = explained_remainder(monkeypatch, fitted={DRAG: 8.0}, held_out={DRAG: 12.0})
    (cause,) = wider.causes
    assert wider.final.ids == ("axis_tilt", DRAG)
    assert (cause.effect, cause.train_nats, cause.held_out_nats) == (DRAG, 5.0, 15.0)
    # Another effect is named with it if all flights together do not distinguish them.
    other = "pitch_drag_quadratic"
    (cause,) = explained_remainder(
        monkeypatch, fitted={DRAG: 8.0, other: 7.0}, held_out={DRAG: 12.0, other: 12.0}
    ).causes
    assert cause.ambiguous_with == (other,)


def test_flights_that_contradict_each_other_show_no_effect(monkeypatch: pytest.MonkeyPatch) -> None:
    assert explained_remainder(monkeypatch, fitted={DRAG: 12.0}, held_out={DRAG: -12.0}) is None
    assert explained_remainder(monkeypatch, fitted={DRAG: 3.0}, held_out={DRAG: 2.0}) is None


def test_effect_whose_refit_all_flights_hardly_need_is_no_cause(monkeypatch: pytest.MonkeyPatch) -> None:
    assert explained_remainder(monkeypatch, fitted={DRAG: 8.0}, held_out={DRAG: 12.0}, nats=3.0) is None
    assert explained_remainder(monkeypatch, fitted={DRAG: 8.0}, held_out={DRAG: 12.0}, nats=-1.0) is None


def test_effect_that_fitted_flights_do_not_show_is_tried_for_a_remainder(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert explained_remainder(monkeypatch, fitted={DRAG: 1.0}, held_out={DRAG: 19.0}) is not None
    assert explained_remainder(monkeypatch, fitted={DRAG: 1.0}, held_out={DRAG: 19.0}, min_nats=2.0) is None


def test_remainder_search_skips_events_and_flights_too_short_to_test(monkeypatch: pytest.MonkeyPatch) -> None:
    assert explained_remainder(monkeypatch, fitted={STEP: 90.0}, held_out={STEP: 90.0}) is None
    assert explained_remainder(monkeypatch, fitted={DRAG: 20.0}, held_out=None) is None
