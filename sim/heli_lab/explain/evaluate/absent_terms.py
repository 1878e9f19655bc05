"""Finds terms of the baseline that the rig lacks, such as friction: their parameters are estimated as 0."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from heli_sim.model.effects import EffectSpec
from heli_sim.rig import Rig

from heli_lab.explain import thresholds
from heli_lab.fit.problem import Fit


@dataclass(frozen=True)
class AbsentTerm:
    """A term of the baseline that the rig does not have."""

    id: str  # Id in the catalogue, such as ``removed.friction.travel``
    share: float  # share, std: Share of the term that is absent, 0 to 1, and its standard error
    std: float
    confidence: float  # Posterior probability that the term is absent, see `absence_probability`
    z_from_zero: float
    """Distance of its parameter from 0 in standard errors; the largest if it has several parameters."""
    z_from_rig: float
    """Distance of its parameter from the rig file's value in standard errors; the smallest of several."""


def absent_terms(fit: Fit, rig: Rig, kinds: Mapping[str, EffectSpec]) -> tuple[AbsentTerm, ...]:
    """Find terms whose parameters are zero within their standard errors."""
    values, reported_std = fit.values, fit.std
    terms = []
    for id_, kind in kinds.items():
        names = [name for name in kind.override if name in values and rig[name].value > 0.0]
        if not kind.baseline or not names:
            continue
        # Estimates and standard errors in units of the rig file's values.
        nominal = np.array([rig[name].value for name in names])
        relative = np.array([0.0 if name in fit.at_bound else values[name] for name in names]) / nominal
        relative_std = np.array([reported_std[name] for name in names]) / nominal
        confidence = math.prod(map(absence_probability, relative.tolist(), relative_std.tolist()))
        if confidence < thresholds.ABSENT_MIN_CONFIDENCE:
            continue
        std = np.maximum(relative_std, thresholds.ABSENT_MIN_STD)
        terms.append(
            AbsentTerm(
                id_,
                share=min(max(1.0 - float(relative[0]), 0.0), 1.0),
                std=float(std[0]),
                confidence=confidence,
                z_from_zero=float(np.max(np.abs(relative) / std)),
                z_from_rig=float(np.min((1.0 - relative) / std)),
            )
        )
    return tuple(sorted(terms, key=lambda term: -term.confidence))


def absence_probability(value: float, std: float) -> float:
    """Return the posterior probability that a parameter is zero, by Bayes' rule.

    The alternative hypothesis is a parameter that is log-normal about the rig file's value.
    """
    std = max(std, thresholds.ABSENT_MIN_STD)
    # The alternative is integrated over a logarithmic grid of values.
    present_values = np.geomspace(1e-3, 1e3, 4001)
    prior = np.exp(-0.5 * (np.log(present_values) / thresholds.PRESENT_LOG_STD) ** 2)
    prior /= prior.sum()
    # The common factor of the two normal densities cancels.
    absent_weight = math.exp(-0.5 * min((value / std) ** 2, 1e3)) * thresholds.ABSENT_PRIOR
    present_weight = float(prior @ np.exp(-0.5 * ((value - present_values) / std) ** 2)) * (
        1.0 - thresholds.ABSENT_PRIOR
    )
    return min(thresholds.MAX_CONFIDENCE, absent_weight / max(absent_weight + present_weight, 1e-300))
