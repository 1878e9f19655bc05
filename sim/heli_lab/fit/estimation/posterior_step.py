"""The step to the maximum of a quadratic posterior: Gauss-Newton, or Levenberg-Marquardt if it is damped."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from heli_host.data.arrays import Booleans, Floats, Integers

from heli_lab.fit.estimation.arrowhead import NO_BLOCKS, invert_arrowhead
from heli_lab.fit.estimation.bounded_solve import bounded_solve
from heli_lab.fit.estimation.parameter_vector import ParameterVector


@dataclass(frozen=True)
class PosteriorStep:
    """A step of the free parameters."""

    move: Floats  # (f,): The step; within the bounds
    covariance: Floats  # (f, f): Inverse of the damped information, priors included
    promised_nats: float
    """Increase of the log-posterior by the step, less the damping term, if the log-posterior is quadratic."""

    @property
    def std(self) -> Floats:
        """Standard errors of the free parameters, shape (f,)."""
        return np.sqrt(np.diag(self.covariance))


def posterior_step(
    parameter_vector: ParameterVector,
    theta: Floats,
    information: Floats,
    score: Floats,
    *,
    damping: float = 0.0,
    is_fixed: Booleans | None = None,
    per_flight: Integers = NO_BLOCKS,
) -> PosteriorStep:
    """Solve for the step to the maximum of the linearised posterior, within the bounds. Shapes: `theta`
    (f,), `information` (f, f), `score` (f,), `is_fixed` (f,), `per_flight` (flights, k).
    """
    precision = 1.0 / parameter_vector.std**2
    matrix = information + np.diag((1.0 + damping) * precision)
    gradient = score + precision * (parameter_vector.mean - theta)
    limits = [bound - theta for bound in parameter_vector.bounds]
    if is_fixed is not None:
        limits = [np.where(is_fixed, 0.0, limit) for limit in limits]
    low, high = limits
    move = bounded_solve(matrix, gradient, low, high, per_flight)
    promised_nats = float(move @ (gradient - 0.5 * (matrix @ move)))
    return PosteriorStep(move, invert_arrowhead(matrix, per_flight), promised_nats)
