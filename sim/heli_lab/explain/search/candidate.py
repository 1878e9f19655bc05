"""Candidates of the search: an effect of the catalogue, or a spline term, at one point of its grid."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.model.base import Effect
from heli_sim.model.effects.spec import EffectSpec


@dataclass(frozen=True)
class Candidate:
    """An effect or spline term that may be added to the model, at one point of its grid."""

    id: str  # Id of the effect, or ``spline:CHANNEL:QUANTITY``
    effect: Effect  # The effect with the parameter values at which its influence is computed
    linear_parameters: tuple[str, ...]
    """Parameters that enter linearly; each gives one regressor. If there is none, the only regressor is the
    difference between the effect at these values and no effect."""
    grid: Mapping[str, float] = field(default_factory=dict)
    """Values of the parameters in which the likelihood is multimodal, by full name."""

    @property
    def neutral(self) -> dict[str, float]:
        """Values of its sizes at which it has practically no influence, within the priors' bounds.

        Its sizes are the linear parameters, or, if there are none, the first parameter that has a prior.
        """
        sizes = self.linear_parameters or tuple(self.effect.priors)[:1]
        values = {}
        for name in sizes:
            prior = self.effect.priors[name]
            values[name] = float(np.clip(0.0, prior.low + 1e-6 * prior.std, prior.high))
        return values

    @property
    def is_spline(self) -> bool:
        """Whether it is a spline term, not an effect of the catalogue."""
        return self.id.startswith("spline:")

    @property
    def dependence(self) -> tuple[str, str]:
        """Channel and quantity of a spline term, such as ``torque.pitch`` and ``elevation``."""
        _, channel, quantity = self.id.split(":")
        return channel, quantity

    def start_values(self, coefficients: Floats) -> dict[str, float]:
        """Start values of a fit, by full name, within the priors' bounds; `coefficients` are those that a
        score test estimates, shape (g,).
        """
        values = {**self.effect.values}
        if self.linear_parameters:
            for name, change in zip(self.linear_parameters, coefficients, strict=True):
                values[name] += float(change)
        for name, prior in self.effect.priors.items():
            margin = 1e-3 * prior.std
            values[name] = float(np.clip(values[name], prior.low + margin, prior.high - margin))
        return values


def typical_candidate(kind: EffectSpec) -> Candidate:
    """Make an effect of this `kind` with its typical size, as a start of a refit."""
    return Candidate(kind.id, kind.make(kind.typical), kind.size)


@dataclass(frozen=True)
class ScoredCandidate:
    """Score test of a candidate at the best point of its grid."""

    candidate: Candidate  # The candidate at that point
    log_likelihood_gain: float
    """Gain that the score test predicts, nats, with all other parameters refitted and the disturbances
    unchanged."""
    coefficients: Floats  # coefficients, std: (g,): Coefficients of its regressors, and their standard errors
    std: Floats
    tried: int  # Number of points of the grid that were tried


def effect_candidates(kind: EffectSpec, seconds: float) -> list[Candidate]:
    """Return one candidate per point of the grid of an effect of this `kind`, over a flight of so many
    `seconds`.

    At each point the effect has the size 0, or its typical values if it has no size.
    """
    grid_values = kind.grid_values(seconds)
    values = kind.neutral if kind.size else kind.typical
    candidates = []
    for point in itertools.product(*grid_values.values()):
        grid = dict(zip(grid_values, point, strict=True))
        candidates.append(Candidate(kind.id, kind.make({**values, **grid}), kind.size, grid))
    return candidates


def may_join(id_: str, present: Iterable[str], kinds: Mapping[str, EffectSpec]) -> bool:
    """Whether a model with the effects `present` may have the effect `id_` too."""
    kind = kinds.get(id_)
    return kind is None or all(kind.compatible_with(kinds[other]) for other in present if other in kinds)
