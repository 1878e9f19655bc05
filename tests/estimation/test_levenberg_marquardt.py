"""Levenberg-Marquardt iteration, tested on the Rosenbrock function, whose minimum is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from heli_host.data.arrays import Floats
from heli_lab.fit.normal_equations import DampedStep, minimise, posterior_step
from heli_lab.fit.parameters import FreeParameter, NormalPrior, ParameterVector


@dataclass(frozen=True)
class Guess:
    """Parameters and their cost."""

    theta: Floats
    cost: float


class Rosenbrock:
    """The function of Rosenbrock, a curved valley with its minimum at (1, 1), as a least-squares problem.

    A full Gauss-Newton step from the start (-1.2, 1) increases the cost, so steps must be damped. `high` is
    an upper bound of x.
    """

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
