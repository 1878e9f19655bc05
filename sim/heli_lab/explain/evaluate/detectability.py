"""Determines which effects would be missed in the flights, and which parameters they do not inform."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from heli_sim.model.effects import EffectSpec

from heli_lab.explain.search.candidate import ScoredCandidate
from heli_lab.explain.thresholds import DETECTION_STD_ERRORS
from heli_lab.fit.estimator import Estimate
from heli_lab.fit.uncertainty import uninformed_parameters


def undetectable_effects(
    screened: Sequence[ScoredCandidate], kinds: Mapping[str, EffectSpec]
) -> tuple[str, ...]:
    """Find the effects that would not be significant in these flights at their typical size."""
    undetectable = []
    for scored in screened:
        kind = kinds[scored.candidate.id]
        # Without linear parameters the only regressor is the effect at the size that was tried.
        name = kind.size[0]
        size_per_coefficient = (
            1.0 if scored.candidate.linear_parameters else scored.candidate.effect.values[name]
        )
        if scored.std[0] * abs(size_per_coefficient) * DETECTION_STD_ERRORS > abs(kind.typical[name]):
            undetectable.append(kind.id)
    return tuple(sorted(undetectable))


def unidentifiable_parameters(estimate: Estimate) -> tuple[str, ...]:
    """Find the parameters of the rig whose posterior is as wide as their prior; return their names."""
    parameter_vector = estimate.parameter_vector
    return tuple(uninformed_parameters(parameter_vector.names, estimate.covariance, parameter_vector.std))
