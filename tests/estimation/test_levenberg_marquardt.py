"""Levenberg-Marquardt of the core finds the minimum of a problem that is no flight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from heli_host.arrays import Floats
from heli_lab.estimation import FreeParameter, NormalPrior, ParameterVector
from heli_lab.estimation.levenberg_marquardt import DampedStep, minimise
from heli_lab.estimation.posterior_step import posterior_step


@dataclass(frozen=True)
class Guess:
    theta: Floats
    cost: float


class Rosenbrock:
    """A banana-shaped valley; a whole Gauss-Newton step from (-1.2, 1) goes uphill."""

    def __init__(self, most_evaluations: int = 1000, high: float = np.inf) -> None:
        priors = NormalPrior(1.0, 10.0, -np.inf, high), NormalPrior(1.0, 10.0)
        free = [FreeParameter(name, "", prior, name) for name, prior in zip("xy", priors, strict=True)]
        self.vector = ParameterVector(["x", "y"], np.array([-1.2, 1.0]), free, [], ["valley"])
        self.most_evaluations, self.evaluations, self.rejected = most_evaluations, 0, 0

    def guess(self, theta: Floats) -> Guess:
        x, y = theta
        self.evaluations += 1
        prior = float(np.sum(((theta - 1.0) / 10.0) ** 2))
        return Guess(theta, float((10.0 * (y - x**2)) ** 2 + (1.0 - x) ** 2) + prior)

    def step(self, iterate: Guess, damping: float) -> DampedStep[Guess]:
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
        return None

    def is_out_of_budget(self) -> bool:
        return self.evaluations >= self.most_evaluations


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


def test_search_out_of_budget_has_not_converged() -> None:
    problem = Rosenbrock(most_evaluations=3)
    start = problem.guess(problem.vector.start)
    minimum = minimise(problem, start, damping=0.0, max_steps=50)
    assert not minimum.converged
    assert minimum.iterate.cost <= start.cost
