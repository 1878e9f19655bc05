"""Terms of the baseline that the flights reject.

A number that the rig file leaves open, such as a friction, is found to be nothing by the fit itself
(`absent_terms`). One that it states closely, such as the length of a pendulum, holds the fit back: there the
model is fitted without the term, before anything is looked for in its place (`without_absent_terms`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from heli_sim.model.effects import EffectKind
from heli_sim.rig import Prior, Rig

from heli_lab.diagnose.candidate import Candidate
from heli_lab.diagnose.model_comparison import Comparison, Hypothesis, errors
from heli_lab.errors import IdentifyError
from heli_lab.identify import Fit, Problem, solve

_SPREAD: Final = math.log(2.0)
"""A term that is there may be twice or half of what the rig says: 1 standard deviation of its logarithm."""
_GONE_BEFOREHAND: Final = 0.1
"""Probability, before a flight, that a term is gone."""
_LEAST_CONFIDENCE: Final = 0.5
_FINEST: Final = 1e-3
"""Least standard error of a share: a fit keeps numbers that cannot be negative this far from 0."""
_CLOSELY: Final = 0.5
"""A number is stated closely when its tolerance is below this share of it."""
_FAR_OFF: Final = 1.5
"""Normalised error of the baseline from which on a whole term may be gone; it then is 6 and more."""
_LEFT: Final = 0.5
"""Share of the error beyond rounding that may remain without the term."""
_WHOLE: Final = Prior(1.0, 0.03, 0.0, 1.0)
"""Of the share that is gone: a term is there or not; a part of it would be another number."""


@dataclass(frozen=True)
class AbsentTerm:
    """A term of the baseline that is not there.

    Parameters
    ----------
    id : str
        Its id in the catalogue, such as ``removed.friction.travel``.
    share, std : float
        Share of the term that is gone, at most 1, and its standard error.
    confidence : float
        Probability that it is gone, see `absence_probability`.
    from_nothing : float
        Standard errors by which its number differs from 0; of several numbers, the most.
    from_rig : float
        Standard errors by which its number differs from what the rig has; of several numbers, the least.
    """

    id: str
    share: float
    std: float
    confidence: float
    from_nothing: float
    from_rig: float


def absent_terms(fit: Fit, rig: Rig, kinds: Mapping[str, EffectKind]) -> tuple[AbsentTerm, ...]:
    """Find the terms whose numbers are nothing.

    Parameters
    ----------
    fit : Fit
        The final model on the flights fitted.
    rig : Rig
        What the numbers were beforehand.
    kinds : Mapping[str, EffectKind]
        The catalogue.

    Returns
    -------
    tuple of Removed
        The terms that are gone more likely than not, the surest first.
    """
    values, stds = fit.values, fit.std
    found = []
    for id_, kind in kinds.items():
        names = [name for name in kind.override if name in values and rig[name].value > 0.0]
        if not kind.baseline or not names:
            continue
        numbers = [
            (0.0 if name in fit.at_bound else values[name] / rig[name].value, stds[name] / rig[name].value)
            for name in names
        ]
        confidence = math.prod(absence_probability(value, std) for value, std in numbers)
        if confidence < _LEAST_CONFIDENCE:
            continue
        share, std = 1.0 - numbers[0][0], max(numbers[0][1], _FINEST)
        found.append(
            AbsentTerm(
                id_,
                min(max(share, 0.0), 1.0),
                std,
                confidence,
                max(abs(value) / max(spread, _FINEST) for value, spread in numbers),
                min((1.0 - value) / max(spread, _FINEST) for value, spread in numbers),
            )
        )
    return tuple(sorted(found, key=lambda one: -one.confidence))


def absence_probability(value: float, std: float) -> float:
    """How likely a number is nothing, by Bayes' rule, rather than twice or half of what the rig has.

    Parameters
    ----------
    value, std : float
        The number and its standard error, in units of what the rig has.

    Returns
    -------
    float
        Probability, at most 0.99.
    """
    std = max(std, _FINEST)
    there = np.geomspace(1e-3, 1e3, 4001)
    likely = np.exp(-0.5 * (np.log(there) / _SPREAD) ** 2)
    likely /= likely.sum()
    # The same factor before both densities is left out.
    absent = math.exp(-0.5 * min((value / std) ** 2, 1e3)) * _GONE_BEFOREHAND
    present = float(likely @ np.exp(-0.5 * ((value - there) / std) ** 2)) * (1.0 - _GONE_BEFOREHAND)
    return min(0.99, absent / max(absent + present, 1e-300))


def closely_stated(kind: EffectKind, rig: Rig) -> bool:
    """Whether a term's numbers are stated so closely that no fit would find them to be nothing.

    Parameters
    ----------
    kind : EffectKind
        A kind that takes a term away.
    rig : Rig
        The rig.

    Returns
    -------
    bool
        False also where the rig does not have the term.
    """
    return bool(kind.override) and all(
        name in rig and 0.0 < rig[name].tolerance < _CLOSELY * rig[name].value for name in kind.override
    )


def without_absent_terms(
    comparison: Comparison, baseline: Hypothesis, kinds: Iterable[EffectKind]
) -> Hypothesis:
    """Take away the one closely stated term without which the model predicts far better, if there is one.

    Parameters
    ----------
    comparison : Comparison
        Flights, rig and model.
    baseline : Hypothesis
        The model with all its terms.
    kinds : iterable of EffectKind
        The catalogue.

    Returns
    -------
    Hypothesis
        The model without the term, or the baseline.
    """
    before = baseline.train.normalised
    if before < _FAR_OFF:
        return baseline
    best: tuple[float, EffectKind, Fit] | None = None
    for kind in kinds:
        if not (kind.baseline and kind.suits(comparison.model) and closely_stated(kind, comparison.rig)):
            continue
        names = [one.quantity for one in baseline.fit.problem.free if one.quantity not in kind.override]
        problem = Problem(
            comparison.model,
            comparison.rig,
            comparison.train,
            free=tuple(dict.fromkeys(names)),
            window_s=comparison.window_s,
            step_s=baseline.fit.problem.step_s,
            values=kind.override,
        )
        try:
            fit = solve(problem, fine=False)
        except IdentifyError:
            continue
        after = errors(fit).normalised
        if after - 1.0 < _LEFT * (before - 1.0) and (best is None or after < best[0]):
            best = after, kind, fit
    if best is None:
        return baseline
    _, kind, fit = best
    (name,) = kind.size
    effect = replace(kind.make({name: 1.0}), priors={name: _WHOLE})
    start = {**fit.values, **{number: comparison.rig[number].value for number in kind.override}, name: 0.99}
    less = comparison.refit([Candidate(kind.id, effect, (name,))], start)
    return less if comparison.evidence(less, baseline).raw > 0.0 else baseline
