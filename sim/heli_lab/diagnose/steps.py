"""What a search tried and what it found: candidates that were refitted, rounds, and the result."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from heli_lab.diagnose.coloured import Colour, Filter
from heli_lab.diagnose.hypothesis import Evidence, Hypothesis
from heli_lab.diagnose.screening import Scored, Screening
from heli_lab.diagnose.trial import Trial

SETTLED: Final = 1.04
"""Normalised error, on all flights, up to which nothing is left but rounding: practice flights reach 1.00 to
1.02. It settles a round but for close rivals."""
LEAST_HELD: Final = 3.0
"""Logarithm of the likelihood ratio on held-out flights that an effect must reach."""
SURE: Final = 4.0
"""Times its price that an effect must gain on the flights fitted where those held out do not settle it."""
LOW: Final = 0.75
"""Share of its gain on held-out flights by which its lower bound may be below nothing then."""
LEAST_DROP: Final = 0.015
"""Share by which an effect must lower the mean square of at least one axis, in each flight."""
LEAST_DROP_PATTERN: Final = 0.08
"""The same for a pattern, which could be made of what integrators and rounding do."""
PLAIN: Final = 0.5
"""An effect that lowers an axis' mean square by this share and leaves rounding only is no chance."""


@dataclass(frozen=True)
class Step:
    """A candidate that was refitted.

    Parameters
    ----------
    hypothesis : Hypothesis
        The model with it.
    evidence : Evidence
        What it has over the model before.
    price : float
        What its parameters and the number of candidates tried cost.
    linear : float
        Its score before it was refitted, to first order and beside chance.
    coloured : float or None
        What it has over the model before when torques may also wander by chance; None where that was plain.
    """

    hypothesis: Hypothesis
    evidence: Evidence
    price: float
    linear: float
    coloured: float | None = None

    @property
    def trial(self) -> Trial:
        """The candidate."""
        return self.hypothesis.trials[-1]

    @property
    def worth(self) -> float:
        """Evidence less its price, all errors taken as independent."""
        return self.evidence.raw - self.price

    @property
    def accepted(self) -> bool:
        """Whether the flights fitted pay for it and those held out agree."""
        if self.evidence.drop < (LEAST_DROP_PATTERN if self.trial.is_pattern else LEAST_DROP):
            return False
        if self.hypothesis.held_fit is None:
            return self.evidence.train > 2.0 * self.price
        agreed = self.evidence.held > LEAST_HELD and self.evidence.held_low > 0.0
        # A short flight held out has few windows, and one of them may decide the lower bound.
        plain = self.evidence.held > self.price and self.evidence.train > SURE * self.price
        plain &= self.evidence.held_low > -LOW * self.evidence.held
        return self.evidence.train > self.price and (agreed or plain)

    @property
    def settled(self) -> bool:
        """Whether it leaves nothing but rounding, and took away much."""
        return self.leaves < SETTLED and self.evidence.drop > PLAIN

    @property
    def leaves(self) -> float:
        """Normalised error that it leaves, on the worse flights."""
        return max(self.hypothesis.train.normalised, self.hypothesis.held.normalised)

    @property
    def lead(self) -> float:
        """What it has over chance, its price paid."""
        return self.worth if self.coloured is None else self.coloured - self.price


@dataclass(frozen=True)
class Round:
    """One round of the search.

    Parameters
    ----------
    screened : tuple of Scored
        Every effect with its score, best first.
    patterns : tuple of Scored
        Every pattern with its score, best first.
    steps : tuple of Step
        Those that were refitted, the most worth first.
    taken : str
        Id of the one that was taken; empty when none was.
    """

    screened: tuple[Scored, ...]
    patterns: tuple[Scored, ...]
    steps: tuple[Step, ...]
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
class Found:
    """An effect that was found.

    Parameters
    ----------
    trial : Trial
        The effect.
    evidence : Evidence
        What the final model has over the same without it.
    price : float
        What it had to pay.
    rivals : tuple of Rival
        Other effects tried in its place, closest first.
    """

    trial: Trial
    evidence: Evidence
    price: float
    rivals: tuple[Rival, ...]


@dataclass(frozen=True)
class Search:
    """What a search found.

    Parameters
    ----------
    baseline, final : Hypothesis
        The model without and with what was found.
    found : tuple of Found
        Effects and patterns in the final model, strongest first.
    rounds : tuple of Round
        What was tried.
    last : Screening
        Screening around the final model.
    complete : bool
        False when time ran out.
    chance : tuple of (Colour, Filter) or None
        Random torques beside the final model, where something is missing.
    """

    baseline: Hypothesis
    final: Hypothesis
    found: tuple[Found, ...]
    rounds: tuple[Round, ...]
    last: Screening
    complete: bool
    chance: tuple[Colour, Filter] | None = None
