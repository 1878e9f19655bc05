"""Each flight's own unknowns are eliminated by themselves; the solution is that of the whole system."""

from __future__ import annotations

import numpy as np
import pytest
from heli_host.arrays import Floats, Integers
from heli_lab.estimation.arrowhead import invert_arrowhead, per_flight_columns, solve_arrowhead
from hypothesis import assume, given, settings
from hypothesis import strategies as st


def system(flights: int, shared: int, own: int, seed: int) -> tuple[Floats, list[Integers]]:
    """Information of flights that share some unknowns and have others of their own, and their columns."""
    random = np.random.default_rng(seed)
    size = shared + flights * own
    # Own unknowns need not stand behind the shared ones.
    order = random.permutation(size)
    columns = [
        np.sort(order[[*range(shared), *range(shared + i * own, shared + (i + 1) * own)]])
        for i in range(flights)
    ]
    matrix = np.diag(random.uniform(0.5, 2.0, size))
    for one in columns:
        rows = random.standard_normal((3 * len(one), len(one)))
        matrix[np.ix_(one, one)] += rows.T @ rows
    return matrix, columns


@given(st.integers(1, 6), st.integers(0, 4), st.integers(0, 3), st.integers(0, 2**31))
@settings(max_examples=40, deadline=None)
def test_arrowhead_solution_and_inverse_are_those_of_the_full_matrix(
    flights: int, shared: int, own: int, seed: int
) -> None:
    assume(shared + own > 0)
    matrix, columns = system(flights, shared, own, seed)
    places = per_flight_columns(columns, len(matrix))
    right = np.random.default_rng(seed).standard_normal((len(matrix), 3))
    assert solve_arrowhead(matrix, right, places) == pytest.approx(np.linalg.solve(matrix, right), abs=1e-9)
    assert solve_arrowhead(matrix, right[:, 0], places) == pytest.approx(
        np.linalg.solve(matrix, right[:, 0]), abs=1e-9
    )
    assert invert_arrowhead(matrix, places) == pytest.approx(np.linalg.inv(matrix), abs=1e-9)


def test_columns_of_a_single_flight_are_per_flight() -> None:
    columns = [np.array([0, 1, 2]), np.array([0, 3, 4])]
    assert per_flight_columns(columns, 5).tolist() == [[1, 2], [3, 4]]
    assert per_flight_columns(columns[:1], 3).shape == (1, 0)
