"""Numbers of the rig that flights pull far from what its file says."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from heli_sim.rig import Prior

from heli_lab.identify import Fit

FAR_STD: Final = 3.0
"""Standard deviations of its prior from which on a number is said to be pulled: by chance one of twenty
numbers in 18 flights. By judgement. Lower: lines that nobody minds. Higher: a number that stands for what the
model lacks, or a wrong rig file, goes unsaid."""


@dataclass(frozen=True)
class PriorPull:
    """A number of the rig and what was known of it beforehand.

    Parameters
    ----------
    name, unit : str
        The number, and its unit in rig files.
    value, std : float
        Its estimate and standard error.
    prior : Prior
        What the rig file says.
    """

    name: str
    unit: str
    value: float
    std: float
    prior: Prior

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
        )


def prior_pulls(fit: Fit) -> tuple[PriorPull, ...]:
    """Find the numbers of a `fit` beyond `FAR_STD`, the farthest first; an effect's own are not the rig's."""
    own = {name for effect in fit.problem.model.effects for name in effect.priors}
    every = (
        PriorPull(one.name, one.unit, float(value), fit.std[one.name], one.prior)
        for one, value in zip(fit.problem.free, fit.theta, strict=True)
        if one.quantity not in own
    )
    far = [one for one in every if abs(one.deviations) > FAR_STD]
    return tuple(sorted(far, key=lambda one: -abs(one.deviations)))
