"""Terms of the baseline that the rig does not have.

A parameter whose prior is wide, such as a friction, is estimated as zero (`absent_terms`). One whose prior is
narrow, such as the length of a pendulum, cannot be: there the model is refitted without the term beside the
effects that may be tried in its place (`tightly_specified_terms`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from heli_sim.model.effects import EffectKind
from heli_sim.rig import Prior, Rig

from heli_lab.diagnose import thresholds
from heli_lab.diagnose.candidate import Candidate
from heli_lab.diagnose.model_comparison import ModelComparison
from heli_lab.diagnose.screening import Screening
from heli_lab.identify import Fit

_WHOLE: Final = Prior(1.0, 0.03, 0.0, 1.0)
"""Of the share of a term that is absent: all of it or nothing. A wider prior would let a share of the term
stand in for a parameter that is merely off."""
_ANY_SHARE: Final = Prior(0.0, 1.0, 0.0, 1.0)
_LEAST_SHARE, _MOST_SHARE = 0.2, 5.0
"""Share of a term that the score test must want gone: about all of it, as far as a straight line tells while
weather stands for what is wrong."""
_START_SHARE: Final = 0.99
"""Just inside the bound of that prior."""


@dataclass(frozen=True)
class AbsentTerm:
    """A term of the baseline that the rig does not have.

    Parameters
    ----------
    id : str
        Its id in the catalogue, such as ``removed.friction.travel``.
    share, std : float
        Share of the term that is absent, at most 1, and its standard error.
    confidence : float
        Probability that it is absent, see `absence_probability`.
    z_from_zero : float
        Standard errors by which its parameter differs from 0; of several, the most.
    z_from_rig : float
        Standard errors by which its parameter differs from the rig's; of several, the least.
    """

    id: str
    share: float
    std: float
    confidence: float
    z_from_zero: float
    z_from_rig: float


def absent_terms(fit: Fit, rig: Rig, kinds: Mapping[str, EffectKind]) -> tuple[AbsentTerm, ...]:
    """Find the terms whose parameters are zero within their standard errors in `fit`, the final model on the
    flights fitted: those more likely absent than not, the most likely first.
    """
    values, reported_std = fit.values, fit.std
    terms = []
    for id_, kind in kinds.items():
        names = [name for name in kind.override if name in values and rig[name].value > 0.0]
        if not kind.baseline or not names:
            continue
        numbers = [
            (
                0.0 if name in fit.at_bound else values[name] / rig[name].value,
                reported_std[name] / rig[name].value,
            )
            for name in names
        ]
        confidence = math.prod(absence_probability(value, std) for value, std in numbers)
        if confidence < thresholds.ABSENT_MIN_CONFIDENCE:
            continue
        share, std = 1.0 - numbers[0][0], max(numbers[0][1], thresholds.ABSENT_MIN_STD)
        terms.append(
            AbsentTerm(
                id_,
                min(max(share, 0.0), 1.0),
                std,
                confidence,
                max(abs(value) / max(std, thresholds.ABSENT_MIN_STD) for value, std in numbers),
                min((1.0 - value) / max(std, thresholds.ABSENT_MIN_STD) for value, std in numbers),
            )
        )
    return tuple(sorted(terms, key=lambda term: -term.confidence))


def absence_probability(value: float, std: float) -> float:
    """Posterior probability, at most 0.99, that a parameter is zero, rather than log-normal about the rig's
    value; its estimate `value` and standard error `std` are in units of that value.
    """
    std = max(std, thresholds.ABSENT_MIN_STD)
    there = np.geomspace(1e-3, 1e3, 4001)
    likely = np.exp(-0.5 * (np.log(there) / thresholds.PRESENT_LOG_STD) ** 2)
    likely /= likely.sum()
    # The normal densities' common factor cancels.
    absent = math.exp(-0.5 * min((value / std) ** 2, 1e3)) * thresholds.ABSENT_PRIOR
    present = float(likely @ np.exp(-0.5 * ((value - there) / std) ** 2)) * (1.0 - thresholds.ABSENT_PRIOR)
    return min(thresholds.MAX_CONFIDENCE, absent / max(absent + present, 1e-300))


def tightly_specified(kind: EffectKind, rig: Rig) -> bool:
    """Whether a term's priors are so narrow that no fit would estimate its parameters as zero; False where
    the rig does not have the term.
    """
    return bool(kind.override) and all(
        name in rig and 0.0 < rig[name].tolerance < thresholds.CLOSELY_STATED * rig[name].value
        for name in kind.override
    )


def tightly_specified_terms(
    comparison: ModelComparison, kinds: Iterable[EffectKind], screening: Screening
) -> list[tuple[Candidate, dict[str, float], float]]:
    """Closely stated terms that the score test would take away about whole.

    Returns
    -------
    list of (Candidate, dict, float)
        The term gone, the values to refit from, and the gain that the score test promises, nats.
    """
    known = {effect.name for effect in screening.estimate.parameter_vector.model.effects}
    specs = [
        kind
        for kind in kinds
        if kind.baseline
        and kind.id not in known
        and kind.suits(comparison.model)
        and tightly_specified(kind, comparison.rig)
    ]
    shares = [
        Candidate(kind.id, replace(kind.make(), priors={kind.size[0]: _ANY_SHARE}), kind.size)
        for kind in specs
    ]
    terms = []
    for kind, (gain, coefficients, _) in zip(specs, screening.score(shares), strict=True):
        if gain < thresholds.ABSENT_MIN or not _LEAST_SHARE < coefficients[0] < _MOST_SHARE:
            continue
        (name,) = kind.size
        candidate = Candidate(kind.id, replace(kind.make({name: 1.0}), priors={name: _WHOLE}), (name,))
        start = {number: comparison.rig[number].value for number in kind.override}
        terms.append((candidate, {**start, name: _START_SHARE}, gain))
    return terms
