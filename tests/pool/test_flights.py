"""Numbers of one rig from several of its flights together."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.pool.flights import pooled
from tests.running.long import samples

pytestmark = pytest.mark.slow

RIGS = range(1, 1 + samples(12, 4))
FLIGHTS = 4
BY_FLIGHTS = ("rotor_lag_s", "friction_pitch", "friction_travel", "dead_zone")
"""Numbers that one flight tells by itself; masses and lengths are told in combinations only, whose other
members a file's tolerances hold."""


@pytest.mark.parametrize("name", BY_FLIGHTS)
def test_the_standard_error_falls_with_the_root_of_the_number_of_flights(name: str) -> None:
    shares = [
        math.sqrt(FLIGHTS) * pooled(rig, FLIGHTS).alone[name].std / pooled(rig, 1).alone[name].std
        for rig in RIGS
    ]
    assert 0.8 < float(np.mean(shares)) < 1.2


@pytest.mark.parametrize("count", [1, FLIGHTS])
def test_flights_hold_the_truth_within_two_standard_errors(count: int) -> None:
    off = [value for rig in RIGS for value in pooled(rig, count).off.values()]
    assert np.mean(np.abs(off) < 2.0) > 0.85
