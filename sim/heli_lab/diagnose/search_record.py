"""What a search tried and what it found: candidates that were refitted, rounds, causes, and the result."""

from __future__ import annotations

from dataclasses import dataclass

from heli_lab.diagnose.candidate import Candidate
from heli_lab.diagnose.model_comparison import Hypothesis
from heli_lab.diagnose.screening import Scored, Screening
from heli_lab.diagnose.thresholds import AMBIGUOUS


@dataclass(frozen=True, eq=False)
class Refit:
    """A candidate that was refitted; compared by identity.

    Parameters
    ----------
    gain : float
        Log-likelihood ratio over the model before, each with the weather that suits it best, nats.
    penalty : float
        BIC penalty of its parameters and of the number of candidates tried, nats.
    score : float
        What the score test promised, nats.
    """

    hypothesis: Hypothesis
    gain: float
    penalty: float
    score: float

    @property
    def candidate(self) -> Candidate:
        """The candidate."""
        return self.hypothesis.candidates[-1]

    @property
    def margin(self) -> float:
        """Gain less the penalty, nats."""
        return self.gain - self.penalty


@dataclass(frozen=True)
class Round:
    """One round of the forward search.

    Parameters
    ----------
    screened : tuple of Scored
        Every effect with its score, best first.
    splines : tuple of Scored
        Every spline term with its score, best first.
    refits : tuple of Refit
        Those that were refitted, the largest margin first.
    taken : str
        Id of the one that was taken into the model; empty when none was.
    """

    screened: tuple[Scored, ...]
    splines: tuple[Scored, ...]
    refits: tuple[Refit, ...]
    taken: str


@dataclass(frozen=True)
class Alternative:
    """Another effect, `id`, in the place of one that was found; `log_likelihood_ratio` is that of the effect
    found over it, penalties included, nats.
    """

    id: str
    log_likelihood_ratio: float


@dataclass(frozen=True)
class Cause:
    """An effect, or a spline in the place of one, that was found.

    Parameters
    ----------
    train : float
        Log-likelihood ratio of the final model over the same without it, on the flights fitted, nats.
    held_out : float or None
        The same on the flights held out, which had no part in choosing it; None without any.
    penalty : float
        BIC penalty, nats.
    alternatives : tuple of Alternative
        Other effects refitted in its place, closest first.
    """

    candidate: Candidate
    train: float
    held_out: float | None
    penalty: float
    alternatives: tuple[Alternative, ...]

    @property
    def effect(self) -> str:
        """Id of the effect, such as ``rotor_lag``."""
        return self.candidate.id

    @property
    def id(self) -> str:
        """The same as `effect`: the name that candidates and alternatives have it under."""
        return self.candidate.id

    @property
    def ambiguous_with(self) -> tuple[str, ...]:
        """Ids of other effects that the flights do not distinguish from this cause, closest first."""
        return tuple(
            alternative.id
            for alternative in self.alternatives
            if alternative.log_likelihood_ratio < AMBIGUOUS
        )


@dataclass(frozen=True)
class Search:
    """What a search found.

    Parameters
    ----------
    causes : tuple of Cause
        Effects and splines in the final model, strongest first.
    screening : Screening
        Scores about the final model.
    complete : bool
        False when the work allowed ran out.
    """

    baseline: Hypothesis
    final: Hypothesis
    causes: tuple[Cause, ...]
    rounds: tuple[Round, ...]
    screening: Screening
    complete: bool
