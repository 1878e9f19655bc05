"""Parts of the cost of gains, and its minimisation over positive gains."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from heli_host.arrays import Floats

from heli_lab.tune.plants import LinearPlant

_BOUND_WEIGHT: Final = 30.0


def count_nominal(plants: Sequence[LinearPlant]) -> int:
    """Count the plants with the thrust and the counterweight of the rig."""
    return sum(plant.thrust == 1.0 and plant.counterweight == 1.0 for plant in plants)


def initial_crossover_rad_s(plants: Sequence[LinearPlant]) -> float:
    """Return the crossover frequency of a double integrator with the longest lag of the `plants`, by the
    symmetrical optimum.
    """
    return 1.0 / (2.2 * (max(plant.lag_s for plant in plants) + 0.03))


def slowest_rate_1_s(closed: Floats) -> float:
    """Return the largest real part of the eigenvalues of a state matrix, `closed`; negative if stable."""
    return float(np.linalg.eigvals(closed).real.max())


def log_cost(squares: Floats, nominal_count: int) -> float:
    """Return the mean of two logarithms: of the squared error of the nominal plants, and of the corners'.

    Parameters
    ----------
    squares : ndarray (n,)
        Squared error of each plant, the nominal ones first.
    nominal_count : int
        Number of nominal plants.
    """
    return float(0.5 * (np.log(squares[:nominal_count].mean()) + np.log(squares[nominal_count:].mean())))


def bound_penalty(peak: float, bound: float) -> float:
    """Return the cost of a `peak` above its `bound`, both without unit; 0 below it."""
    return _BOUND_WEIGHT * max(0.0, float(np.log(peak / bound)))


def minimise_gains(cost: Callable[[Floats], float], start: Floats) -> Floats:
    """Minimise a cost over positive gains; restart Nelder-Mead until the cost falls by less than 0.01.

    Parameters
    ----------
    cost : callable taking ndarray (n,), returning float
        Cost of some gains.
    start : ndarray (n,)
        Gains to start with.

    Returns
    -------
    ndarray (n,)
        The best gains.
    """
    from scipy.optimize import minimize

    best, best_cost = np.log(start), np.inf
    for spread in (0.4, 0.3, 0.2, 0.2):
        simplex = np.vstack([best, *(best + spread * row for row in np.eye(len(best)))])
        optimum = minimize(
            lambda logs: cost(np.exp(logs)),
            best,
            method="Nelder-Mead",
            options={
                "initial_simplex": simplex,
                "xatol": 3e-3,
                "fatol": 1e-3,
                "maxiter": 300,
                "adaptive": True,
            },
        )
        improvement = best_cost - optimum.fun
        best, best_cost = optimum.x, optimum.fun
        if improvement < 0.01:
            break
    return np.asarray(np.exp(best), float)
