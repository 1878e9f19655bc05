"""Concentrated scores: the gain of a candidate if the disturbances were estimated again with it.

A score holds the disturbances of the model without the candidate. A rare, large event inflates them so much
that its own score is worth little: a slip of 30 mm that gains 320 nats had a score of 8. The likelihood of
the event and of the disturbances is therefore maximised in turn, with all other parameters held.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from heli_host.arrays import Floats

from heli_lab.diagnose.search.candidate import Scored
from heli_lab.diagnose.search.screening import Screening, coefficient_std, signals_of
from heli_lab.diagnose.thresholds import CHANCE_NATS
from heli_lab.estimation import DisturbanceModel, estimate_disturbances
from heli_lab.estimation.innovations_model import FlightErrors

_TURNS: Final = 2
"""Turns of coefficient and disturbances: the second changes the coefficient by less than its error."""


def with_concentrated_scores(
    screening: Screening,
    worth_a_refit: Callable[[Sequence[Scored]], Sequence[Scored]],
    screened: Sequence[Scored],
) -> list[Scored]:
    """Replace the scores of effects that happen at a moment by concentrated scores: maxima of the likelihood
    over the disturbances too. Effects whose plain score leads to a refit keep it.

    Parameters
    ----------
    screening : Screening
        Scores about the present estimate.
    worth_a_refit : callable
        Returns those of some effects whose scores lead to a refit.
    screened : sequence of Scored
        Effects with their scores.

    Returns
    -------
    list of Scored
        The effects, the highest score first.
    """
    refitted_ids = {scored.candidate.id for scored in worth_a_refit(screened)}
    events = [
        scored
        for scored in screened
        if scored.candidate.effect.moment
        and scored.log_likelihood_gain > CHANCE_NATS
        and scored.candidate.id not in refitted_ids
    ]
    if not events:
        return list(screened)
    concentrated_by_id = {scored.candidate.id: scored for scored in concentrated(screening, events)}
    result = [concentrated_by_id.get(scored.candidate.id, scored) for scored in screened]
    return sorted(result, key=lambda scored: -scored.log_likelihood_gain)


def concentrated(screening: Screening, screened: Sequence[Scored]) -> list[Scored]:
    """Score each candidate with its own estimate of the disturbances; never less than its plain score."""
    filtered, start = screening.filtered, screening.estimate.disturbances
    plain = filtered.perturbed_residual()
    null = estimate_disturbances(filtered, plain, start)
    before = float(filtered.log_likelihoods([null], plain).sum())
    return [_concentrated(screening, scored, plain, null, before) for scored in screened]


def _concentrated(
    screening: Screening, scored: Scored, plain: FlightErrors, null: DisturbanceModel, before: float
) -> Scored:
    """The same for one candidate, over a model without it: its errors, disturbances and log-likelihood."""
    filtered = screening.filtered
    signals = [signals_of(maker, [scored.candidate]) for maker in screening.regressors]
    prior_std = coefficient_std(scored.candidate)
    coefficients, disturbances = scored.coefficients, null
    information = np.diag(prior_std**-2.0)
    for _ in range(_TURNS):
        error = _without(screening, plain, signals, coefficients)
        disturbances = estimate_disturbances(filtered, error, disturbances)
        innovations = filtered.innovations(disturbances)
        information, score = np.diag(prior_std**-2.0), np.zeros(len(prior_std))
        regressors_by_flight = filtered.regressors(disturbances, signals)
        for regressors, flight in zip(regressors_by_flight, innovations.flights, strict=True):
            information += regressors.T @ regressors
            score += regressors.T @ flight[:, 0]
        coefficients = np.asarray(np.linalg.solve(information, score), float)
    error = _without(screening, plain, signals, coefficients)
    after = float(filtered.log_likelihoods([disturbances], error).sum())
    gain = after - before - 0.5 * float(np.sum((coefficients / prior_std) ** 2))
    if gain <= scored.log_likelihood_gain:
        return scored
    std = np.sqrt(np.diag(np.linalg.inv(information)))
    return replace(scored, log_likelihood_gain=gain, coefficients=coefficients, std=std)


def _without(
    screening: Screening,
    error: FlightErrors,
    signals: Sequence[tuple[Floats, Floats | None]],
    coefficients: Floats,
) -> FlightErrors:
    """Errors of states and outputs that remain if a candidate with these coefficients is in the model."""
    result: list[list[tuple[Floats, Floats]]] = []
    flights = screening.filtered.linearised_flights
    for linearised, windows, (rates, outputs) in zip(flights, error, signals, strict=True):
        parts = []
        drives = linearised.over_blocks(rates)
        for blocks, added, (drive, measured) in zip(linearised.blocks, drives, windows, strict=True):
            remaining = measured
            if outputs is not None:
                remaining = measured - (outputs[blocks.rows] @ coefficients)[:, :, None]
            parts.append((drive + (added @ coefficients)[:, :, None], remaining))
        result.append(parts)
    return result
