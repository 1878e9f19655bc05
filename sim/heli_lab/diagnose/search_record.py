"""What a search tried and what it found: candidates that were refitted, rounds, causes, and the result."""

from __future__ import annotations

from dataclasses import dataclass

from heli_lab.diagnose import thresholds
from heli_lab.diagnose.candidate import Candidate
from heli_lab.diagnose.model_comparison import Evidence, Hypothesis
from heli_lab.diagnose.noise_model import DisturbanceFit
from heli_lab.diagnose.screening import Scored, Screening


@dataclass(frozen=True, eq=False)
class Refit:
    """A candidate that was refitted; compared by identity.

    Parameters
    ----------
    evidence : Evidence
        Log-likelihood ratios over the model before.
    penalty : float
        BIC penalty of its parameters and of the number of candidates tried, nats.
    score : float
        Its first-order score under the coloured-noise model, nats.
    coloured_gain : float or None
        Log-likelihood ratio over the model before, both under coloured-noise models of their own, nats; None
        where it was not needed.
    """

    hypothesis: Hypothesis
    evidence: Evidence
    penalty: float
    score: float
    coloured_gain: float | None = None

    @property
    def candidate(self) -> Candidate:
        """The candidate."""
        return self.hypothesis.candidates[-1]

    @property
    def net_evidence(self) -> float:
        """Log-likelihood ratio as if errors were independent, less the penalty, nats."""
        return self.evidence.iid - self.penalty

    @property
    def accepted(self) -> bool:
        """Whether its gain on the flights fitted exceeds the penalty and the held-out flights confirm it."""
        if self.evidence.variance_reduction < (
            thresholds.MIN_REDUCTION_SPLINE if self.candidate.is_spline else thresholds.MIN_REDUCTION
        ):
            return False
        if self.hypothesis.held_out_fit is None:
            return self.evidence.train > thresholds.UNCONFIRMED_FACTOR * self.penalty
        confirmed = self.evidence.held_out > thresholds.MIN_HELD_OUT and self.evidence.held_out_low > 0.0
        # A short flight held out has few windows, and one of them may decide the lower bound.
        decisive = (
            self.evidence.held_out > self.penalty
            and self.evidence.train > thresholds.DECISIVE_TRAIN * self.penalty
            and self.evidence.held_out_low > -thresholds.LOWER_BOUND_SHARE * self.evidence.held_out
        )
        return self.evidence.train > self.penalty and (confirmed or decisive)

    @property
    def at_noise_floor(self) -> bool:
        """Whether it leaves nothing but quantisation, and removed much."""
        return (
            self.normalised_error < thresholds.AT_NOISE_FLOOR
            and self.evidence.variance_reduction > thresholds.PLAIN
        )

    @property
    def normalised_error(self) -> float:
        """Normalised error that it leaves, on the worse flights."""
        return max(self.hypothesis.train.normalised, self.hypothesis.held_out.normalised)

    @property
    def margin(self) -> float:
        """Log-likelihood ratio under coloured noise less the penalty, nats; `net_evidence` without the
        former.
        """
        return self.net_evidence if self.coloured_gain is None else self.coloured_gain - self.penalty


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
        Those that were refitted, the largest net evidence first.
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
    evidence : Evidence
        Log-likelihood ratios of the final model over the same without it.
    penalty : float
        BIC penalty, nats.
    alternatives : tuple of Alternative
        Other effects refitted in its place, closest first.
    """

    candidate: Candidate
    evidence: Evidence
    penalty: float
    alternatives: tuple[Alternative, ...]


@dataclass(frozen=True)
class Search:
    """What a search found.

    Parameters
    ----------
    causes : tuple of Cause
        Effects and splines in the final model, strongest first.
    screening : Screening
        Scores around the final model.
    complete : bool
        False when time ran out.
    disturbance : DisturbanceFit or None
        Coloured-noise model of the final model's errors, where more than quantisation remains.
    """

    baseline: Hypothesis
    final: Hypothesis
    causes: tuple[Cause, ...]
    rounds: tuple[Round, ...]
    screening: Screening
    complete: bool
    disturbance: DisturbanceFit | None = None
