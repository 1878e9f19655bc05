"""Cost of a design, and its minimisation over positive gains."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
from heli_host.arrays import Floats

from heli_lab.tune.plants import LinearPlant

MIN_DECAY_1_s: Final = 0.02
"""Smallest decay rate of a closed loop; slower loops count as unstable."""
UNSTABLE_COST: Final = 1e3
"""Cost of an unstable loop, plus its slowest pole: far above any other cost."""
_BOUND_WEIGHT: Final = 30.0
_OTHER_LAGS_s: Final = 0.03
"""Lag of a loop in addition to that of the rotors [s], for the start values of the gains."""


def count_nominal(plants: Sequence[LinearPlant]) -> int:
    """Number of plants without a deviation from the rig file; they come first."""
    return sum(plant.thrust == 1.0 and plant.counterweight == 1.0 for plant in plants)


def initial_crossover_rad_s(plants: Sequence[LinearPlant]) -> float:
    """Crossover frequency of a double integrator with the longest lag, by the symmetrical optimum.

    It is only the start of a minimisation, so its factor of 2.2 is not critical; the textbook has 2.
    """
    longest_lag_s = max(plant.lag_s for plant in plants) + _OTHER_LAGS_s
    return 1.0 / (2.2 * longest_lag_s)


def slowest_pole_1_s(closed: Floats) -> float:
    """Largest real part of the poles of all `closed` loops, state matrices of shape (plants, n, n) [1/s]."""
    return float(np.linalg.eigvals(closed).real.max())


def log_cost(squares: Floats, nominal_count: int) -> float:
    """Cost of the mean squared errors of all plants, `squares`, shape (plants,): mean of two logarithms, that
    of the first `nominal_count` plants and that of the corners.
    """
    return float(0.5 * (np.log(squares[:nominal_count].mean()) + np.log(squares[nominal_count:].mean())))


def bound_penalty(peak: float, bound: float) -> float:
    """Cost of a `peak` above its `bound`; 0 below."""
    return _BOUND_WEIGHT * max(0.0, float(np.log(peak / bound)))


def minimise_positive(cost: Callable[[Floats], float], start: Floats) -> Floats:
    """Find positive gains of the lowest `cost`, shape (k,): Nelder-Mead in their logarithms from `start`,
    shape (k,). The search is restarted with a new simplex, because a shrunken one can get stuck, until
    the cost falls by less than 0.01: errors by 0.5 %.
    """
    from scipy.optimize import minimize

    best, best_cost = np.log(start), np.inf
    options: dict[str, Any] = {"xatol": 3e-3, "fatol": 1e-3, "maxiter": 300, "adaptive": True}
    for simplex_size in (0.4, 0.3, 0.2, 0.2):
        options["initial_simplex"] = np.vstack([best, best + simplex_size * np.eye(len(best))])
        optimum = minimize(lambda logs: cost(np.exp(logs)), best, method="Nelder-Mead", options=options)
        improvement = best_cost - optimum.fun
        best, best_cost = optimum.x, optimum.fun
        if improvement < 0.01:
            break
    return np.asarray(np.exp(best), float)
