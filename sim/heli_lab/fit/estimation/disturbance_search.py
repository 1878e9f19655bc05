"""Find the disturbances of the largest likelihood, by Newton's method in the logarithms of their
parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np
from heli_host.data.arrays import Booleans, Floats, Integers

from heli_lab.fit.estimation.disturbances import DisturbanceModel, SLOW_CORRELATION_TIME_s

# Bounds of the search: far outside of what flights show.
_CORRELATION_TIME_RANGE_s: Final = (0.03, 5.0)
_QUANTISATION_RANGE: Final = (0.02, 4.0)
_GAIN_STD_RANGE: Final = (1e-4, 0.3)
_GAIN_CORRELATION_TIME_RANGE_s: Final = (0.03, SLOW_CORRELATION_TIME_s)

_DIFFERENCE: Final = 0.03
"""Change of a logarithm in numerical derivatives: 3 % of each parameter."""
_LONGEST_MOVE: Final = 1.2
"""Largest change of a logarithm in one step."""
_MIN_CURVATURE: Final = 0.5
"""Smallest curvature that a step uses, in nats for a change by the factor e. A parameter with less is hardly
determined, and a Newton step of it would be far too long."""
_SHARES: Final = (1.0, 0.4, 0.16, 0.06)
"""Shares of a step that are evaluated together; the longest one that gains enough is taken."""
_MAX_STEPS: Final = 25
_CONVERGED_NATS: Final = 0.02
"""A step that gains less ends the search: such a gain changes no decision, because the closest decisions
differ by tenths of a nat."""


@dataclass(frozen=True)
class _IndependentDisturbances:
    """Disturbances that affect innovations of different outputs, so that they are differentiated together."""

    parameters: Integers
    """(k, n): Indices of the n parameters of each disturbance in the vector of all logarithms."""
    affected: Booleans  # (k, m): Outputs whose innovations each disturbance affects

    def likelihoods(self, values: Floats) -> Floats:
        """Add up the log-likelihoods of the outputs that each disturbance affects, shape (k,), from those of
        all outputs, `values`, shape (m,).
        """
        by_disturbance = np.broadcast_to(values, self.affected.shape)
        return np.asarray(by_disturbance.sum(axis=1, where=self.affected))


class _Likelihood:
    """Log-likelihood of the innovations as a function of the logarithms of the disturbances' parameters.

    Derivatives are numerical. The disturbance of one output hardly affects the innovations of another one, so
    that the disturbances of all outputs are differentiated together: their four parameters cost four
    evaluations. A disturbance of a gain affects all innovations, and its two parameters cost two evaluations.
    """

    def __init__(
        self,
        value: Callable[[Sequence[DisturbanceModel]], Floats],
        start: DisturbanceModel,
        std_range: tuple[float, float],
    ) -> None:
        self._value, self._start = value, start
        outputs, gains = len(start.fast_std), len(start.gains)
        output_ranges = (std_range, _CORRELATION_TIME_RANGE_s, std_range, _QUANTISATION_RANGE)
        gain_ranges = (_GAIN_STD_RANGE, _GAIN_CORRELATION_TIME_RANGE_s)
        self.low, self.high = np.log([*output_ranges * outputs, *gain_ranges * gains]).T
        by_output, by_gain = np.split(np.arange(len(self.low)), [4 * outputs])
        self.groups = [
            _IndependentDisturbances(by_output.reshape(-1, 4), np.eye(outputs, dtype=bool)),
            *(
                _IndependentDisturbances(pair[None], np.ones((1, outputs), bool))
                for pair in by_gain.reshape(-1, 2)
            ),
        ]

    def at(self, *points: Floats) -> Floats:
        """Evaluate the log-likelihood of each output's innovations at w points, shape (w, m)."""
        return self._value([self._start.with_logarithms(self.inside(point)) for point in points])

    def inside(self, point: Floats) -> Floats:
        """Return the nearest point within the bounds, shape (f,)."""
        return np.clip(point, self.low, self.high)

    def gradient(self, point: Floats, values: Floats) -> Floats:
        """Differentiate the log-likelihood by the logarithms. Shapes: `point` (f,), `values` (m,); returns
        (f,).
        """
        # Near the upper bound, a difference goes downwards.
        steps = np.where(point > self.high - _DIFFERENCE, -_DIFFERENCE, _DIFFERENCE)
        # Parameters that are differentiated together: one of each disturbance of a group.
        differences = [(group, parameters) for group in self.groups for parameters in group.parameters.T]
        shifted = self.at(
            *(_point_with_step(point, parameters, steps[parameters]) for _, parameters in differences)
        )
        gradient = np.zeros(len(point))
        for (group, parameters), shifted_values in zip(differences, shifted, strict=True):
            change = group.likelihoods(shifted_values) - group.likelihoods(values)
            gradient[parameters] = change / steps[parameters]
        gradient[(point <= self.low + 1e-9) & (gradient < 0.0)] = 0.0
        gradient[(point >= self.high - 1e-9) & (gradient > 0.0)] = 0.0
        return gradient

    def curvature(self, point: Floats) -> tuple[Floats, Floats]:
        """Compute the log-likelihood at a point, and its negative second derivatives near it. Returns shape
        `values` (m,), `curvature` (f, f).
        """
        h = 3 * _DIFFERENCE
        inside = np.clip(point, self.low + h, self.high - h)
        points = [point, inside]
        for group in self.groups:
            columns = group.parameters.T
            points += [_point_with_step(inside, column, h) for column in columns]
            points += [_point_with_step(inside, column, -h) for column in columns]
            points += [
                _point_with_step(_point_with_step(inside, first, h), second, h)
                for first, second in combinations(columns, 2)
            ]
        values, inside_values, *shifted_values = self.at(*points)
        # Consumed below in the order of `points`.
        shifted = iter(shifted_values)
        curvature = np.zeros((len(point), len(point)))
        for group in self.groups:
            columns, middle = group.parameters.T, group.likelihoods(inside_values)
            up = [group.likelihoods(next(shifted)) for _ in columns]
            down = [group.likelihoods(next(shifted)) for _ in columns]
            for i, column in enumerate(columns):
                curvature[column, column] = -(up[i] - 2 * middle + down[i]) / h**2
            for i, j in combinations(range(len(columns)), 2):
                # This forward difference has an error of third order; the diagonals above have none.
                mixed = -(group.likelihoods(next(shifted)) - up[i] - up[j] + middle) / h**2
                curvature[columns[i], columns[j]] = curvature[columns[j], columns[i]] = mixed
        return values, curvature

    def newton_move(self, gradient: Floats, curvature: Floats) -> Floats:
        """Compute a Newton step of the logarithms, shape (f,), separately for each disturbance. Shapes:
        `gradient` (f,), `curvature` (f, f).
        """
        move = np.zeros(len(gradient))
        for group in self.groups:
            for parameters in group.parameters:
                free = parameters[gradient[parameters] != 0.0]
                if len(free):
                    move[free] = _newton_step(gradient[free], curvature[np.ix_(free, free)])
        return move


def maximise(
    value: Callable[[Sequence[DisturbanceModel]], Floats],
    start: DisturbanceModel,
    std_range: tuple[float, float],
    tolerance_nats: float = _CONVERGED_NATS,
    start_values: Floats | None = None,
) -> DisturbanceModel:
    """Maximise a likelihood over the disturbances by Newton's method with backtracking. Shapes: `std_range`
    (float, float), `start_values` (m,).
    """
    likelihood = _Likelihood(value, start, std_range)
    point, curvature = likelihood.inside(start.logarithms), start.curvature
    curvature_is_new = curvature is None
    if curvature is None:
        values, curvature = likelihood.curvature(point)
    else:
        values = likelihood.at(point)[0] if start_values is None else start_values
    for _ in range(_MAX_STEPS):
        gradient = likelihood.gradient(point, values)
        if not (np.isfinite(gradient).all() and np.isfinite(curvature).all()):
            # The model diverges, and no disturbances improve that.
            return start.with_logarithms(point, None)
        move = likelihood.newton_move(gradient, curvature)
        predicted_gain = 0.5 * float(gradient @ move)
        if predicted_gain < tolerance_nats:
            break
        trials = likelihood.at(*(point + share * move for share in _SHARES))
        gains = trials.sum(axis=1) - values.sum()
        # Armijo's rule; the longest acceptable step is taken.
        acceptable = [i for i, share in enumerate(_SHARES) if gains[i] > 0.1 * share * predicted_gain]
        if not acceptable:
            if curvature_is_new:
                break
            values, curvature = likelihood.curvature(point)
            curvature_is_new = True
            continue
        best = acceptable[0]
        point, values = likelihood.inside(point + _SHARES[best] * move), trials[best]
        if gains[best] < tolerance_nats:
            break
        # After a shortened or a long step, the curvature of the last point is too inaccurate.
        curvature_is_new = _SHARES[best] < 1.0 or bool(np.abs(move).max() > 0.5)
        if curvature_is_new:
            values, curvature = likelihood.curvature(point)
    return start.with_logarithms(point, curvature)


def _point_with_step(point: Floats, columns: Integers, step: float | Floats) -> Floats:
    """Return the `point`, shape (f,), with a `step` added to the elements `columns`."""
    result = point.copy()
    result[columns] += step
    return result


def _newton_step(gradient: Floats, curvature: Floats) -> Floats:
    """Compute the Newton step of one disturbance, shape (n,): uphill along every eigenvector of the
    curvature, and of limited length.
    """
    values, vectors = np.linalg.eigh(curvature)
    move: Floats = vectors @ ((vectors.T @ gradient) / np.maximum(np.abs(values), _MIN_CURVATURE))
    longest = float(np.abs(move).max())
    return move * min(1.0, _LONGEST_MOVE / max(longest, 1e-12))
