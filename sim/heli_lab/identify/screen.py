"""Rao's score test of candidate parameters: one prediction scores any number of them.

Candidates are effects of an extended model, each at a value at which it does nothing or next to nothing. The
derivatives of the prediction to their parameters, with the baseline's parameters and the initial states
projected out, give to first order how much each would lower the sum of squares, and its estimate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from heli_lab.errors import IdentifyError
from heli_lab.identify.fit import Fit
from heli_lab.identify.initial_states import first_states
from heli_lab.identify.problem import Problem
from heli_lab.identify.schur import eliminate, eliminate_states


@dataclass(frozen=True)
class Score:
    """Score statistic of one candidate, or of several together.

    Parameters
    ----------
    names : tuple of str
        Parameters that are freed.
    gain : float
        Drop of the weighted sum of squares, to first order; chi-square with one degree of freedom a parameter
        when the candidate is absent.
    change : tuple of float
        Change of each parameter from its present value that gives this gain.
    std : tuple of float
        Standard error of each.
    """

    names: tuple[str, ...]
    gain: float
    change: tuple[float, ...]
    std: tuple[float, ...]


def screen(fit: Fit, extended: Problem, groups: Sequence[Sequence[str]]) -> list[Score]:
    """Score candidates against a fitted baseline.

    Parameters
    ----------
    extended : Problem
        The same flights and windows with the baseline's free parameters and those of all candidates; its
        start values are the ones at which the candidates do nothing.
    groups : sequence of sequence of str
        Candidates: the free parameters of each.

    Returns
    -------
    list of Score
        One for each group, in the order given.

    Raises
    ------
    IdentifyError
        When the extended problem lacks a parameter.
    """
    known = set(extended.names)
    missing = sorted({name for group in groups for name in group if name not in known})
    if missing:
        raise IdentifyError(f"the extended model does not free {', '.join(missing)}")
    theta = extended.start
    for index, name in enumerate(extended.names):
        theta[index] = fit.values.get(name, theta[index])
    states = first_states(extended, theta)
    for own, old in zip(states, fit.states, strict=True):
        own[:, : old.shape[1]] = old
    evaluations = [extended.evaluation(index, theta, start) for index, start in enumerate(states)]
    information, gradient, _ = eliminate_states(
        extended, evaluations, states, states, fit.variance, fit.weights
    )
    places = {name: index for index, name in enumerate(extended.names)}
    base = np.array([places[name] for name in fit.problem.names], int)
    prior = np.array([extended.free[i].prior.std for i in base]) ** -2.0
    pull = prior * (np.array([extended.free[i].prior.mean for i in base]) - theta[base])
    scores = []
    for group in groups:
        freed = np.array([places[name] for name in group])
        order = np.concatenate((base, freed))
        system = np.zeros((len(order) + 1, len(order) + 1))
        system[:-1, :-1] = information[np.ix_(order, order)]
        system[:-1, -1] = system[-1, :-1] = gradient[order]
        system[: len(base), : len(base)] += np.diag(prior)
        system[: len(base), -1] += pull
        system[-1, : len(base)] += pull
        complement, _ = eliminate(system, len(base))
        left, right = complement[:-1, :-1], complement[:-1, -1]
        # A candidate that the flight does not excite has no information: it gains nothing.
        inverse = np.linalg.pinv(left, rcond=1e-10, hermitian=True)
        change = inverse @ right
        std = np.sqrt(np.maximum(np.diag(inverse), 0.0))
        scores.append(
            Score(tuple(group), float(right @ change), tuple(map(float, change)), tuple(map(float, std)))
        )
    return scores
