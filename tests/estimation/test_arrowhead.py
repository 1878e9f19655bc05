"""Normal equations with an arrowhead: some unknowns belong to all flights, others to a single flight.

The unknowns of each flight are eliminated separately. The solution must equal that of the full matrix.
"""

from __future__ import annotations

import numpy as np
import pytest
from heli_host.data.arrays import Floats, Integers
from heli_lab.fit.normal_equations import invert_arrowhead, per_flight_columns, solve_arrowhead
from hypothesis import assume, given, settings
from hypothesis import strategies as st


def random_system(flights: int, shared: int, per_flight: int, seed: int) -> tuple[Floats, list[Integers]]:
    """Make the information matrix of several flights, and the columns of the unknowns of each flight.

    All flights depend on `shared` unknowns, and each on `per_flight` unknowns that no other flight has.
    """
    random = np.random.default_rng(seed)
    size = shared + flights * per_flight
    # Shared and per-flight unknowns are in any order.
    order = random.permutation(size)
    columns_by_flight = []
    for flight in range(flights):
        first = shared + flight * per_flight
        columns_by_flight.append(np.sort(order[[*range(shared), *range(first, first + per_flight)]]))
    matrix = np.diag(random.uniform(0.5, 2.0, size))
    for columns in columns_by_flight:
        regressors = random.standard_normal((3 * len(columns), len(columns)))
        matrix[np.ix_(columns, columns)] += regressors.T @ regressors
    return matrix, columns_by_flight


@given(st.integers(1, 6), st.integers(0, 4), st.integers(0, 3), st.integers(0, 2**31))
@settings(max_examples=40, deadline=None)
def test_arrowhead_solution_and_inverse_are_those_of_the_full_matrix(
    flights: int, shared: int, per_flight: int, seed: int
) -> None:
    assume(shared + per_flight > 0)
    matrix, columns_by_flight = random_system(flights, shared, per_flight, seed)
    columns = per_flight_columns(columns_by_flight, len(matrix))
    right = np.random.default_rng(seed).standard_normal((len(matrix), 3))
    for right_side in (right, right[:, 0]):
        solution = solve_arrowhead(matrix, right_side, columns)
        assert solution == pytest.approx(np.linalg.solve(matrix, right_side), abs=1e-9)
    assert invert_arrowhead(matrix, columns) == pytest.approx(np.linalg.inv(matrix), abs=1e-9)


def test_columns_of_a_single_flight_are_per_flight() -> None:
    columns_by_flight = [np.array([0, 1, 2]), np.array([0, 3, 4])]
    assert per_flight_columns(columns_by_flight, 5).tolist() == [[1, 2], [3, 4]]
    # With a single flight nothing needs to be eliminated separately.
    assert per_flight_columns(columns_by_flight[:1], 3).shape == (1, 0)
