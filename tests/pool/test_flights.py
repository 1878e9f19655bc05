"""Numbers of one rig from several of its flights together."""

from __future__ import annotations

import numpy as np
import pytest

from tests.pool.flights import BY_FLIGHTS, FLIGHTS, normalised_errors, shares_of_one
from tests.running.long import samples

pytestmark = pytest.mark.slow

RIGS = range(1, 1 + samples(12, 4))


@pytest.mark.parametrize("name", BY_FLIGHTS)
def test_the_standard_error_falls_with_the_root_of_the_number_of_flights(name: str) -> None:
    assert 0.8 < float(np.mean(shares_of_one(name, RIGS))) < 1.2


@pytest.mark.parametrize("count", [1, FLIGHTS])
def test_flights_hold_the_truth_within_two_standard_errors(count: int) -> None:
    assert np.mean(np.abs(normalised_errors(count, RIGS)) < 2.0) > 0.85
