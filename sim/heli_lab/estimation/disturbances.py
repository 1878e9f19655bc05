"""Disturbances: random forces on a machine as Gauss-Markov states of the filter, and their estimation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from heli_host.arrays import Floats

SLOW_CORRELATION_TIME_s: Final = 15.0
"""Correlation time of the slow disturbance. Set, because a recording of a minute does not show it: a quarter
of one. Longer: a constant of each flight says the same. Shorter: the fast disturbance says the same."""

START_CORRELATION_TIME_s: Final = 0.5
START_QUANTISATION: Final = 0.6
"""Where a search begins, by judgement: the middle of what flights show. Far from it a search takes longer."""
# Bounds of the search: far outside of what flights show.
_MIN_CORRELATION_TIME_s, _MAX_CORRELATION_TIME_s = 0.03, 5.0
_MIN_QUANTISATION, _MAX_QUANTISATION = 0.02, 4.0

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
class DisturbanceModel:
    """For each of m outputs a fast and a slow first-order Gauss-Markov disturbance, and the sensor's noise.

    Parameters
    ----------
    fast_std : ndarray (m,)
        Stationary standard deviation of the fast disturbance, in the unit of the disturbed parameter.
    correlation_time_s : ndarray (m,)
        Time over which the autocorrelation of the fast disturbance falls to 1/e.
    slow_std : ndarray (m,)
        Stationary standard deviation of the slow disturbance, whose correlation time is
        `SLOW_CORRELATION_TIME_s`.
    quantisation : ndarray (m,)
        Variance of the output's error over that of independent, uniform rounding errors.
    curvature : ndarray (m, 4, 4) or None
        Curvature of the log-likelihood at the estimate, by the logarithms of each output's four parameters.
    """

    fast_std: Floats
    correlation_time_s: Floats
    slow_std: Floats
    quantisation: Floats
    curvature: Floats | None = None

    @classmethod
    def start(cls, fast_std: Sequence[float], slow_std: Sequence[float]) -> DisturbanceModel:
        """Return the disturbances from which a search starts.

        Parameters
        ----------
        fast_std, slow_std : sequence of float
            Standard deviations of the m disturbances, in the unit of the disturbed parameters.
        """
        size = len(fast_std)
        return cls(
            np.array(fast_std, float),
            np.full(size, START_CORRELATION_TIME_s),
            np.array(slow_std, float),
            np.full(size, START_QUANTISATION),
        )

    @classmethod
    def from_point(cls, point: Floats) -> DisturbanceModel:
        """Return the disturbances of a `point` of the search: the logarithms of all parameters, shape (m, 4),
        one row per output.
        """
        fast_std, correlation_time_s, slow_std, quantisation = np.exp(point).T
        return cls(fast_std, correlation_time_s, slow_std, quantisation)

    @property
    def point(self) -> Floats:
        """Logarithms of all parameters, shape (m, 4), one row per output."""
        result: Floats = np.log(
            np.stack((self.fast_std, self.correlation_time_s, self.slow_std, self.quantisation), axis=1)
        )
        return result

    def memory(self, step_s: float) -> Floats:
        """Autocorrelation of each disturbance over a step of `step_s`, the fast ones first, shape (2 m,)."""
        slow_s = np.full(len(self.fast_std), SLOW_CORRELATION_TIME_s)
        result: Floats = np.exp(-step_s / np.concatenate((self.correlation_time_s, slow_s)))
        return result

    @property
    def variance(self) -> Floats:
        """Stationary variance of each disturbance, the fast ones first, shape (2 m,)."""
        result: Floats = np.concatenate((self.fast_std, self.slow_std)) ** 2
        return result


class _Likelihood:
    """Log-likelihood of the innovations of each output by points of the search, differentiated numerically.

    The disturbance of one output hardly touches the innovations of another, so that all outputs are
    differentiated at once: a gradient costs four evaluations, whatever the number of outputs.
    """

    def __init__(
        self, value: Callable[[Sequence[DisturbanceModel]], Floats], std_range: tuple[float, float]
    ) -> None:
        self._value = value
        low, high = std_range
        self.low: Floats = np.log([low, _MIN_CORRELATION_TIME_s, low, _MIN_QUANTISATION])
        self.high: Floats = np.log([high, _MAX_CORRELATION_TIME_s, high, _MAX_QUANTISATION])

    def at(self, *points: Floats) -> Floats:
        return self._value([DisturbanceModel.from_point(self.inside(point)) for point in points])

    def inside(self, point: Floats) -> Floats:
        result: Floats = np.clip(point, self.low, self.high)
        return result

    def gradient(self, point: Floats, now: Floats) -> Floats:
        """Derivatives of each output's likelihood by its own logarithms, shape (m, 4); 0 at a bound from
        which they lead outside.
        """
        steps = np.where(point > self.high - _DIFFERENCE, -_DIFFERENCE, _DIFFERENCE)
        changed = []
        for i in range(4):
            changed.append(point.copy())
            changed[i][:, i] += steps[:, i]
        gradient: Floats = (self.at(*changed) - now).T / steps
        gradient[(point <= self.low + 1e-9) & (gradient < 0.0)] = 0.0
        gradient[(point >= self.high - 1e-9) & (gradient > 0.0)] = 0.0
        return gradient

    def curvature(self, point: Floats) -> tuple[Floats, Floats]:
        """Likelihoods at a point, and the negative second derivatives of each output's own likelihood by its
        own logarithms near it, shape (m, 4, 4).
        """
        inside = np.clip(point, self.low + 3 * _DIFFERENCE, self.high - 3 * _DIFFERENCE)
        h = 3 * _DIFFERENCE
        unit = h * np.eye(4)
        pairs = [(i, j) for i in range(4) for j in range(i)]
        values = self.at(
            point,
            inside,
            *(inside + unit[i] for i in range(4)),
            *(inside - unit[i] for i in range(4)),
            *(inside + unit[i] + unit[j] for i, j in pairs),
        )
        now, up, down, both = values[1], values[2:6], values[6:10], values[10:]
        result = np.empty((len(point), 4, 4))
        for i in range(4):
            result[:, i, i] = -(up[i] - 2 * now + down[i]) / h**2
        for (i, j), mixed in zip(pairs, both, strict=True):
            # A forward difference of second order carries third derivatives; diagonals are exact to them.
            result[:, i, j] = result[:, j, i] = -(mixed - up[i] - up[j] + now) / h**2
        return values[0], result


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
        Value of `start`, where it is known.
    """
    likelihood = _Likelihood(value, std_range)
    point, curvature = likelihood.inside(start.point), start.curvature
    fresh = curvature is None
    if curvature is None:
        now, curvature = likelihood.curvature(point)
    else:
        now = likelihood.at(point)[0] if known is None else known
    for _ in range(_MOVES):
        gradient = likelihood.gradient(point, now)
        held = gradient == 0.0
        move = np.zeros(point.shape)
        for output in range(len(point)):
            free = ~held[output]
            if free.any():
                move[output, free] = _newton(gradient[output, free], curvature[output][np.ix_(free, free)])
        promised = 0.5 * float((gradient * move).sum())
        if promised < enough_nats:
            break
        values = likelihood.at(*(point + share * move for share in _SHARES))
        good = [
            number
            for number, share in enumerate(_SHARES)
            if values[number].sum() > now.sum() + 0.1 * share * promised
        ]
        if not good:
            if fresh:
                break
            now, curvature = likelihood.curvature(point)
            fresh = True
            continue
        share, after = _SHARES[good[0]], values[good[0]]
        gained = float(after.sum() - now.sum())
        point, now = likelihood.inside(point + share * move), after
        if gained < enough_nats:
            break
        fresh = False
        if share < 1.0 or np.abs(move).max() > 0.5:
            now, curvature = likelihood.curvature(point)
            fresh = True
    return replace(DisturbanceModel.from_point(point), curvature=curvature)


def _newton(gradient: Floats, curvature: Floats) -> Floats:
    values, vectors = np.linalg.eigh(curvature)
    move: Floats = vectors @ ((vectors.T @ gradient) / np.maximum(np.abs(values), _FLAT))
    longest = float(np.abs(move).max())
    return move * min(1.0, _LONGEST_MOVE / max(longest, 1e-12))
