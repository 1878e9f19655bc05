"""Concentrated scores: the gain of a candidate if the disturbances were estimated again with it.

A score holds the disturbances of the model without the candidate. Where they stand in for a missing effect,
its own score is low. A slip of 30 mm that gains 320 nats had a score of 8, and a spring that gains 500 nats
had a score of 5. The likelihood of the candidate and of the disturbances is therefore maximised in
turn, with all other parameters held.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats

from heli_lab.explain.search.candidate import ScoredCandidate
from heli_lab.explain.search.screening import Screening, coefficient_std, signals_of
from heli_lab.explain.thresholds import CHANCE_NATS, SIGNIFICANT_STD_ERRORS
from heli_lab.fit.estimator import estimate_disturbances
from heli_lab.fit.grey_box import DisturbanceModel
from heli_lab.fit.innovations import FlightErrors, ModelErrors

_ITERATIONS: Final = 2
"""Turns of coefficient and disturbances: the second changes the coefficient by less than its error."""

_MIN_NATS: Final = 0.5 * SIGNIFICANT_STD_ERRORS**2
"""Score of a size of two standard errors. From it on, an effect of the whole flight is scored again with its
own disturbances. A spring with a score of 4.8 nats gained 504 nats (2026-11). Lower: time, 0.05 s per
candidate. Higher: effects are missed that the disturbances stand in for."""


def with_concentrated_scores(
    screening: Screening,
    worth_a_refit: Callable[[Sequence[ScoredCandidate]], Sequence[ScoredCandidate]],
    screened: Sequence[ScoredCandidate],
) -> list[ScoredCandidate]:
    """Replace the scores of effects that happen at a moment, if the plain score would not lead to a refit."""
    shortlist_ids = {scored.candidate.id for scored in worth_a_refit(screened)}
    low_scores = [
        scored
        for scored in screened
        if scored.candidate.effect.moment
        and scored.log_likelihood_gain > CHANCE_NATS
        and scored.candidate.id not in shortlist_ids
    ]
    if not low_scores:
        return list(screened)
    concentrated = {scored.candidate.id: scored for scored in concentrated_scores(screening, low_scores)}
    result = [concentrated.get(scored.candidate.id, scored) for scored in screened]
    return sorted(result, key=lambda scored: -scored.log_likelihood_gain)


def hidden_in_disturbances(
    screening: Screening,
    worth_a_refit: Callable[[Sequence[ScoredCandidate]], Sequence[ScoredCandidate]],
    low_scores: Sequence[ScoredCandidate],
) -> list[ScoredCandidate]:
    """Find effects that are worth a refit only if the disturbances are estimated again with them."""
    possible = [scored for scored in low_scores if scored.log_likelihood_gain > _MIN_NATS]
    if not possible:
        return []
    concentrated = concentrated_scores(screening, possible)
    return list(worth_a_refit(sorted(concentrated, key=lambda scored: -scored.log_likelihood_gain)))


def concentrated_scores(screening: Screening, screened: Sequence[ScoredCandidate]) -> list[ScoredCandidate]:
    """Score each candidate with its own estimate of the disturbances; never less than its plain score."""
    filtered, start = screening.filtered, screening.estimate.disturbances
    residuals = filtered.perturbed_residual()
    disturbances = estimate_disturbances(filtered, residuals, start)
    log_likelihood = float(filtered.log_likelihoods([disturbances], residuals).sum())
    return [
        _concentrated_score(screening, scored, residuals, disturbances, log_likelihood) for scored in screened
    ]


def _concentrated_score(
    screening: Screening,
    scored: ScoredCandidate,
    residuals: FlightErrors,
    disturbances: DisturbanceModel,
    log_likelihood: float,
) -> ScoredCandidate:
    """Maximise the likelihood of a candidate's coefficients and of the disturbances in turn.

    `residuals`, `disturbances` and `log_likelihood` are those of the model without the candidate.
    """
    filtered = screening.filtered
    signals = [signals_of(flight, [scored.candidate]) for flight in screening.regressors]
    prior_std = coefficient_std(scored.candidate)
    coefficients = scored.coefficients
    information = np.diag(prior_std**-2.0)
    for _ in range(_ITERATIONS):
        remaining = _residuals_after(screening, residuals, signals, coefficients)
        disturbances = estimate_disturbances(filtered, remaining, disturbances)
        innovations = filtered.innovations(disturbances)
        information, score = np.diag(prior_std**-2.0), np.zeros(len(prior_std))
        flight_regressors = filtered.regressors(disturbances, signals)
        for regressors, flight_innovations in zip(flight_regressors, innovations.flights, strict=True):
            information += regressors.T @ regressors
            score += regressors.T @ flight_innovations[:, 0]
        coefficients = np.asarray(np.linalg.solve(information, score), float)
    remaining = _residuals_after(screening, residuals, signals, coefficients)
    likelihood_with = float(filtered.log_likelihoods([disturbances], remaining).sum())
    gain = likelihood_with - log_likelihood - 0.5 * float(np.sum((coefficients / prior_std) ** 2))
    if gain <= scored.log_likelihood_gain:
        return scored
    std = np.sqrt(np.diag(np.linalg.inv(information)))
    return replace(scored, log_likelihood_gain=gain, coefficients=coefficients, std=std)


def _residuals_after(
    screening: Screening,
    residuals: FlightErrors,
    signals: Sequence[tuple[Floats, Floats | None]],
    coefficients: Floats,
) -> FlightErrors:
    """Return the residuals that remain if a candidate with these coefficients, (g,), is in the model.

    `residuals` are those without it. `signals` are its changes of the rates, (n, states, g), and of the
    measured angles, (n, 3, g). Signs are those of `InnovationsModel.regressors`: the candidate adds to the
    drive, and is subtracted from the measured angles.
    """
    result: list[list[ModelErrors]] = []
    flights = screening.filtered.linearised_flights
    for flight, flight_residuals, (rates, angles) in zip(flights, residuals, signals, strict=True):
        windows = []
        drives = flight.over_blocks(rates)
        for blocks, added_drive, (drive, measured) in zip(
            flight.blocks, drives, flight_residuals, strict=True
        ):
            added_angle = 0.0 if angles is None else (angles[blocks.rows] @ coefficients)[:, :, None]
            new_drive = drive + (added_drive @ coefficients)[:, :, None]
            windows.append((new_drive, measured - added_angle))
        result.append(windows)
    return result
