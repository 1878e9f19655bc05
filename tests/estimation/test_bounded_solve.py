"""Minimum of a quadratic function within bounds: an unknown may leave a bound on the way to the minimum."""

from __future__ import annotations

import numpy as np
import pytest
from heli_lab.fit.normal_equations import bounded_solve
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear


def test_unknown_leaves_its_bound_when_another_is_fixed_at_its_bound() -> None:
    # Without bounds the first unknown is negative. With the second one at its bound of 1, it is +0.1.
    matrix, right = np.array([[1.0, 0.9], [0.9, 1.0]]), np.array([1.0, 1.54])
    assert np.linalg.solve(matrix, right)[0] < 0.0
    solution = bounded_solve(matrix, right, np.zeros(2), np.array([5.0, 1.0]))
    assert solution == pytest.approx([0.1, 1.0])


@given(st.integers(1, 8), st.integers(0, 2**31))
@settings(max_examples=40, deadline=None)
def test_optimum_within_bounds_is_that_of_scipy(size: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    factor = random.standard_normal((size + 1, size))
    observed = random.standard_normal(size + 1)
    low = -random.uniform(0.0, 0.5, size)
    high = random.uniform(0.01, 0.5, size)
    solution = bounded_solve(factor.T @ factor, factor.T @ observed, low, high)
    reference = lsq_linear(factor, observed, (low, high), method="bvls", tol=1e-14).x
    cost, reference_cost = (np.sum((factor @ x - observed) ** 2) for x in (solution, reference))
    assert np.all((low <= solution) & (solution <= high))
    assert cost <= reference_cost + 1e-9
