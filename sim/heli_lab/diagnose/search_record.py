"""What a search tried and what it found: candidates that were refitted, rounds, and the result."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from heli_lab.diagnose.candidate import Candidate
from heli_lab.diagnose.model_comparison import Evidence, Hypothesis
from heli_lab.diagnose.noise_model import DisturbanceModel, InnovationsFilter
from heli_lab.diagnose.screening import Scored, Screening

SETTLED: Final = 1.04
"""Normalised error, on all flights, up to which nothing is left but rounding: practice flights reach 1.00 to
1.02. It settles a round but for close rivals."""
LEAST_HELD: Final = 3.0
"""Logarithm of the likelihood ratio on held-out flights that an effect must reach."""
SURE: Final = 4.0
"""Times its price that an effect must gain on the flights fitted where those held out do not settle it."""
LOW: Final = 0.75
"""Share of its gain on held-out flights by which its lower bound may be below nothing then."""
MIN_REDUCTION: Final = 0.015
"""Share by which an effect must lower the mean square of at least one axis, in each flight."""
MIN_REDUCTION_SPLINE: Final = 0.08
"""The same for a pattern, which could be made of what integrators and rounding do."""
PLAIN: Final = 0.5
"""An effect that lowers an axis' mean square by this share and leaves rounding only is no chance."""


@dataclass(frozen=True)
class Refit:
    """A candidate that was refitted.

    Parameters
    ----------
    hypothesis : Hypothesis
        The model with it.
    evidence : Evidence
        What it has over the model before.
    penalty : float
        What its parameters and the number of candidates tried cost.
    linear : float
        Its score before it was refitted, to first order and beside chance.
    fit_disturbance : float or None
        What it has over the model before when torques may also wander by chance; None where that was plain.
    """

    hypothesis: Hypothesis
    evidence: Evidence
    penalty: float
    linear: float
    fit_disturbance: float | None = None

    @property
    def candidate(self) -> Candidate:
        """The candidate."""
        return self.hypothesis.candidates[-1]

    @property
    def net_evidence(self) -> float:
        """Evidence less its price, all errors taken as independent."""
        return self.evidence.raw - self.penalty

    @property
    def accepted(self) -> bool:
        """Whether the flights fitted pay for it and those held out agree."""
        if self.evidence.variance_reduction < (
            MIN_REDUCTION_SPLINE if self.candidate.is_spline else MIN_REDUCTION
        ):
            return False
        if self.hypothesis.held_fit is None:
            return self.evidence.train > 2.0 * self.penalty
        agreed = self.evidence.held > LEAST_HELD and self.evidence.held_low > 0.0
        # A short flight held out has few windows, and one of them may decide the lower bound.
        plain = self.evidence.held > self.penalty and self.evidence.train > SURE * self.penalty
        plain &= self.evidence.held_low > -LOW * self.evidence.held
        return self.evidence.train > self.penalty and (agreed or plain)

    @property
    def settled(self) -> bool:
        """Whether it leaves nothing but rounding, and took away much."""
        return self.leaves < SETTLED and self.evidence.variance_reduction > PLAIN

    @property
    def leaves(self) -> float:
        """Normalised error that it leaves, on the worse flights."""
        return max(self.hypothesis.train.normalised, self.hypothesis.held.normalised)

    @property
    def margin(self) -> float:
        """What it has over chance, its price paid."""
        return self.net_evidence if self.fit_disturbance is None else self.fit_disturbance - self.penalty


@dataclass(frozen=True)
class Round:
    """One round of the search.

    Parameters
    ----------
    screened : tuple of Scored
        Every effect with its score, best first.
    splines : tuple of Scored
        Every pattern with its score, best first.
    steps : tuple of Refit
        Those that were refitted, the most worth first.
    taken : str
        Id of the one that was taken; empty when none was.
    """

    screened: tuple[Scored, ...]
    splines: tuple[Scored, ...]
    steps: tuple[Refit, ...]
    taken: str


@dataclass(frozen=True)
class Rival:
    """Another effect in the place of one that was found.

    Parameters
    ----------
    id : str
        The other effect.
    behind : float
        By how much less it is worth, prices included.
    """

    id: str
    behind: float


@dataclass(frozen=True)
class Cause:
    """An effect that was found.

    Parameters
    ----------
    candidate : Candidate
        The effect.
    evidence : Evidence
        What the final model has over the same without it.
    penalty : float
        What it had to pay.
    rivals : tuple of Rival
        Other effects tried in its place, closest first.
    """

    candidate: Candidate
    evidence: Evidence
    penalty: float
    rivals: tuple[Rival, ...]


@dataclass(frozen=True)
class Search:
    """What a search found.

    Parameters
    ----------
    baseline, final : Hypothesis
        The model without and with what was found.
    found : tuple of Cause
        Effects and patterns in the final model, strongest first.
    rounds : tuple of Round
        What was tried.
    last : Screening
        Screening around the final model.
    complete : bool
        False when time ran out.
    chance : tuple of (DisturbanceModel, Filter) or None
        Random torques beside the final model, where something is missing.
    """

    baseline: Hypothesis
    final: Hypothesis
    found: tuple[Cause, ...]
    rounds: tuple[Round, ...]
    last: Screening
    complete: bool
    chance: tuple[DisturbanceModel, InnovationsFilter] | None = None
