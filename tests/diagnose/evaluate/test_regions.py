"""Regions in which the model fails are chosen with the false discovery rate controlled."""

from __future__ import annotations

import numpy as np
import pytest
from heli_lab.diagnose.evaluate.regions import are_discoveries


@pytest.mark.medium
@pytest.mark.parametrize("share", [0.0, 0.1, 0.8])
def test_discoveries_are_those_of_scipy(share: float) -> None:
    from scipy.stats import false_discovery_control

    random = np.random.default_rng(1)
    p_values = np.where(random.random(400) < share, 0.003, 1.0) * random.random(400)
    for rate in (0.01, 0.05, 0.2):
        expected = false_discovery_control(p_values) <= rate
        np.testing.assert_array_equal(are_discoveries(p_values, rate), expected)
    assert expected.any() == (share > 0.0)


def test_without_hypotheses_there_is_no_discovery() -> None:
    assert are_discoveries(np.empty(0), 0.05).shape == (0,)
