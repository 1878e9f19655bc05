"""Weather is explained; what is hidden in it is found."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from heli_lab.diagnose import Diagnosis, diagnose, summary, to_json
from heli_lab.diagnose.verdict import gust_alone
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import catalogue
from heli_sim.rig import load_rig

from tests.diagnose.hidden import WHOLE_S, flights
from tests.running.long import LONG

pytestmark = pytest.mark.diagnosis

_GUST = "random_torque.travel=0.03"
_WEATHER = ("random_torque.elevation=0.012", "random_torque.pitch=0.004", "random_torque.travel=0.008")


@cache
def diagnosed(*effects: str) -> Diagnosis:
    """Diagnose flights with chance, and perhaps something else, in them."""
    # In half of these flights more would have to be tried before chance and a cause are told apart.
    fit, held_out = flights(*effects, seconds=WHOLE_S)
    return diagnose(MultibodyModel(), load_rig("makki2024"), [fit], [held_out], labels=["fit", "held out"])


def assert_gusts_told(numbers: dict[str, Any]) -> None:
    for axis, size in (("elevation", 0.012), ("pitch", 0.004), ("travel", 0.008)):
        assert numbers["disturbances"][axis]["fast_std_Nm"] == pytest.approx(size, rel=0.4)
        assert numbers["disturbances"][axis]["log_likelihood_ratio"] > 100.0


def test_weather_alone_is_explained_and_told_by_its_size() -> None:
    numbers = to_json(diagnosed(*_WEATHER))
    assert numbers["verdict"] == "explained"
    assert numbers["causes"] == []
    assert_gusts_told(numbers)
    assert "gusts of" in summary(diagnosed(*_WEATHER))


@pytest.mark.skipif(not LONG, reason="tests/blind finds a lag, too; this one runs in make long")
def test_lag_in_weather_is_named_with_its_size_and_nothing_else() -> None:
    numbers = to_json(diagnosed(*_WEATHER, "rotor_lag=0.06"))
    assert numbers["verdict"] == "cause_found"
    (cause,) = numbers["causes"]
    assert cause["effect"] == "rotor_lag"
    found = cause["parameters"]["rotor_lag_s"]
    assert abs(found["value"] - 0.06) < 3.0 * found["std"]
    assert cause["confidence"] > 0.9
    assert_gusts_told(numbers)


def test_gust_about_one_axis_is_a_random_torque_of_its_size() -> None:
    numbers = to_json(diagnosed(_GUST))
    assert numbers["verdict"] == "cause_found"
    (cause,) = numbers["causes"]
    assert cause["effect"] == "random_torque.travel"
    sigma = cause["parameters"]["random_torque_travel_Nm"]
    assert abs(sigma["value"] - 0.03) < 3.0 * sigma["std"]
    assert numbers["residual"]["innovations"]["predicted_by"] == []


def test_torques_without_memory_are_no_gust() -> None:
    remaining = diagnosed(_GUST).residual_analysis
    assert gust_alone(remaining, catalogue())
    # What friction that catches leaves: nothing that blows is over before the next measurement.
    short = replace(remaining.disturbances, correlation_time_s=np.full(3, 0.03))
    assert not gust_alone(replace(remaining, disturbances=short), catalogue())
