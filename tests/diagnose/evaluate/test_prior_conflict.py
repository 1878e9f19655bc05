"""Estimates of a parameter that the rig file has wrong, with and without its prior."""

from __future__ import annotations

from dataclasses import replace

import pytest
from heli_lab.explain.comparison import ModelComparison
from heli_lab.explain.prediction import predict
from heli_lab.explain.verdict import prior_conflicts, tried_without
from heli_lab.fit.records import prepare
from heli_lab.report.diagnosis.text import prior_conflict_sentence
from heli_sim.model import MultibodyModel
from heli_sim.rig import Rig, load_rig

from tests.diagnose.hidden import flights

pytestmark = pytest.mark.diagnosis

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


def test_without_prior_conflicts_nothing_is_refitted() -> None:
    fit, _ = flights()
    rig = load_rig("makki2024")
    comparison = ModelComparison(MultibodyModel(), rig, [prepare(fit, rig, "fit")], [])
    estimate = comparison.refit([]).estimate
    assert tried_without(prior_conflicts(predict(estimate, comparison.train, ()).fit), estimate) == ()
