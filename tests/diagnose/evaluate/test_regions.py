"""Regions in which a model fails: the false discovery rate of their cells."""

from __future__ import annotations

import numpy as np
from heli_lab.explain.residuals import adjusted_p_values


def test_adjusted_p_values_are_those_of_benjamini_and_hochberg() -> None:
    # Computed with scipy.stats.false_discovery_control (SciPy 1.16), whose import takes half a second.
    p_values = np.array([0.04, 0.001, 0.04, 0.9, 0.012, 0.3])
    np.testing.assert_allclose(adjusted_p_values(p_values), [0.06, 0.006, 0.06, 0.9, 0.036, 0.36], rtol=1e-12)
    assert len(adjusted_p_values(np.zeros(0))) == 0
