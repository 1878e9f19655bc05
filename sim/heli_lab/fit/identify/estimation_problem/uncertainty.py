"""Standard errors under quantisation, and combinations of parameters that a flight cannot identify."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from heli_host.data.arrays import Floats

from heli_lab.fit.identify.estimation_problem import Problem
from heli_lab.fit.identify.thresholds import COMBINATION_WEIGHT, DITHER_PHASES, UNINFORMED


def quantisation_scatter(
    problem: Problem,
    theta: Floats,
    states: Sequence[Floats],
    variance: Sequence[Floats],
    weights: Sequence[Floats],
    covariance: Floats,
) -> Floats:
    """Simulate how quantisation scatters the estimates, by dither; return standard deviations, shape (f,).
    Shapes: `theta` (f,), `states` (w, states), `covariance` (f, f).

    Quantisation errors are not white noise: while an axis hovers, the same count stays for seconds, and its
    error is the same in every window. Therefore the predicted angles are quantised again, many times, with
    the counts shifted by random phases. The scatter of the estimates under these errors is computed to first
    order, and that of the priors is added.
    """
    random = np.random.default_rng(0)
    scores = np.zeros((DITHER_PHASES, len(theta)))
    state_count = problem.state_count
    for index, record in enumerate(problem.records):
        grid = problem.grid(index, fine=True, theta=theta)
        parameters = problem.parameters(theta, index)
        angles_rad, jacobian = problem.kernel.jacobian(grid.inputs, states[index], parameters)
        counts = angles_rad / record.count_rad
        phases = random.uniform(0.0, 1.0, (DITHER_PHASES, 1, 3))
        for window, steps in enumerate(grid.slices):
            # Quantisation errors in their standard deviations, shape (phases, steps, 3).
            shifted = counts[None, steps] + phases
            errors = (np.round(shifted) - shifted) * math.sqrt(12.0)
            scale = np.sqrt(weights[index][window] / variance[index])[:, None]
            weighted_jacobian = jacobian[steps] / record.sigma_rad[:, None] * scale
            # Indices: phase p, step t, axis a, columns i and j of the Jacobian. A product of matrices would
            # start threads of the linear algebra, which cost more here than they save.
            normal = np.einsum("tai,taj->ij", weighted_jacobian[:, :, :state_count], weighted_jacobian)
            gradient = np.einsum("pta,tai->pi", errors * scale[:, 0], weighted_jacobian)
            # Eliminate the initial state of the window (Schur complement).
            response = np.linalg.pinv(normal[:, :state_count], hermitian=True) @ normal[:, state_count:]
            score = gradient[:, state_count:] - gradient[:, :state_count] @ response
            scores[:, problem.columns[index]] += score
    prior_information = np.diag(1.0 / problem.parameter_vector.std**2)
    scatter = covariance @ (scores.T @ scores / DITHER_PHASES + prior_information) @ covariance
    return np.sqrt(np.diag(scatter))


def timing_variance(problem: Problem) -> Floats:
    """Return the variance to add to each estimated time, such as a lag, because of the log's sample time.
    Returns shape (f,).

    A row of a log holds the voltage of its tick, but not the moment within the tick at which the motors got
    it. Simulators differ in this moment by half a tick, while a fit finds the time to a fiftieth of a tick:
    its standard error alone would be too small.
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
        By parameter: its change if the combination changes by one posterior standard deviation, in the
        parameter's unit. The parameter with the largest change comes first; those that hardly change are
        left out.
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
    # In units of the priors' standard deviations, a prior has the information 1 in every direction.
    whitened = information * np.outer(prior_std, prior_std)
    informations, directions = np.linalg.eigh(0.5 * (whitened + whitened.T))
    result = []
    for flight_information, direction in zip(np.maximum(informations, 0.0), directions.T, strict=True):
        if flight_information >= 1.0:
            break
        std_over_prior = 1.0 / math.sqrt(1.0 + flight_information)
        size = np.abs(direction)
        order = [i for i in np.argsort(-size) if size[i] >= COMBINATION_WEIGHT * size.max()]
        # The first parameter increases; an eigenvector has either sign.
        sign = math.copysign(1.0, direction[order[0]])
        change = {names[i]: float(sign * direction[i] * prior_std[i] * std_over_prior) for i in order}
        result.append(Combination(change, std_over_prior))
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
