"""Disturbances: random forces on a machine as Gauss-Markov states of the filter, and their estimation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
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
_MIN_GAIN_STD, _MAX_GAIN_STD = 1e-4, 0.3
_MAX_GAIN_CORRELATION_TIME_s = SLOW_CORRELATION_TIME_s
START_GAIN_STD: Final = 0.02
START_GAIN_CORRELATION_TIME_s: Final = 1.0
"""Where a search for the gains' disturbances begins: within the range of supplies and rotor wash."""

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
    """For each of m outputs a fast and a slow first-order Gauss-Markov disturbance, and the sensor's noise;
    and one relative disturbance of each of g gains, if the model has such inputs.

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
        Curvature of the log-likelihood at the estimate, by the logarithms of each output's four parameters;
        with gains m + g matrices, the last g by the logarithms of each gain's two parameters.
    gain_std : ndarray (g,)
        Stationary standard deviation of each gain, relative.
    gain_correlation_time_s : ndarray (g,)
        Correlation time of each gain.
    """

    fast_std: Floats
    correlation_time_s: Floats
    slow_std: Floats
    quantisation: Floats
    curvature: Floats | None = None
    gain_std: Floats = field(default_factory=lambda: np.zeros(0))
    gain_correlation_time_s: Floats = field(default_factory=lambda: np.zeros(0))

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
    def from_point(cls, point: Floats, gains: int = 0) -> DisturbanceModel:
        """Return the disturbances of a `point` of the search: the logarithms of all parameters, shape (m, 4),
        one row per output, and a row for each of the `gains`, of which two numbers count.
        """
        outputs = len(point) - gains
        fast_std, correlation_time_s, slow_std, quantisation = np.exp(point[:outputs]).T
        gain_std, gain_correlation_time_s = np.exp(point[outputs:, :2]).T
        return cls(
            fast_std,
            correlation_time_s,
            slow_std,
            quantisation,
            gain_std=gain_std,
            gain_correlation_time_s=gain_correlation_time_s,
        )

    def with_gains(self, gains: int) -> DisturbanceModel:
        """Add disturbances of `gains` gains, with the numbers from which a search starts."""
        return replace(
            self,
            curvature=None,
            gain_std=np.full(gains, START_GAIN_STD),
            gain_correlation_time_s=np.full(gains, START_GAIN_CORRELATION_TIME_s),
        )

    @property
    def point(self) -> Floats:
        """Logarithms of all parameters, one row per output and gain, as `from_point` takes them."""
        result: Floats = np.log(
            np.stack((self.fast_std, self.correlation_time_s, self.slow_std, self.quantisation), axis=1)
        )
        gains = np.zeros((len(self.gain_std), 4))
        gains[:, :2] = np.log(np.stack((self.gain_std, self.gain_correlation_time_s), axis=1))
        return np.vstack((result, gains))

    def memory(self, step_s: float) -> Floats:
        """Autocorrelation of each disturbance over a step of `step_s`, shape (2 (m + g),): the fast ones and
        the gains, then the slow ones and as many places that stay zero.
        """
        slow_s = np.full(len(self.fast_std) + len(self.gain_std), SLOW_CORRELATION_TIME_s)
        times_s = (self.correlation_time_s, self.gain_correlation_time_s, slow_s)
        result: Floats = np.exp(-step_s / np.concatenate(times_s))
        return result

    @property
    def variance(self) -> Floats:
        """Stationary variance of each disturbance, in the order of `memory`."""
        nothing = np.zeros(len(self.gain_std))
        result: Floats = np.concatenate((self.fast_std, self.gain_std, self.slow_std, nothing)) ** 2
        return result


class _Likelihood:
    """Log-likelihood of the innovations by points of the search, differentiated numerically.

    The disturbance of one output hardly touches the innovations of another, so that all outputs are
    differentiated at once: a gradient costs four evaluations, whatever the number of outputs. A gain touches
    all innovations: its row of a point has its own evaluations, and the value of all outputs together.
    """

    def __init__(
        self,
        value: Callable[[Sequence[DisturbanceModel]], Floats],
        std_range: tuple[float, float],
        outputs: int,
        gains: int,
    ) -> None:
        self._value, self._gains = value, gains
        low, high = std_range
        row_low = [low, _MIN_CORRELATION_TIME_s, low, _MIN_QUANTISATION]
        row_high = [high, _MAX_CORRELATION_TIME_s, high, _MAX_QUANTISATION]
        self.low: Floats = np.log([row_low] * outputs)
        self.high: Floats = np.log([row_high] * outputs)
        self._groups = [(slice(0, outputs), 4)]
        """Rows of a point that are differentiated together, and how many of their numbers count."""
        for row in range(outputs, outputs + gains):
            self.low = np.vstack((self.low, np.log([_MIN_GAIN_STD, _MIN_CORRELATION_TIME_s, 1.0, 1.0])))
            self.high = np.vstack(
                (self.high, np.log([_MAX_GAIN_STD, _MAX_GAIN_CORRELATION_TIME_s, 1.0, 1.0]))
            )
            self._groups.append((slice(row, row + 1), 2))

    def at(self, *points: Floats) -> Floats:
        """Value of each output's innovations, and of all together for each gain, for each of the points."""
        return self.by_row(
            self._value([DisturbanceModel.from_point(self.inside(point), self._gains) for point in points])
        )

    def by_row(self, values: Floats) -> Floats:
        """Values of all rows of a point, of those by output, (..., m)."""
        if not self._gains:
            return values
        together = np.repeat(values.sum(axis=-1, keepdims=True), self._gains, axis=-1)
        return np.concatenate((values, together), axis=-1)

    def total(self, values: Floats) -> float:
        """Log-likelihood of all innovations from the values of all rows, (rows,)."""
        return float(values[-1] if self._gains else values.sum())

    def inside(self, point: Floats) -> Floats:
        result: Floats = np.clip(point, self.low, self.high)
        return result

    def gradient(self, point: Floats, now: Floats) -> Floats:
        """Derivatives of each row's likelihood by its own logarithms, in the shape of `point`; 0 at a bound
        from which they lead outside.
        """
        steps = np.where(point > self.high - _DIFFERENCE, -_DIFFERENCE, _DIFFERENCE)
        places = [(rows, i) for rows, numbers in self._groups for i in range(numbers)]
        changed = []
        for rows, i in places:
            changed.append(point.copy())
            changed[-1][rows, i] += steps[rows, i]
        gradient = np.zeros(point.shape)
        for (rows, i), values in zip(places, self.at(*changed), strict=True):
            gradient[rows, i] = (values - now)[rows] / steps[rows, i]
        gradient[(point <= self.low + 1e-9) & (gradient < 0.0)] = 0.0
        gradient[(point >= self.high - 1e-9) & (gradient > 0.0)] = 0.0
        return gradient

    def curvature(self, point: Floats) -> tuple[Floats, Floats]:
        """Values at a point, and the negative second derivatives of each row's own likelihood by its own
        logarithms near it, shape (rows, 4, 4).
        """
        h = 3 * _DIFFERENCE
        inside = np.clip(point, self.low + h, self.high - h)
        points, places = [point, inside], []
        for rows, numbers in self._groups:
            unit = np.zeros((numbers, *point.shape))
            for i in range(numbers):
                unit[i, rows, i] = h
            pairs = [(i, j) for i in range(numbers) for j in range(i)]
            places.append((rows, numbers, pairs))
            points += [inside + unit[i] for i in range(numbers)]
            points += [inside - unit[i] for i in range(numbers)]
            points += [inside + unit[i] + unit[j] for i, j in pairs]
        values = self.at(*points)
        now, after = values[1], values[2:]
        result = np.zeros((len(point), 4, 4))
        for rows, numbers, pairs in places:
            up, down, both = (
                after[:numbers, rows],
                after[numbers : 2 * numbers, rows],
                after[2 * numbers : 2 * numbers + len(pairs), rows],
            )
            after = after[2 * numbers + len(pairs) :]
            for i in range(numbers):
                result[rows, i, i] = -(up[i] - 2 * now[rows] + down[i]) / h**2
            for (i, j), mixed in zip(pairs, both, strict=True):
                # A forward difference of second order carries third derivatives; diagonals are exact to them.
                result[rows, i, j] = result[rows, j, i] = -(mixed - up[i] - up[j] + now[rows]) / h**2
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
        Values of the outputs at `start`, where they are known.
    """
    gains = len(start.gain_std)
    likelihood = _Likelihood(value, std_range, len(start.fast_std), gains)
    point, curvature = likelihood.inside(start.point), start.curvature
    fresh = curvature is None
    if curvature is None:
        now, curvature = likelihood.curvature(point)
    else:
        now = likelihood.at(point)[0] if known is None else likelihood.by_row(known)
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
            if likelihood.total(values[number]) > likelihood.total(now) + 0.1 * share * promised
        ]
        if not good:
            if fresh:
                break
            now, curvature = likelihood.curvature(point)
            fresh = True
            continue
        share, after = _SHARES[good[0]], values[good[0]]
        gained = likelihood.total(after) - likelihood.total(now)
        point, now = likelihood.inside(point + share * move), after
        if gained < enough_nats:
            break
        fresh = False
        if share < 1.0 or np.abs(move).max() > 0.5:
            now, curvature = likelihood.curvature(point)
            fresh = True
    return replace(DisturbanceModel.from_point(point, gains), curvature=curvature)


def _newton(gradient: Floats, curvature: Floats) -> Floats:
    values, vectors = np.linalg.eigh(curvature)
    move: Floats = vectors @ ((vectors.T @ gradient) / np.maximum(np.abs(values), _FLAT))
    longest = float(np.abs(move).max())
    return move * min(1.0, _LONGEST_MOVE / max(longest, 1e-12))
