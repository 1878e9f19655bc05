"""Summaries of runs over cases, with intervals and comparisons by pairs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np
from heli_host.arrays import Floats

from heli_benchmark.leaderboard.score import CaseScore

RESAMPLES: Final = 2000
"""Bootstrap resamples. The ends of an interval then vary by less than a tenth of its width."""
_BINS: Final = (0.0, 0.05, 0.2, 0.5, 0.8, 1.0 + 1e-9)
"""Bins of the probabilities for the calibration error."""
_SHARES: Final = ("first_right", "all_named", "false_alarms")
"""Shares of cases. Their intervals are binomial: a bootstrap of 0 of 4 cases has no width."""
_OUTER: Final = (2.5, 97.5)

SumsPerCase = tuple[Floats, Floats]
"""Numerator and denominator of a score in each case, shape (n,)."""


def summarise_runs(runs: Mapping[str, Sequence[CaseScore]], seed: int = 0) -> dict[str, Any]:
    """Summarise runs on the same cases.

    Parameters
    ----------
    runs : Mapping[str, sequence of CaseScore]
        Scores by method.
    seed : int
        Seed of the bootstrap.

    Returns
    -------
    dict
        ``methods`` by name: scores as ``value``, ``low`` and ``high`` of the 95 % interval, and ``cases``,
        the number that enters. ``pairs``: differences of two methods, the first minus the second.
    """
    cases = len(next(iter(runs.values())))
    drawn = np.random.default_rng(seed).integers(cases, size=(RESAMPLES, cases))
    weights = np.stack([np.bincount(indices, minlength=cases) for indices in drawn]).astype(np.float64)
    names = list(runs)
    return {
        "cases": cases,
        "methods": {name: _summary(scores, weights) for name, scores in runs.items()},
        "pairs": [
            {"first": a, "second": b, **_difference(runs[a], runs[b], weights)}
            for i, a in enumerate(names)
            for b in names[i + 1 :]
        ],
    }


def _summary(scores: Sequence[CaseScore], weights: Floats) -> dict[str, Any]:
    loss, base = _losses(scores)
    cost = {
        "cpu_s": _mean([case.cpu_s for case in scores]),
        "peak_MB": max((case.peak_MB for case in scores if case.peak_MB is not None), default=None),
    }
    ratios = {name: _ratio(sums, weights) for name, sums in _sums(scores).items()}
    for name in _SHARES:
        ratios[name] |= _binomial(*_sums(scores)[name])
    for end in ("value", "low", "high"):
        log_ratio = ratios["prediction_error"][end]
        ratios["prediction_error"][end] = None if log_ratio is None else float(np.exp(log_ratio))
    return {
        "skill": _interval(
            _skill(loss, base, np.ones((1, len(loss)))), _skill(loss, base, weights), len(loss)
        ),
        **ratios,
        "calibration_error": _calibration(scores, weights),
        **cost,
        "failed": sum(bool(case.failure) for case in scores),
    }


def _skill(loss: Floats, base: Floats, weights: Floats) -> Floats:
    return np.asarray(1.0 - weights @ loss / (weights @ base))


def _losses(scores: Sequence[CaseScore]) -> tuple[Floats, Floats]:
    return np.array([case.log_loss for case in scores]), np.array([case.base_loss for case in scores])


def _sums(scores: Sequence[CaseScore]) -> dict[str, SumsPerCase]:
    """Return each score that is a ratio of two sums over cases."""

    def each(value: Callable[[CaseScore], float | None]) -> SumsPerCase:
        values = [value(case) for case in scores]
        counted = np.array([float(number is not None) for number in values])
        return np.array([0.0 if number is None else float(number) for number in values]), counted

    def sizes(value: Callable[[tuple[bool, float]], float]) -> SumsPerCase:
        sums = [sum(value(size) for size in case.sizes) for case in scores]
        return np.array(sums, float), np.array([float(len(case.sizes)) for case in scores])

    true_sizes = np.array([float(case.sizes_asked) for case in scores])
    return {
        "first_right": each(lambda case: case.first_right),
        "all_named": each(lambda case: case.all_named),
        "false_names": each(lambda case: case.false_names),
        "false_alarms": each(lambda case: case.false_alarm),
        "sizes_given": (np.array([float(len(case.sizes)) for case in scores]), true_sizes),
        "sizes_within": sizes(lambda size: size[0]),
        "interval_score": sizes(lambda size: size[1]),
        "equation_correlation": each(lambda case: case.equation),
        "prediction_error": each(lambda case: None if case.prediction is None else np.log(case.prediction)),
    }


def _ratio(sums: SumsPerCase, weights: Floats) -> dict[str, Any]:
    over, under = sums
    count = int(under.sum())
    if not count:
        return {"value": None, "low": None, "high": None, "cases": 0}
    below = weights @ under
    resampled = (weights @ over)[below > 0.0] / below[below > 0.0]
    return _interval(np.array([over.sum() / under.sum()]), resampled, count)


def _binomial(over: Floats, under: Floats) -> dict[str, float]:
    """Return the 95 % interval of Clopper and Pearson of a share of cases."""
    from scipy.stats import binomtest

    if not under.sum():
        return {}
    interval = binomtest(int(over.sum()), int(under.sum())).proportion_ci(0.95, "exact")
    return {"low": float(interval.low), "high": float(interval.high)}


def _calibration(scores: Sequence[CaseScore], weights: Floats) -> dict[str, Any]:
    """Mean difference of probability and frequency over bins, weighted by the number of names.

    Almost all names of a case have a probability near 0, so the first bin is left out.
    """
    bins = len(_BINS) - 1
    excess, counts = np.zeros((len(scores), bins)), np.zeros((len(scores), bins))
    for i, case in enumerate(scores):
        for probability, true in case.calibration:
            place = int(np.searchsorted(_BINS, probability, side="right")) - 1
            excess[i, place] += probability - true
            counts[i, place] += 1.0
    excess, counts = excess[:, 1:], counts[:, 1:]
    if not counts.sum():
        return {"value": None, "low": None, "high": None, "cases": 0}
    value = np.abs(excess.sum(axis=0)).sum() / counts.sum()
    below = (weights @ counts).sum(axis=1)
    resampled = np.abs(weights @ excess).sum(axis=1)[below > 0.0] / below[below > 0.0]
    return _interval(np.array([value]), resampled, int(counts.sum()))


def _difference(first: Sequence[CaseScore], second: Sequence[CaseScore], weights: Floats) -> dict[str, Any]:
    """Compare two methods on the same resampled cases."""
    (loss_a, base), (loss_b, _) = _losses(first), _losses(second)
    unweighted = np.ones((1, len(base)))
    skill = _interval(
        _skill(loss_a, base, unweighted) - _skill(loss_b, base, unweighted),
        _skill(loss_a, base, weights) - _skill(loss_b, base, weights),
        len(base),
    )
    over_a, under = _sums(first)["all_named"]
    over_b, _ = _sums(second)["all_named"]
    return {"skill": skill, "all_named": _ratio((over_a - over_b, under), weights)}


def _interval(value: Floats, resampled: Floats, cases: int) -> dict[str, Any]:
    low, high = np.percentile(resampled, _OUTER)
    return {"value": float(value[0]), "low": float(low), "high": float(high), "cases": cases}


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None
