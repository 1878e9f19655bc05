"""Finds the best point of an effect's grid: the best grid point first, then values between grid points."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.model.effects.spec import EffectSpec
from heli_sim.rig import Prior

from heli_lab.explain.search.candidate import Candidate, ScoredCandidate
from heli_lab.explain.search.score_test import Score
from heli_lab.explain.thresholds import MIN_MARGIN

_BISECTIONS: Final = 6
"""How often the distance between two grid points is halved about the best point: to a sixty-fourth."""
_MIN_REFINED_POINTS: Final = 3
"""Grid values from which on a parameter is also searched between them."""
_SPECTRAL_RESOLUTION_SHARE: Final = 0.25
"""First step of a frequency, as a share of the resolution of a spectrum, which is 1 / duration."""
_MIN_REFINED_NATS: Final = 0.5 * MIN_MARGIN
"""Score below which the neighbourhood of a grid's best point is not searched."""


@dataclass(frozen=True)
class GridSearch:
    """Search for the point of an effect's grid that has the highest score."""

    score: Callable[[Sequence[Candidate]], list[Score]]  # Scores candidates, each by itself, in their order
    seconds: float  # Length of the longest flight [s], which limits how well frequencies are distinguished

    def best_point(
        self, kind: EffectSpec, candidates: Sequence[Candidate], scores: Sequence[Score]
    ) -> ScoredCandidate | None:
        """Return the best point of an effect's grid, or a better one between its points."""
        allowed = [
            index
            for index, (candidate, score) in enumerate(zip(candidates, scores, strict=True))
            if _signs_are_allowed(candidate, score.coefficients)
        ]
        if not allowed:
            return None
        # If several points have the same score, the last one counts.
        best_index = max(allowed, key=lambda index: (scores[index].log_likelihood_gain, index))
        best = ScoredCandidate(candidates[best_index], *scores[best_index], tried=len(candidates))
        has_neighbours = bool(best.candidate.grid) and len(candidates) > 1
        if has_neighbours and best.log_likelihood_gain > _MIN_REFINED_NATS:
            best = self._refine(kind, candidates, best)
        return best

    def _refine(
        self, kind: EffectSpec, candidates: Sequence[Candidate], best: ScoredCandidate
    ) -> ScoredCandidate:
        """Search between the points of a grid for a higher score, one parameter after the other.

        `best` is the best of the grid points `candidates`. Only parameters with a prior and with enough grid
        values are searched.
        """
        for name in best.candidate.grid:
            prior = kind.priors.get(name)
            flight = best.candidate.effect.flight
            values = sorted(
                {candidate.grid[name] for candidate in candidates if candidate.effect.flight == flight}
            )
            if prior is None or len(values) < _MIN_REFINED_POINTS:
                continue
            distance = _grid_distance(values, best.candidate.grid[name])
            if name.endswith("Hz"):
                distance = _SPECTRAL_RESOLUTION_SHARE / self.seconds
            best = self._bisect(best, name, distance, prior)
        return best

    def _bisect(self, best: ScoredCandidate, name: str, distance: float, prior: Prior) -> ScoredCandidate:
        """Search the neighbourhood of `best` along the parameter `name`, and return the best point.

        Both neighbours are scored at half the `distance`, then at a quarter, and so on. The search moves to a
        neighbour that has a higher score. Values outside of the bounds of the prior are left out.
        """
        for _ in range(_BISECTIONS):
            distance *= 0.5
            value = best.candidate.grid[name]
            neighbours = [
                _with_grid_value(best.candidate, name, neighbour_value)
                for neighbour_value in (value - distance, value + distance)
                if prior.low <= neighbour_value <= prior.high
            ]
            best = replace(best, tried=best.tried + len(neighbours))
            for neighbour, score in zip(neighbours, self.score(neighbours), strict=True):
                is_better = score.log_likelihood_gain > best.log_likelihood_gain
                if is_better and _signs_are_allowed(neighbour, score.coefficients):
                    best = ScoredCandidate(neighbour, *score, tried=best.tried)
        return best


def _signs_are_allowed(candidate: Candidate, coefficients: Floats) -> bool:
    """Whether the priors allow the signs of the coefficients that a score test estimates.

    Without linear parameters, the only coefficient scales an effect of the right sign: it must be positive.
    """
    if not candidate.linear_parameters:
        return float(coefficients[0]) > 0.0
    for name, change in zip(candidate.linear_parameters, coefficients, strict=True):
        prior = candidate.effect.priors[name]
        if prior.low >= 0.0 and change + candidate.effect.values[name] <= 0.0:
            return False
    return True


def _grid_distance(sorted_values: Sequence[float], value: float) -> float:
    """Return the distance from the grid point closest to `value` to the next higher grid point.

    The last point has no higher neighbour: its distance is that to the point before.
    """
    distances = np.diff(sorted_values)
    closest = int(np.argmin(np.abs(np.array(sorted_values) - value)))
    return float(distances[min(closest, len(distances) - 1)])


def _with_grid_value(candidate: Candidate, name: str, value: float) -> Candidate:
    """Return a candidate with another value of the grid parameter `name`."""
    effect = replace(candidate.effect, values={**candidate.effect.values, name: value})
    return replace(candidate, effect=effect, grid={**candidate.grid, name: value})
