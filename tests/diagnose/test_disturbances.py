"""Disturbances are explained without a cause; an effect under disturbances is found."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from heli_lab.diagnose import Diagnosis, diagnose, summary, to_json
from heli_lab.explain.verdict import has_random_torque
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import catalogue
from heli_sim.rig import load_rig

from tests.diagnose.hidden import WHOLE_S, flights
from tests.running.long import LONG

pytestmark = pytest.mark.diagnosis

_RANDOM_TORQUE = "random_torque.travel=0.03"
_DISTURBANCES = ("random_torque.elevation=0.012", "random_torque.pitch=0.004", "random_torque.travel=0.008")


@cache
def diagnosed(*effects: str) -> Diagnosis:
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
    numbers = to_json(diagnosed(*_DISTURBANCES))
    assert numbers["verdict"] == "explained"
    assert numbers["causes"] == []
    assert_disturbances_are_estimated(numbers)
    assert "mN m about elevation" in summary(diagnosed(*_DISTURBANCES))


@pytest.mark.skipif(not LONG, reason="tests/benchmark finds a lag, too; this one runs in make long")
def test_lag_under_disturbances_is_named_with_its_size_and_nothing_else() -> None:
    numbers = to_json(diagnosed(*_DISTURBANCES, "rotor_lag=0.06"))
    assert numbers["verdict"] == "cause_found"
    (cause,) = numbers["causes"]
    assert cause["effect"] == "rotor_lag"
    lag = cause["parameters"]["rotor_lag_s"]
    assert abs(lag["value"] - 0.06) < 3.0 * lag["std"]
    assert cause["confidence"] > 0.9
    assert_disturbances_are_estimated(numbers)


def test_disturbance_about_a_single_axis_is_a_random_torque_of_its_size() -> None:
    numbers = to_json(diagnosed(_RANDOM_TORQUE))
    assert numbers["verdict"] == "cause_found"
    (cause,) = numbers["causes"]
    assert cause["effect"] == "random_torque.travel"
    sigma = cause["parameters"]["random_torque_travel_Nm"]
    assert abs(sigma["value"] - 0.03) < 3.0 * sigma["std"]
    assert numbers["residual"]["innovations"]["predicted_by"] == []


def test_disturbance_without_correlation_in_time_is_no_random_torque() -> None:
    remaining = diagnosed(_RANDOM_TORQUE).assessment.residual_analysis
    assert has_random_torque(remaining, catalogue())
    # Dry friction that holds for moments leaves torques like these.
    short = replace(remaining.disturbances, correlation_time_s=np.full(3, 0.03))
    assert not has_random_torque(replace(remaining, disturbances=short), catalogue())
