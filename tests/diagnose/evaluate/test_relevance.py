"""A cause is named only if it matters; other significant effects are listed separately."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from heli_lab.diagnose import to_json
from heli_lab.explain.assessment import prediction_changes
from heli_lab.explain.thresholds import DISTURBED_STD
from heli_lab.explain.verdict import judge, small_effects
from heli_lab.report.diagnosis.text import lines, summary

from tests.diagnose.schema import conforms
from tests.diagnose.test_causes import diagnosed

pytestmark = pytest.mark.diagnosis

_NO_REFIT: Any = SimpleNamespace()
"""A single cause needs no refit: the model without it is the baseline."""


def test_lag_changes_the_prediction_by_many_counts() -> None:
    diagnosis = diagnosed("rotor_lag=0.06")
    before, after = diagnosis.assessment.before, diagnosis.assessment.after
    changes = prediction_changes(_NO_REFIT, diagnosis.search, diagnosis.assessment.extended, before, after)
    assert changes.keys() == {"rotor_lag"}
    # As much as the baseline's error: 11 standard deviations of the quantisation and more, on pitch.
    largest = max(before.train.axes[1], before.held_out.axes[1])
    assert changes["rotor_lag"] == pytest.approx(largest / 12.0**0.5, rel=0.1)
    # A model compared with itself changes nothing.
    same = prediction_changes(_NO_REFIT, diagnosis.search, diagnosis.assessment.extended, after, after)
    assert same == {"rotor_lag": 0.0}


def test_cause_matters_if_only_the_held_out_flights_are_predicted_worse_without_it() -> None:
    diagnosis = diagnosed("rotor_lag=0.06")
    extended, after = diagnosis.assessment.extended, diagnosis.assessment.after
    axes = np.sqrt(after.held_out.axes**2 + 12.0 * np.array([0.0, 0.0, 0.3**2]))
    worse = replace(after, held_out=replace(after.held_out, axes=axes))
    changes = prediction_changes(_NO_REFIT, diagnosis.search, extended, worse, after)
    assert changes["rotor_lag"] == pytest.approx(0.3)
    # A model that predicts these flights better without the cause adds no error.
    changes = prediction_changes(_NO_REFIT, diagnosis.search, extended, after, worse)
    assert changes["rotor_lag"] == 0.0


def test_every_significant_cause_matters_under_disturbances() -> None:
    diagnosis = diagnosed("rotor_lag=0.06")
    before, after = diagnosis.assessment.before, diagnosis.assessment.after
    disturbed = replace(after, train=replace(after.train, total=1.01 * DISTURBED_STD))
    assert (
        prediction_changes(_NO_REFIT, diagnosis.search, diagnosis.assessment.extended, before, disturbed)
        == {}
    )


def test_effect_that_is_too_small_is_listed_and_is_no_cause() -> None:
    diagnosis = diagnosed("rotor_lag=0.06")
    assert diagnosis.verdict.small == ()
    after, kinds = diagnosis.assessment.after, diagnosis.kinds
    small = small_effects(diagnosis.search, {"rotor_lag": 0.11}, kinds, after.fit)
    verdict = judge(diagnosis.search, diagnosis.assessment.residual_analysis, after, kinds, False, small)
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
