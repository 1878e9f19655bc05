"""Standard errors under quantisation, and combinations of parameters that a flight cannot identify."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from heli_host.arrays import Floats

from heli_lab.identify.estimation_problem import Problem
from heli_lab.identify.thresholds import COMBINATION_WEIGHT, DITHER_PHASES, UNINFORMED


def quantisation_scatter(
    problem: Problem,
    theta: Floats,
    states: Sequence[Floats],
    variance: Sequence[Floats],
    weights: Sequence[Floats],
    covariance: Floats,
) -> Floats:
    """Standard deviation of each estimate due to quantisation and priors, shape (f,), by dither.

    Quantisation errors are not white noise: while an axis hovers, the same count stays for seconds, and its
    error is the same in every window. Therefore the predicted angles are quantised again with the counts
    shifted by random phases, and the estimates' scatter under these errors is computed to first order.

    Parameters
    ----------
    theta : ndarray (f,)
        Free parameters.
    states : sequence of ndarray (w, states)
        Initial states.
    variance, weights : sequence of ndarray
        As in `Fit`.
    covariance : ndarray (f, f)
        Covariance of the estimates.
    """
    random = np.random.default_rng(0)
    scores = np.zeros((DITHER_PHASES, len(theta)))
    state_count = problem.state_count
    for index, record in enumerate(problem.records):
        grid = problem.grid(index, True, theta)
        parameters = problem.parameters(theta, index)
        angles_rad, jacobian = problem.kernel.jacobian(grid.inputs, states[index], parameters)
        counts = angles_rad / record.count_rad
        phases = random.uniform(0.0, 1.0, (DITHER_PHASES, 1, 3))
        for window, part in enumerate(grid.slices):
            shifted = counts[None, part] + phases
            errors = (np.round(shifted) - shifted) * math.sqrt(12.0)
            scale = np.sqrt(weights[index][window] / variance[index])[:, None]
            rows = jacobian[part] / record.sigma_rad[:, None] * scale
            # Not a product of matrices: threads of the linear algebra cost more here than they save.
            normal = np.einsum("tai,taj->ij", rows[:, :, :state_count], rows)
            gradient = np.einsum("pta,tai->pi", errors * scale[:, 0], rows)
            # The initial state of the window is eliminated.
            response = np.linalg.pinv(normal[:, :state_count], hermitian=True) @ normal[:, state_count:]
            score = gradient[:, state_count:] - gradient[:, :state_count] @ response
            scores[:, problem.columns[index]] += score
    prior_information = np.diag(1.0 / problem.parameter_vector.std**2)
    scatter = covariance @ (scores.T @ scores / DITHER_PHASES + prior_information) @ covariance
    return np.sqrt(np.diag(scatter))


def timing_variance(problem: Problem) -> Floats:
    """Variance to add to estimated times, shape (f,) [s^2]: a log does not state when within a tick the
    voltages began. For effect parameters in s it is that of a uniform distribution over a tick; otherwise 0.

    A row holds the voltage of its tick, not the moment within the tick at which the motors got it. Simulators
    differ in this by half a tick, as do explicit and exact steps of a lag, and a fit finds the time to a
    fiftieth of a tick.
    """
    effect_names = {name for effect in problem.model.effects for name in effect.priors}
    tick_s = max(record.step_s for record in problem.records)
    is_time = [parameter.unit == "s" and parameter.quantity in effect_names for parameter in problem.free]
    return np.where(is_time, tick_s**2 / 12.0, 0.0)


@dataclass(frozen=True)
class Combination:
    """A direction in parameter space that the flights hardly identify.

    Parameters
    ----------
    change : dict of float
        Change of each parameter that takes part, one posterior standard deviation of the combination, in the
        parameter's unit; the largest first.
    std_over_prior : float
        Posterior standard deviation of the combination over its prior one; 1 without any information.
    """

    change: dict[str, float]
    std_over_prior: float


def combinations(names: Sequence[str], information: Floats, prior_std: Floats) -> list[Combination]:
    """Find the combinations of parameters that the flights determine worse than the priors, worst first.
    Directions along a single parameter are among them.

    Parameters
    ----------
    names : sequence of str
        Names of the free parameters.
    information : ndarray (f, f)
        Fisher information of the flights alone.
    prior_std : ndarray (f,)
        Standard deviations of the priors.
    """
    whitened = information * np.outer(prior_std, prior_std)
    strength, directions = np.linalg.eigh(0.5 * (whitened + whitened.T))
    result = []
    for value, direction in zip(np.maximum(strength, 0.0), directions.T, strict=True):
        if value >= 1.0:
            break
        shrunk = 1.0 / math.sqrt(1.0 + value)
        size = np.abs(direction)
        order = [i for i in np.argsort(-size) if size[i] >= COMBINATION_WEIGHT * size.max()]
        sign = math.copysign(1.0, direction[order[0]])
        change = {names[i]: float(sign * direction[i] * prior_std[i] * shrunk) for i in order}
        result.append(Combination(change, shrunk))
    return result


def uninformed_parameters(names: Sequence[str], covariance: Floats, prior_std: Floats) -> list[str]:
    """Names of the parameters that the flights do not inform: the standard error is over 90 % of the prior's
    standard deviation.

    Parameters
    ----------
    names : sequence of str
        Names of the free parameters.
    covariance : ndarray (f, f)
        Covariance of the estimates.
    prior_std : ndarray (f,)
        Standard deviations of the priors.
    """
    shares = np.sqrt(np.diag(covariance)) / prior_std
    return [name for name, share in zip(names, shares, strict=True) if share > UNINFORMED]
