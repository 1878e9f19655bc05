"""Terms of the baseline that the rig lacks are named as causes."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from heli_lab.diagnose import Diagnosis, diagnose, summary, to_json
from heli_lab.explain.assessment import absence_probability, absent_terms
from heli_lab.explain.comparison import Hypothesis, ModelComparison
from heli_lab.explain.forward import tightly_specified_terms
from heli_lab.explain.prediction import Prediction, predict
from heli_lab.explain.screening import Score, Screening
from heli_lab.fit.records import prepare
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import catalogue, effects_of
from heli_sim.rig import load_rig

from tests.diagnose.hidden import WHOLE_S, flights
from tests.running.long import samples

pytestmark = pytest.mark.diagnosis

KINDS = catalogue()


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
def diagnosed(effect: str) -> Diagnosis:
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


def test_pendulum_far_below_its_prior_is_tried_as_absent(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    comparison, baseline = refitted("removed.pendulum.elevation=1")
    screening = Screening(baseline.estimate)
    prior = comparison.rig["L_theta"]
    # A tolerance is two standard deviations.
    deviation = (baseline.values["L_theta"] - prior.value) / (0.5 * prior.tolerance)
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
    diagnosis = diagnosed(f"removed.{term}=1")
    numbers = to_json(diagnosis)
    assert numbers["verdict"] == "cause_found"
    (cause,) = numbers["causes"]
    assert cause["effect"] == f"removed.{term}"
    (share,) = cause["parameters"].values()
    assert share["value"] == pytest.approx(1.0, abs=0.02)
    assert cause["confidence"] > 0.9
    assert "is not there" in summary(diagnosis)
    # Friction of 0 is a value of the rig's parameter; a pendulum needs an effect that removes it.
    effect_ids = {effect.name for effect in effects_of(diagnosis.rig("extended"))}
    assert effect_ids == ({f"removed.{term}"} if term.startswith("pendulum") else set())


@pytest.mark.parametrize(
    ("value", "std", "low", "high"),
    [
        (0.0, 0.02, 0.98, 0.99),
        (0.04, 0.02, 0.9, 0.99),
        (0.0, 0.5, 0.0, 0.4),
        (0.1, 0.02, 0.0, 0.1),
        (0.5, 0.05, 0.0, 0.01),
        (1.0, 0.01, 0.0, 1e-6),
    ],
)
def test_term_is_absent_only_if_its_parameter_is_precisely_zero(
    value: float, std: float, low: float, high: float
) -> None:
    assert low <= absence_probability(value, std) <= high
