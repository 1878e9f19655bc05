"""Evaluate expressions of a model, such as its rates, at many samples of a trajectory together."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import casadi as ca
from heli_sim.model.base import Model

from heli_lab.fit.estimation import AlongTrajectory


def model_along(
    model: Model, expressions: Callable[[ca.SX, ca.SX, ca.SX, ca.SX], Sequence[ca.SX]]
) -> AlongTrajectory:
    """Compile expressions of a `model`, so that they can be evaluated along trajectories."""
    x, u = ca.SX.sym("x", len(model.states)), ca.SX.sym("u", 2)
    t, p = ca.SX.sym("t"), ca.SX.sym("p", len(model.parameters))
    results = [ca.densify(ca.SX(expression)) for expression in expressions(x, u, p, t)]
    return AlongTrajectory(ca.Function("along", [x, u, t, p], results))
