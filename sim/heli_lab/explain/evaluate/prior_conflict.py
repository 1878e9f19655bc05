"""Parameters of the rig whose estimate is far from their prior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from heli_lab.explain.thresholds import PRIOR_CONFLICT_STD
from heli_lab.fit.estimator import Estimate
from heli_lab.fit.estimator import estimate as estimated
from heli_lab.fit.parameters import PriorDistribution
from heli_lab.fit.problem import Fit


@dataclass(frozen=True)
class EstimateWithoutPrior:
    """Estimate of a parameter from the flights alone."""

    value: float
    """value, std: Estimate and standard error without the priors of this and all other conflicting
    parameters."""
    std: float
    log_likelihood_gain: float  # Gain of the flights' log-likelihood without all these priors, nats


@dataclass(frozen=True)
class PriorConflict:
    """A parameter of the rig whose estimate conflicts with its prior."""

    name: str  # name, unit: Name of the parameter, and its unit in rig files
    unit: str
    value: float  # value, std: Estimate and standard error
    std: float
    prior: PriorDistribution  # PriorDistribution from the rig file
    freed: EstimateWithoutPrior | None = None  # Estimate without the prior; None if it was not computed

    @property
    def deviations(self) -> float:
        """Distance of the estimate from the prior's mean, in standard deviations of the prior."""
        return (self.value - self.prior.mean) / self.prior.std


def prior_conflicts(fit: Fit) -> tuple[PriorConflict, ...]:
    """Find parameters of the rig whose estimate in a `fit` is far from the prior mean, the farthest first.

    The limit is `PRIOR_CONFLICT_STD` standard deviations of the prior. Parameters of effects are not tested.
    """
    effect_names = {name for effect in fit.problem.model.effects for name in effect.priors}
    conflicts = (
        PriorConflict(parameter.name, parameter.unit, float(value), fit.std[parameter.name], parameter.prior)
        for parameter, value in zip(fit.problem.free, fit.theta, strict=True)
        if parameter.quantity not in effect_names
    )
    significant = [conflict for conflict in conflicts if abs(conflict.deviations) > PRIOR_CONFLICT_STD]
    return tuple(sorted(significant, key=lambda conflict: -abs(conflict.deviations)))


def tried_without(conflicts: Sequence[PriorConflict], estimate: Estimate) -> tuple[PriorConflict, ...]:
    """Estimate a model again without the priors of conflicting parameters."""
    if not conflicts:
        return ()
    parameters = estimate.parameter_vector
    names = [conflict.name for conflict in conflicts]
    indices = [parameters.names.index(name) for name in names]
    without_priors = estimated(
        parameters.without_priors(names),
        estimate.references,
        estimate.functions,
        estimate.theta,
        estimate.disturbances,
    )
    # log_likelihood includes the priors: subtract the share of the priors that were dropped.
    deviations = estimate.prior_deviations
    gain = (
        without_priors.log_likelihood
        - estimate.log_likelihood
        - 0.5 * float(deviations[indices] @ deviations[indices])
    )
    std = np.sqrt(np.diag(without_priors.covariance))
    return tuple(
        replace(
            conflict, freed=EstimateWithoutPrior(float(without_priors.theta[index]), float(std[index]), gain)
        )
        for conflict, index in zip(conflicts, indices, strict=True)
    )
