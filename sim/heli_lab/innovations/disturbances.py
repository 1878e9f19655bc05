"""Weather: the torques by chance that every rig meets, as states of the filter, and its estimation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from heli_host.arrays import Floats

SLOW_CORRELATION_TIME_s: Final = 15.0
"""Correlation time of the slow drift. Set, because a flight of a minute does not tell it: a quarter of one.
Longer: the constant torque of each flight says the same. Shorter: gusts say the same."""

# Where the search for the weather starts, and its bounds: far outside of what flights show.
_START_FAST_STD_Nm: Final = (1e-2, 3e-3, 6e-3)
_START_SLOW_STD_Nm: Final = (1e-3, 5e-4, 5e-4)
_START_CORRELATION_TIME_s: Final = 0.5
_START_QUANTISATION: Final = 0.6
_LEAST_Nm, _MOST_Nm = 2e-5, 1.0
_LEAST_s, _MOST_s = 0.03, 5.0
_LEAST_QUANTISATION, _MOST_QUANTISATION = 0.02, 4.0

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
    """Gauss-Markov torques about elevation, pitch and travel, and how well the encoders tell angles.

    Parameters
    ----------
    fast_std_Nm : ndarray (3,)
        Standard deviation of the gusts about each axis.
    correlation_time_s : ndarray (3,)
        Time over which the autocorrelation of each axis' gusts falls to 1/e.
    slow_std_Nm : ndarray (3,)
        Standard deviation of the slow drift about each axis, of memory `SLOW_CORRELATION_TIME_s`.
    quantisation : ndarray (3,)
        Variance of each axis' quantisation error over that of independent, even errors.
    curvature : ndarray (3, 4, 4) or None
        Of the log-likelihood at the estimate, for the logarithms of each axis' four numbers.
    """

    fast_std_Nm: Floats
    correlation_time_s: Floats
    slow_std_Nm: Floats
    quantisation: Floats
    curvature: Floats | None = None

    @classmethod
    def start(cls) -> DisturbanceModel:
        """Weather to start a search from."""
        return cls(
            np.array(_START_FAST_STD_Nm),
            np.full(3, _START_CORRELATION_TIME_s),
            np.array(_START_SLOW_STD_Nm),
            np.full(3, _START_QUANTISATION),
        )

    @classmethod
    def from_point(cls, point: Floats) -> DisturbanceModel:
        """Make it of a `point`, the logarithms of all numbers, shape (3, 4), an axis a row."""
        gust, memory, drift, quantisation = np.exp(point).T
        return cls(gust, memory, drift, quantisation)

    @property
    def point(self) -> Floats:
        """Logarithms of all numbers, within the bounds of the search, shape (3, 4), an axis a row."""
        every = np.log(
            np.stack((self.fast_std_Nm, self.correlation_time_s, self.slow_std_Nm, self.quantisation), axis=1)
        )
        result: Floats = np.clip(every, *_BOUNDS)
        return result

    def memory(self, step_s: float) -> Floats:
        """Share of each torque that is left after a step of `step_s`, gusts first, shape (6,)."""
        result: Floats = np.exp(
            -step_s / np.concatenate((self.correlation_time_s, np.full(3, SLOW_CORRELATION_TIME_s)))
        )
        return result

    @property
    def variance_N2m2(self) -> Floats:
        """Stationary variance of each torque, gusts first, shape (6,)."""
        result: Floats = np.concatenate((self.fast_std_Nm, self.slow_std_Nm)) ** 2
        return result


_BOUNDS: Final = (
    np.log([_LEAST_Nm, _LEAST_s, _LEAST_Nm, _LEAST_QUANTISATION]),
    np.log([_MOST_Nm, _MOST_s, _MOST_Nm, _MOST_QUANTISATION]),
)


def maximise(
    value: Callable[[Sequence[DisturbanceModel]], Floats],
    start: DisturbanceModel,
    enough_nats: float = _CONVERGED_NATS,
    known: Floats | None = None,
) -> DisturbanceModel:
    """Maximise a likelihood over the weather by Newton's method.

    Weather about one axis hardly touches the innovations of another, so that all three axes are
    differentiated at once: a step costs four evaluations, not twelve, and the sum decides whether it counts.

    Parameters
    ----------
    value : callable
        Log-likelihood of each axis' innovations under each of some weathers, nats, shape (w, 3); four cost
        little more than one.
    start : DisturbanceModel
        Where to begin; its curvature is used where it has one.
    enough_nats : float
        Gain that one more step may promise, or bring, before the search ends.
    known : ndarray (3,), optional
        Value of `start`, where it is known.
    """

    def at(*points: Floats) -> Floats:
        return value([DisturbanceModel.from_point(np.clip(point, *_BOUNDS)) for point in points])

    point, curvature = start.point, start.curvature
    fresh = curvature is None
    if curvature is None:
        now, curvature = _curvature(at, point)
    else:
        now = at(point)[0] if known is None else known
    for _ in range(_MOVES):
        gradient = _gradient(at, point, now)
        # At a bound only what leads inside counts.
        gradient[(point <= _BOUNDS[0] + 1e-9) & (gradient < 0.0)] = 0.0
        gradient[(point >= _BOUNDS[1] - 1e-9) & (gradient > 0.0)] = 0.0
        held = gradient == 0.0
        move = np.zeros((3, 4))
        for axis in range(3):
            free = ~held[axis]
            if free.any():
                move[axis, free] = _newton(gradient[axis, free], curvature[axis][np.ix_(free, free)])
        promised = 0.5 * float((gradient * move).sum())
        if promised < enough_nats:
            break
        values = at(*(point + share * move for share in _SHARES))
        good = [
            number
            for number, share in enumerate(_SHARES)
            if values[number].sum() > now.sum() + 0.1 * share * promised
        ]
        if not good:
            if fresh:
                break
            now, curvature = _curvature(at, point)
            fresh = True
            continue
        share, after = _SHARES[good[0]], values[good[0]]
        gained = float(after.sum() - now.sum())
        point, now = np.clip(point + share * move, *_BOUNDS), after
        if gained < enough_nats:
            break
        fresh = False
        if share < 1.0 or np.abs(move).max() > 0.5:
            now, curvature = _curvature(at, point)
            fresh = True
    return replace(DisturbanceModel.from_point(point), curvature=curvature)


def _gradient(at: Callable[..., Floats], point: Floats, now: Floats) -> Floats:
    steps = np.where(point > _BOUNDS[1] - _DIFFERENCE, -_DIFFERENCE, _DIFFERENCE)
    moved = []
    for i in range(4):
        moved.append(point.copy())
        moved[i][:, i] += steps[:, i]
    result: Floats = (at(*moved) - now).T / steps
    return result


def _curvature(at: Callable[..., Floats], point: Floats) -> tuple[Floats, Floats]:
    """Likelihoods at a point, and second derivatives of each axis' own likelihood by its own logarithms near
    it, negative, (3, 4, 4).
    """
    low, high = _BOUNDS[0] + 3 * _DIFFERENCE, _BOUNDS[1] - 3 * _DIFFERENCE
    inside = np.clip(point, low, high)
    h = 3 * _DIFFERENCE
    unit = h * np.eye(4)
    pairs = [(i, j) for i in range(4) for j in range(i)]
    values = at(
        point,
        inside,
        *(inside + unit[i] for i in range(4)),
        *(inside - unit[i] for i in range(4)),
        *(inside + unit[i] + unit[j] for i, j in pairs),
    )
    now, up, down, both = values[1], values[2:6], values[6:10], values[10:]
    result = np.empty((3, 4, 4))
    for i in range(4):
        result[:, i, i] = -(up[i] - 2 * now + down[i]) / h**2
    for (i, j), mixed in zip(pairs, both, strict=True):
        # A forward difference of second order carries the third derivatives; diagonals are exact to them.
        result[:, i, j] = result[:, j, i] = -(mixed - up[i] - up[j] + now) / h**2
    return values[0], result


def _newton(gradient: Floats, curvature: Floats) -> Floats:
    values, vectors = np.linalg.eigh(curvature)
    move: Floats = vectors @ ((vectors.T @ gradient) / np.maximum(np.abs(values), _FLAT))
    longest = float(np.abs(move).max())
    return move * min(1.0, _LONGEST_MOVE / max(longest, 1e-12))
