"""Levenberg-Marquardt iteration, tested on the Rosenbrock function, whose minimum is known."""

from dataclasses import dataclass

import numpy as np
import pytest
from heli_host.data.arrays import Floats, Integers
from heli_lab.fit.normal_equations import (
    DampedStep,
    bounded_solve,
    invert_arrowhead,
    minimise,
    per_flight_columns,
    posterior_step,
    solve_arrowhead,
)
from heli_lab.fit.parameters import FreeParameter, NormalPrior, ParameterVector
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear


@dataclass(frozen=True)
class Guess:
    """Parameters and their cost."""

    theta: Floats
    cost: float


class Rosenbrock:
    """The function of Rosenbrock, a curved valley with its minimum at (1, 1), as a least-squares problem."""

    # A full Gauss-Newton step from the start (-1.2, 1) increases the cost, so steps must be damped. `high` is
    # an upper bound of x.

    def __init__(self, max_evaluations: int = 1000, high: float = np.inf) -> None:
        # Priors so wide that they hardly move the minimum.
        priors = NormalPrior(1.0, 10.0, -np.inf, high), NormalPrior(1.0, 10.0)
        free = [FreeParameter(name, "", prior, name) for name, prior in zip("xy", priors, strict=True)]
        self.vector = ParameterVector(["x", "y"], np.array([-1.2, 1.0]), free, [], ["valley"])
        self.max_evaluations, self.evaluations, self.rejected = max_evaluations, 0, 0

    def guess(self, theta: Floats) -> Guess:
        """Evaluate the cost of parameters."""
        x, y = theta
        self.evaluations += 1
        prior = float(np.sum(((theta - 1.0) / 10.0) ** 2))
        return Guess(theta, float((10.0 * (y - x**2)) ** 2 + (1.0 - x) ** 2) + prior)

    def step(self, iterate: Guess, damping: float) -> DampedStep[Guess]:
        """Return the damped Gauss-Newton step from an iterate."""
        x, y = iterate.theta
        residual = np.array([10.0 * (y - x**2), 1.0 - x])
        jacobian = np.array([[20.0 * x, -10.0], [1.0, 0.0]])
        score = jacobian.T @ residual
        step = posterior_step(self.vector, iterate.theta, jacobian.T @ jacobian, score, damping=damping)

        def make() -> Guess:
            after = self.guess(iterate.theta + step.move)
            self.rejected += after.cost > iterate.cost
            return after

        return DampedStep(step.move, step.std, 2.0 * step.promised_nats, make)

    def with_states_refined(self, iterate: Guess) -> Guess | None:
        """Return None, because this problem has no initial states."""
        return None

    def is_out_of_budget(self) -> bool:
        """Whether no further evaluation is allowed."""
        return self.evaluations >= self.max_evaluations


def test_damped_steps_find_the_end_of_a_curved_valley() -> None:
    problem = Rosenbrock()
    minimum = minimise(problem, problem.guess(problem.vector.start), damping=0.0, max_steps=50)
    assert minimum.converged
    assert minimum.iterate.theta == pytest.approx([1.0, 1.0], abs=1e-3)
    assert problem.rejected


def test_search_moves_along_a_bound() -> None:
    problem = Rosenbrock(high=0.5)
    minimum = minimise(problem, problem.guess(problem.vector.start), damping=0.0, max_steps=50)
    assert minimum.iterate.theta == pytest.approx([0.5, 0.25], abs=0.02)


@pytest.mark.parametrize("max_steps", [0, 1, 3])
def test_search_out_of_steps_has_not_converged(max_steps: int) -> None:
    problem = Rosenbrock()
    minimum = minimise(problem, problem.guess(problem.vector.start), damping=0.0, max_steps=max_steps)
    assert not minimum.converged
    # The end of the valley is not reached yet.
    assert abs(minimum.iterate.theta[0] - 1.0) > 0.1


def test_search_whose_steps_all_fail_has_not_converged() -> None:
    """The model is a number at the start only, so that no step of any length succeeds."""
    problem = Rosenbrock()
    start = problem.guess(problem.vector.start)
    problem.guess = lambda theta: Guess(theta, np.nan)  # type: ignore[method-assign]
    assert not minimise(problem, start, damping=0.0, max_steps=50).converged


def test_search_out_of_budget_has_not_converged() -> None:
    problem = Rosenbrock(max_evaluations=3)
    start = problem.guess(problem.vector.start)
    minimum = minimise(problem, start, damping=0.0, max_steps=50)
    assert not minimum.converged
    assert minimum.iterate.cost <= start.cost


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


def random_system(flights: int, shared: int, per_flight: int, seed: int) -> tuple[Floats, list[Integers]]:
    """Make the information matrix of several flights, and the columns of the unknowns of each flight."""
    # All flights depend on `shared` unknowns, and each on `per_flight` unknowns that no other flight has.
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
