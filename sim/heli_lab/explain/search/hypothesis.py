"""Hypotheses, and what a search keeps of them: refits, rounds, causes and their alternatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heli_lab.explain import thresholds
from heli_lab.explain.search.candidate import Candidate, ScoredCandidate
from heli_lab.fit.estimator import Estimate


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A model with some candidates, estimated on the flights; compared by identity."""

    candidates: tuple[Candidate, ...]  # The candidates in the order in which they were added
    estimate: Estimate  # The estimate in innovations form

    @property
    def ids(self) -> tuple[str, ...]:
        """Ids of the candidates."""
        return tuple(candidate.id for candidate in self.candidates)

    @property
    def log_likelihood(self) -> float:
        """Log-likelihood of the fitted flights, priors included, nats."""
        return self.estimate.log_likelihood

    @property
    def values(self) -> dict[str, float]:
        """Estimates of the free parameters by name."""
        values: dict[str, float] = self.estimate.parameter_vector.by_name(self.estimate.theta)
        return values

    @property
    def std(self) -> dict[str, float]:
        """Standard errors of the free parameters by name."""
        errors = np.sqrt(np.diag(self.estimate.covariance))
        std: dict[str, float] = self.estimate.parameter_vector.by_name(errors)
        return std


@dataclass(frozen=True, eq=False)
class Refit:
    """A refit of a model with one more candidate; compared by identity."""

    hypothesis: Hypothesis  # The model with the candidate
    gain: float
    """Log-likelihood ratio over the model without it, each with its own estimate of the disturbances, nats.
    """
    penalty: float  # BIC penalty of its parameters and of the number of tests, nats
    score: float  # Gain that the score test predicted, nats
    added_id: str = ""
    """Id of the candidate that was added, if it may not be the last one: the same model may have been
    estimated before, with its candidates in another order."""

    @property
    def candidate(self) -> Candidate:
        """The candidate that was added."""
        candidates = self.hypothesis.candidates
        return next((candidate for candidate in candidates if candidate.id == self.added_id), candidates[-1])

    @property
    def margin(self) -> float:
        """Gain less penalty, nats."""
        return self.gain - self.penalty


@dataclass(frozen=True)
class Round:
    """One round of the forward selection."""

    base: Hypothesis  # The model before the round
    screened: tuple[ScoredCandidate, ...]  # All effects with their scores, the best first
    splines: tuple[ScoredCandidate, ...]  # All spline terms with their scores, the best first
    refits: tuple[Refit, ...]  # Candidates that were refitted, the largest margin first
    accepted_id: str  # Id of the candidate that was added to the model; empty if none was


@dataclass(frozen=True)
class Alternative:
    """Another effect in the place of a cause."""

    id: str  # Id of the effect
    log_likelihood_ratio: float  # Log-likelihood ratio of the cause over the effect, penalties included, nats


@dataclass(frozen=True)
class Cause:
    """An effect, or a spline term in the place of an unlisted one, with its evidence."""

    candidate: Candidate  # The effect or spline term
    train: float
    """Log-likelihood ratio of the final model over the model without the cause, on the fitted flights, nats.
    """
    held_out: float | None
    """The same ratio on the held-out flights, which had no part in its choice; None without such flights."""
    penalty: float  # BIC penalty, nats
    alternatives: tuple[Alternative, ...]  # Other effects that were refitted in its place, the closest first

    @property
    def effect(self) -> str:
        """Id of the effect, such as ``rotor_lag``."""
        return self.candidate.id

    @property
    def id(self) -> str:
        """Same as `effect`: candidates and alternatives have an ``id`` too."""
        return self.candidate.id

    @property
    def ambiguous_with(self) -> tuple[str, ...]:
        """Ids of the effects that these flights do not distinguish from this cause, the closest first."""
        return tuple(
            alternative.id
            for alternative in self.alternatives
            if alternative.log_likelihood_ratio < thresholds.MIN_MARGIN
        )
