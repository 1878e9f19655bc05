"""Numbers of the rig that flights pull far from what its file says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from heli_lab.estimation import Estimate
from heli_lab.estimation import estimate as estimated
from heli_lab.estimation.parameter_vector import Prior
from heli_lab.identify import Fit

FAR_STD: Final = 3.0
"""Standard deviations of its prior from which on a number is said to be pulled: by chance one of twenty
numbers in 18 flights. By judgement. Lower: lines that nobody minds. Higher: a number that stands for what the
model lacks, or a wrong rig file, goes unsaid."""


@dataclass(frozen=True)
class EstimateWithoutPrior:
    """What the flights alone say of a number that is pulled.

    Parameters
    ----------
    value, std : float
        Its estimate and standard error with no prior of it, nor of any other number that is pulled.
    log_likelihood_gain : float
        By how much the flights are likelier then, nats: of all the pulled numbers together.
    """

    value: float
    std: float
    log_likelihood_gain: float


@dataclass(frozen=True)
class PriorConflict:
    """A number of the rig and what was known of it beforehand.

    Parameters
    ----------
    name, unit : str
        The number, and its unit in rig files.
    value, std : float
        Its estimate and standard error.
    prior : Prior
        What the rig file says.
    freed : EstimateWithoutPrior or None
        The same without its prior, where that was tried.
    """

    name: str
    unit: str
    value: float
    std: float
    prior: Prior
    freed: EstimateWithoutPrior | None = None

    @property
    def deviations(self) -> float:
        """Distance of the estimate from the prior's mean, in standard deviations of the prior."""
        return (self.value - self.prior.mean) / self.prior.std

    @property
    def sentence(self) -> str:
        """The pull in one sentence without its full stop."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        return (
            f"{self.name} is found at {self.value:.3g}{unit}, {abs(self.deviations):.1f} standard "
            f"deviations from the {self.prior.mean:.3g} +- {2.0 * self.prior.std:.2g}{unit} known "
            "beforehand: that is wrong, or the number stands for what the model lacks"
        ) + self._alone(unit)

    def _alone(self, unit: str) -> str:
        if self.freed is None:
            return ""
        return (
            f"; these flights alone say {self.freed.value:.3g} +- {2.0 * self.freed.std:.2g}{unit}, "
            f"{self.freed.log_likelihood_gain:.0f} nats likelier"
        )


def prior_conflicts(fit: Fit) -> tuple[PriorConflict, ...]:
    """Find the numbers of a `fit` beyond `FAR_STD`, the farthest first; an effect's own are not the rig's."""
    effect_names = {name for effect in fit.problem.model.effects for name in effect.priors}
    every = (
        PriorConflict(parameter.name, parameter.unit, float(value), fit.std[parameter.name], parameter.prior)
        for parameter, value in zip(fit.problem.free, fit.theta, strict=True)
        if parameter.quantity not in effect_names
    )
    far = [pull for pull in every if abs(pull.deviations) > FAR_STD]
    return tuple(sorted(far, key=lambda pull: -abs(pull.deviations)))


def tried_without(pulls: Sequence[PriorConflict], estimate: Estimate) -> tuple[PriorConflict, ...]:
    """Estimate again without the priors of numbers that are pulled, and tell what they are then.

    Parameters
    ----------
    pulls : sequence of PriorConflict
        The numbers; without any nothing is estimated.
    estimate : Estimate
        The model with all priors, of which they are free parameters.
    """
    if not pulls:
        return ()
    unknowns_ = estimate.parameter_vector
    names = [pull.name for pull in pulls]
    places = [unknowns_.names.index(name) for name in names]
    free = estimated(
        unknowns_.without_priors(names),
        estimate.references,
        estimate.functions,
        estimate.theta,
        estimate.disturbances,
    )
    # Likelihoods hold what priors take off: these numbers' is no part of what the flights say.
    off = (estimate.theta - unknowns_.mean) / unknowns_.std
    gain = free.log_likelihood - estimate.log_likelihood - 0.5 * float(off[places] @ off[places])
    std = np.sqrt(np.diag(free.covariance))
    return tuple(
        replace(pull, freed=EstimateWithoutPrior(float(free.theta[place]), float(std[place]), gain))
        for pull, place in zip(pulls, places, strict=True)
    )
