"""Lags of the rotors have one comparable number, whatever their equation."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from heli_lab.diagnose.evaluate.reported import CauseParameter, family_number
from heli_sim.model.effects import catalogue

KINDS = catalogue()
LAG, DELAY = "rotor_lag_with_delay_lag_s", "rotor_lag_with_delay_delay_s"


def test_lag_and_dead_time_add_up_with_their_covariance() -> None:
    covariance = np.array([[4e-6, 0.0, -3.5e-6], [0.0, 1.0, 0.0], [-3.5e-6, 0.0, 4e-6]])
    problem = SimpleNamespace(names=(LAG, "thrust_gain", DELAY))
    std = dict(zip(problem.names, np.sqrt(np.diag(covariance)), strict=True))
    fit = cast(Any, SimpleNamespace(problem=problem, covariance=covariance, std=std))
    parameters = {LAG: CauseParameter(0.11, 2e-3, "s"), DELAY: CauseParameter(0.02, 2e-3, "s")}
    found = family_number(fit, KINDS["rotor_lag_with_delay"], KINDS, parameters)
    assert found is not None
    assert (found.value, found.unit) == (pytest.approx(0.13), "s")
    assert found.std == pytest.approx(1e-3)
    assert "0.1300 ± 0.0010 s" in found.sentence
    assert found.members == ("rotor_lag", "rotor_speed_lag", "rotor_lag_with_delay")
    assert family_number(fit, KINDS["axis_tilt"], KINDS, {}) is None
