"""How sure the estimates are, and what a flight cannot tell apart."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from heli_lab.identify.functions import Floats
from heli_lab.identify.problem import Problem

_PHASES: Final = 24
_LEARNED: Final = 0.9
"""A flight that leaves more than this share of the prior's standard deviation has taught nothing."""
_WEIGHT: Final = 0.25
"""Smallest part that a parameter takes in a combination, of the largest."""


def quantisation_scatter(
    problem: Problem,
    theta: Floats,
    states: Sequence[Floats],
    variance: Sequence[Floats],
    weights: Sequence[Floats],
    covariance: Floats,
) -> Floats:
    """Scatter of the estimates when the encoders' counts fall elsewhere.

    Rounding is no noise: while an axis hovers, the same count stays for seconds, and its error is the same in
    every window. So the predicted angles are rounded again with the counts shifted by random phases, and
    the estimates' scatter under these errors is computed to first order.

    Parameters
    ----------
    problem : Problem
        What was fitted.
    theta : ndarray (f,)
        Free parameters.
    states : sequence of ndarray (w, states)
        Initial states.
    variance, weights : sequence of ndarray
        As in `Fit`.
    covariance : ndarray (f, f)
        Covariance of the estimates.

    Returns
    -------
    ndarray (f,)
        Standard deviation of each estimate under rounding and priors.
    """
    random = np.random.default_rng(0)
    scores = np.zeros((_PHASES, len(theta)))
    nx = problem.state_count
    for index, record in enumerate(problem.records):
        residual, jacobian = problem.jacobian(index, theta, states[index], fine=True)
        grid = problem.grid(index, True, theta)
        counts = (grid.measured_rad - residual * record.sigma_rad) / record.count_rad
        phases = random.uniform(0.0, 1.0, (_PHASES, 1, 3))
        for window, part in enumerate(grid.slices):
            shifted = counts[None, part] + phases
            errors = (np.round(shifted) - shifted) * math.sqrt(12.0)
            scale = np.sqrt(weights[index][window] / variance[index])[:, None]
            rows = jacobian[part] * scale
            # Not a product of matrices: threads of the linear algebra cost more here than they save.
            normal = np.einsum("tai,taj->ij", rows[:, :, :nx], rows)
            pulls = np.einsum("pta,tai->pi", errors * scale[:, 0], rows)
            follow = np.linalg.pinv(normal[:, :nx], hermitian=True) @ normal[:, nx:]
            scores[:, problem.columns[index]] += pulls[:, nx:] - pulls[:, :nx] @ follow
    prior = np.diag(1.0 / problem.prior_std**2)
    spread = covariance @ (scores.T @ scores / _PHASES + prior) @ covariance
    result: Floats = np.sqrt(np.diag(spread))
    return result


def timing_variance(problem: Problem) -> Floats:
    """Variance of times that are counted from the voltages, because a log does not say when these began.

    A row holds the voltage of its tick, not the moment within the tick at which the motors got it. Simulators
    differ in this by half a tick, as do explicit and exact steps of a lag, and a fit finds the time to a
    fiftieth of a tick.

    Parameters
    ----------
    problem : Problem
        What is fitted.

    Returns
    -------
    ndarray (f,)
        That of a moment anywhere in a tick, for parameters of effects in s; 0 for all others.
    """
    own = {name for effect in problem.model.effects for name in effect.priors}
    tick_s = max(record.step_s for record in problem.records)
    late = [one.unit == "s" and one.quantity in own for one in problem.free]
    result: Floats = np.where(late, tick_s**2 / 12.0, 0.0)
    return result


@dataclass(frozen=True)
class Combination:
    """A direction in which the parameters may move together without the flight noticing.

    Parameters
    ----------
    change : dict of float
        Change of each parameter that takes part, one posterior standard deviation of the combination, in the
        parameter's unit; the largest first.
    kept : float
        Standard deviation of the combination over what it was before the flight: 1 when nothing was learned.
    """

    change: dict[str, float]
    kept: float


def combinations(names: Sequence[str], information: Floats, prior_std: Floats) -> list[Combination]:
    """Find what a flight cannot tell apart.

    Parameters
    ----------
    names : sequence of str
        Names of the free parameters.
    information : ndarray (f, f)
        Inverse covariance from the flights alone.
    prior_std : ndarray (f,)
        Standard deviations of the priors.

    Returns
    -------
    list of Combination
        Directions about which the flights say less than the priors, worst first. Directions along a
        single parameter are among them.
    """
    whitened = information * np.outer(prior_std, prior_std)
    strength, directions = np.linalg.eigh(0.5 * (whitened + whitened.T))
    found = []
    for value, direction in zip(np.maximum(strength, 0.0), directions.T, strict=True):
        if value >= 1.0:
            break
        kept = 1.0 / math.sqrt(1.0 + value)
        size = np.abs(direction)
        order = [i for i in np.argsort(-size) if size[i] >= _WEIGHT * size.max()]
        sign = math.copysign(1.0, direction[order[0]])
        change = {names[i]: float(sign * direction[i] * prior_std[i] * kept) for i in order}
        found.append(Combination(change, kept))
    return found


def uninformed_parameters(names: Sequence[str], covariance: Floats, prior_std: Floats) -> list[str]:
    """Parameters about which the flights said nothing of their own.

    Parameters
    ----------
    names : sequence of str
        Names of the free parameters.
    covariance : ndarray (f, f)
        Covariance of the estimates.
    prior_std : ndarray (f,)
        Standard deviations of the priors.

    Returns
    -------
    list of str
        Names whose standard error is over 90 % of the prior's standard deviation.
    """
    kept = np.sqrt(np.diag(covariance)) / prior_std
    return [name for name, share in zip(names, kept, strict=True) if share > _LEARNED]
