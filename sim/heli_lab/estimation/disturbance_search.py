"""Search for the disturbances of largest likelihood: Newton's method in the logarithms of their numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np
from heli_host.arrays import Booleans, Floats, Integers

from heli_lab.estimation.disturbances import DisturbanceModel, SLOW_CORRELATION_TIME_s

# Bounds of the search: far outside of what flights show.
_CORRELATION_TIME_RANGE_s: Final = (0.03, 5.0)
_QUANTISATION_RANGE: Final = (0.02, 4.0)
_GAIN_STD_RANGE: Final = (1e-4, 0.3)
_GAIN_CORRELATION_TIME_RANGE_s: Final = (0.03, SLOW_CORRELATION_TIME_s)

_DIFFERENCE: Final = 0.03
"""Change of a logarithm by which the likelihood is differentiated: 3 % of each number."""
_LONGEST_MOVE: Final = 1.2
"""Most that a logarithm moves at once."""
_FLAT: Final = 0.5
"""Least curvature, nats for a change by the factor e, that a step trusts: below it the number is open."""
_SHARES: Final = (1.0, 0.4, 0.16, 0.06)
"""Shares of a move that are tried together, the longest that gains enough is taken."""
_MOVES: Final = 25
_CONVERGED_NATS: Final = 0.02
"""Gain, nats, that no decision notices: those that are closest differ by tenths."""


@dataclass(frozen=True)
class _Group:
    """Disturbances that move the innovations of different outputs: they are differentiated together.

    Parameters
    ----------
    parameters : ndarray (k, n)
        Places of the n parameters of each disturbance in the vector of all logarithms.
    moved : ndarray of bool (k, m)
        Outputs whose innovations each disturbance moves.
    """

    parameters: Integers
    moved: Booleans

    def likelihoods(self, values: Floats) -> Floats:
        """Log-likelihood of the innovations that each disturbance moves, shape (k,), from those of each
        output, `values`, shape (m,).
        """
        by_disturbance = np.broadcast_to(values, self.moved.shape)
        result: Floats = by_disturbance.sum(axis=1, where=self.moved)
        return result


class _Likelihood:
    """Log-likelihood of the innovations by the logarithms of the parameters, differentiated numerically.

    The disturbance of one output hardly moves the innovations of another: a gradient by those of all outputs
    costs four evaluations. The disturbance of a gain moves all innovations: it costs two.
    """

    def __init__(
        self,
        value: Callable[[Sequence[DisturbanceModel]], Floats],
        start: DisturbanceModel,
        std_range: tuple[float, float],
    ) -> None:
        self._value, self._start = value, start
        outputs, gains = len(start.fast_std), len(start.gains)
        of_output = (std_range, _CORRELATION_TIME_RANGE_s, std_range, _QUANTISATION_RANGE)
        of_gain = (_GAIN_STD_RANGE, _GAIN_CORRELATION_TIME_RANGE_s)
        self.low, self.high = np.log([*of_output * outputs, *of_gain * gains]).T
        by_output, by_gain = np.split(np.arange(len(self.low)), [4 * outputs])
        self.groups = [
            _Group(by_output.reshape(-1, 4), np.eye(outputs, dtype=bool)),
            *(_Group(pair[None], np.ones((1, outputs), bool)) for pair in by_gain.reshape(-1, 2)),
        ]

    def at(self, *points: Floats) -> Floats:
        """Log-likelihood of each output's innovations at each of some points, shape (w, m)."""
        return self._value([self._start.with_logarithms(self.inside(point)) for point in points])

    def inside(self, point: Floats) -> Floats:
        result: Floats = np.clip(point, self.low, self.high)
        return result

    def gradient(self, point: Floats, now: Floats) -> Floats:
        """Derivatives by the logarithms, shape of `point`; 0 at a bound from which they lead outside. The
        values at the point are known: `now`, shape (m,).
        """
        steps = np.where(point > self.high - _DIFFERENCE, -_DIFFERENCE, _DIFFERENCE)
        places = [(group, column) for group in self.groups for column in group.parameters.T]
        changed = self.at(*(_shifted(point, column, steps[column]) for _, column in places))
        gradient = np.zeros(len(point))
        for (group, column), values in zip(places, changed, strict=True):
            gradient[column] = (group.likelihoods(values) - group.likelihoods(now)) / steps[column]
        gradient[(point <= self.low + 1e-9) & (gradient < 0.0)] = 0.0
        gradient[(point >= self.high - 1e-9) & (gradient > 0.0)] = 0.0
        return gradient

    def curvature(self, point: Floats) -> tuple[Floats, Floats]:
        """Values at a point, shape (m,), and the negative second derivatives near it by the logarithms of
        each disturbance, shape (f, f).
        """
        h = 3 * _DIFFERENCE
        inside = np.clip(point, self.low + h, self.high - h)
        points = [point, inside]
        for group in self.groups:
            columns = group.parameters.T
            points += [_shifted(inside, column, h) for column in columns]
            points += [_shifted(inside, column, -h) for column in columns]
            points += [
                _shifted(_shifted(inside, first, h), second, h) for first, second in combinations(columns, 2)
            ]
        now, centre, *others = self.at(*points)
        rest = iter(others)
        result = np.zeros((len(point), len(point)))
        for group in self.groups:
            columns, middle = group.parameters.T, group.likelihoods(centre)
            up = [group.likelihoods(next(rest)) for _ in columns]
            down = [group.likelihoods(next(rest)) for _ in columns]
            for i, column in enumerate(columns):
                result[column, column] = -(up[i] - 2 * middle + down[i]) / h**2
            for i, j in combinations(range(len(columns)), 2):
                # A forward difference of second order carries third derivatives; diagonals are exact to them.
                mixed = -(group.likelihoods(next(rest)) - up[i] - up[j] + middle) / h**2
                result[columns[i], columns[j]] = result[columns[j], columns[i]] = mixed
        return now, result

    def newton_move(self, gradient: Floats, curvature: Floats) -> Floats:
        """Newton's move, shape of `gradient`, disturbance by disturbance; a logarithm whose derivative is 0
        stays.
        """
        move = np.zeros(len(gradient))
        for group in self.groups:
            for parameters in group.parameters:
                free = parameters[gradient[parameters] != 0.0]
                if len(free):
                    move[free] = _newton(gradient[free], curvature[np.ix_(free, free)])
        return move


def maximise(
    value: Callable[[Sequence[DisturbanceModel]], Floats],
    start: DisturbanceModel,
    std_range: tuple[float, float],
    enough_nats: float = _CONVERGED_NATS,
    known: Floats | None = None,
) -> DisturbanceModel:
    """Maximise a likelihood over the disturbances by Newton's method with backtracking; the sum over outputs
    decides whether a step counts.

    Parameters
    ----------
    value : callable
        Log-likelihood of each output's innovations under each of some disturbances, nats, shape (w, m); four
        cost little more than one.
    start : DisturbanceModel
        Where to begin; its curvature is used where it has one.
    std_range : (float, float)
        Bounds of the standard deviations, in the unit of the disturbed parameters.
    enough_nats : float
        Gain that one more step may promise, or bring, before the search ends.
    known : ndarray (m,), optional
        Values of the outputs at `start`, where they are known.
    """
    likelihood = _Likelihood(value, start, std_range)
    point, curvature = likelihood.inside(start.logarithms), start.curvature
    fresh = curvature is None
    if curvature is None:
        now, curvature = likelihood.curvature(point)
    else:
        now = likelihood.at(point)[0] if known is None else known
    for _ in range(_MOVES):
        gradient = likelihood.gradient(point, now)
        move = likelihood.newton_move(gradient, curvature)
        promised = 0.5 * float(gradient @ move)
        if promised < enough_nats:
            break
        tried = likelihood.at(*(point + share * move for share in _SHARES))
        gains = tried.sum(axis=1) - now.sum()
        good = [i for i, share in enumerate(_SHARES) if gains[i] > 0.1 * share * promised]
        if not good:
            if fresh:
                break
            now, curvature = likelihood.curvature(point)
            fresh = True
            continue
        share, gained = _SHARES[good[0]], gains[good[0]]
        point, now = likelihood.inside(point + share * move), tried[good[0]]
        if gained < enough_nats:
            break
        fresh = share < 1.0 or bool(np.abs(move).max() > 0.5)
        if fresh:
            now, curvature = likelihood.curvature(point)
    return start.with_logarithms(point, curvature)


def _shifted(point: Floats, places: Integers, by: float | Floats) -> Floats:
    result = point.copy()
    result[places] += by
    return result


def _newton(gradient: Floats, curvature: Floats) -> Floats:
    values, vectors = np.linalg.eigh(curvature)
    move: Floats = vectors @ ((vectors.T @ gradient) / np.maximum(np.abs(values), _FLAT))
    longest = float(np.abs(move).max())
    return move * min(1.0, _LONGEST_MOVE / max(longest, 1e-12))
