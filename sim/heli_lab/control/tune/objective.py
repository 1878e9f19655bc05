"""Parts of the cost of a design, and the minimisation of a cost over positive gains."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
from heli_host.data.arrays import Floats

from heli_lab.control.tune.plants import LinearPlant

MIN_DECAY_1_s: Final = 0.02
"""Smallest decay rate of a closed loop; slower loops count as unstable."""
UNSTABLE_COST: Final = 1e3
"""Cost of an unstable loop, far above any other cost; its slowest pole is added."""
_BOUND_WEIGHT: Final = 30.0
"""Cost of exceeding a bound by the factor e."""
_OTHER_LAGS_s: Final = 0.03
"""Lag of a loop in addition to that of the rotors [s], for the start values of the gains."""


def count_nominal(plants: Sequence[LinearPlant]) -> int:
    """Count the plants without a deviation from the rig file, which are the first ones of the sequence."""
    return sum(plant.thrust == 1.0 and plant.counterweight == 1.0 for plant in plants)


def initial_crossover_rad_s(plants: Sequence[LinearPlant]) -> float:
    """Choose a crossover frequency for a double integrator with the longest lag, by the symmetrical optimum.

    The result is only the start of a minimisation, so that the factor of 2.2 is not critical; the textbook
    has 2.
    """
    longest_lag_s = max(plant.lag_s for plant in plants) + _OTHER_LAGS_s
    return 1.0 / (2.2 * longest_lag_s)


def slowest_pole_1_s(closed: Floats) -> float:
    """Return the largest real part of all poles [1/s] of closed loops with the state matrices `closed`, shape
    (plants, n, n).
    """
    return float(np.linalg.eigvals(closed).real.max())


def log_cost(squares: Floats, nominal_count: int) -> float:
    """Combine the mean squared errors of all plants into one cost. Shapes: `squares` (plants,).

    The cost is the mean of two logarithms: that of the nominal plants' mean, and that of the corners' mean.
    """
    return float(0.5 * (np.log(squares[:nominal_count].mean()) + np.log(squares[nominal_count:].mean())))


def bound_penalty(peak: float, bound: float) -> float:
    """Return the cost of a `peak` that exceeds its `bound`; 0 if it does not."""
    return _BOUND_WEIGHT * max(0.0, float(np.log(peak / bound)))


def minimise_positive(cost: Callable[[Floats], float], start: Floats) -> Floats:
    """Find the positive gains with the lowest cost, by the Nelder-Mead method in their logarithms. Shapes:
    `start` (k,).

    The search is restarted with a new simplex, because a small simplex can get stuck. It ends when the cost
    falls by less than 0.01, which means that errors fall by less than 0.5 %.
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
