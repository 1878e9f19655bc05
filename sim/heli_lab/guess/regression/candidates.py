"""Select the columns that may be an angle or a voltage: no constants, rates or duplicates."""

from __future__ import annotations

import itertools
from collections.abc import Collection
from typing import Final

import numpy as np
from heli_host.arrays import Floats

from heli_lab.guess import names, thresholds
from heli_lab.guess.regression.signals import Signal, Signals

_MAX_COLUMNS: Final = 14
_DUPLICATE_CORRELATION: Final = 0.99999
_RATE_SCALES: Final = (1.0, 180.0 / np.pi, np.pi / 180.0)


def candidates(
    signals: Signals, encoders: Collection[str] = frozenset(), known: Collection[str] = ()
) -> tuple[list[str], dict[str, str]]:
    """List the columns that may be an angle or a voltage; those that are known come first.

    Parameters
    ----------
    encoders : collection of str
        Columns quantised by an encoder.
    known : collection of str
        Columns whose roles the user knows.

    Returns
    -------
    tuple of (list of str, dict of str)
        The columns, and those that are left out with the reason: constants, rates and duplicates. If columns
        are duplicates, one in `encoders` is kept, otherwise one that is not the rate of an angle: under state
        feedback, the sum of the voltages is proportional to the rate of elevation.
    """
    dropped = {name: "constant" for name, values in signals.raw.items() if np.ptp(values) == 0.0}
    moving = [name for name in signals.raw if name not in dropped]
    moving.sort(
        key=lambda name: (
            name not in known,
            name not in encoders,
            not names.role_of(name),
            names.is_derived_signal(name),
        )
    )
    groups: list[list[str]] = []
    for name in moving:
        for group in groups:
            if _abs_correlation(signals.raw[name], signals.raw[group[0]]) > _DUPLICATE_CORRELATION:
                group.append(name)
                break
        else:
            groups.append([name])
    angles = [group[0] for group in groups]
    rates = {name: of for name, of in _rates(signals, angles).items() if name not in {*encoders, *known}}
    kept = []
    for group in groups:
        of = rates.get(group[0]) or _angle_of_feedback(signals, group, angles)
        rate = None if of is None else signals.filtered[of].rate
        # A duplicate with another slope is not the rate, but follows it.
        chosen = (
            group[0] if rate is None else next((n for n in group if not _is_rate(n, rate, signals)), None)
        )
        chosen = group[0] if chosen is None and group[0] not in rates else chosen
        if chosen is not None:
            kept.append(chosen)
        for name in group:
            if name != chosen:
                dropped[name] = f"the rate of {of}" if of is not None else f"the same as {chosen}"
    dropped |= dict.fromkeys(kept[_MAX_COLUMNS:], f"behind the first {_MAX_COLUMNS} columns")
    return kept[:_MAX_COLUMNS], dropped


def _angle_of_feedback(signals: Signals, group: list[str], columns: list[str]) -> str | None:
    """Find the column whose rate a `group` of duplicates follows; None for single columns."""
    if len(group) == 1:
        return None
    value = signals.filtered[group[0]].value
    likeness = {
        name: _abs_correlation(signals.filtered[name].rate, value) for name in columns if name != group[0]
    }
    best = max(likeness, key=lambda name: likeness[name], default=None)
    return best if best is not None and likeness[best] > thresholds.FEEDBACK_MATCH**0.5 else None


def _is_rate(name: str, rate: Floats, signals: Signals) -> bool:
    slope = _unit_slope(rate, signals.filtered[name].value, signals.counts_per_turn)
    return slope or names.is_derived_signal(name)


def _rates(signals: Signals, columns: list[str]) -> dict[str, str]:
    """Find the columns that are the time derivative of a column that is not itself a derivative, by column.

    The derivative of the travel rate resembles pitch, which drives it, and that of the pitch rate a voltage.
    """
    pairs = {}
    for name, other in itertools.permutations(columns, 2):
        rate, value = signals.filtered[other].rate, signals.filtered[name].value
        likeness = _abs_correlation(rate, value)
        if names.role_of(name) or likeness <= thresholds.RATE_MATCH**0.5:
            continue
        if _unit_slope(rate, value, signals.counts_per_turn):
            pairs[name, other] = likeness
    rates: set[str] = set()
    settled: set[str] = set()
    remaining = set(columns)
    while remaining:
        open_ = {name for name in remaining if all(of in settled for first, of in pairs if first == name)}
        if not open_:  # a cycle, as sines form: drop the column with the lowest correlation
            weakest = min((likeness, name) for (name, _), likeness in pairs.items() if name in remaining)[1]
            open_ = {weakest}
            pairs = {pair: similarity for pair, similarity in pairs.items() if pair[0] != weakest}
        rates |= {name for name in open_ if any(first == name and of not in rates for first, of in pairs)}
        settled |= open_
        remaining -= open_
    return {name: next(of for first, of in pairs if first == name and of not in rates) for name in rates}


def _unit_slope(rate: Floats, value: Floats, counts_per_turn: Collection[float]) -> bool:
    """Whether `value` is about `rate` times 1 or a factor between angle units; one of them may be in counts
    of an encoder with these `counts_per_turn`.

    A negative factor is feedback: programs log an angle and its rate with the same sign.
    """
    variance = float(rate.var())
    slope = float(np.mean((rate - rate.mean()) * (value - value.mean()))) / variance if variance else 0.0
    from_counts = (turn / counts for turn in (2.0 * np.pi, 360.0) for counts in counts_per_turn)
    return any(0.6 < slope / scale < 1.5 for scale in (*_RATE_SCALES, *from_counts))


def _abs_correlation(first: Floats, second: Floats) -> float:
    if np.ptp(first) == 0.0 or np.ptp(second) == 0.0:
        return 0.0
    return abs(float(np.corrcoef(first, second)[0, 1]))


def feedback_sign(total: Floats, signal: Signal, counts_per_turn: Collection[float]) -> float:
    """Return 1 or -1 if `total` is proportional to the rate of a signal, as under state feedback;
    otherwise 0.

    A column in a unit of the rate is the rate, not feedback; it may be in counts of an encoder with these
    `counts_per_turn`.
    """
    if np.ptp(total) == 0.0 or np.ptp(signal.rate) == 0.0 or _unit_slope(signal.rate, total, counts_per_turn):
        return 0.0
    likeness = float(np.corrcoef(total, signal.rate)[0, 1])
    return float(np.sign(likeness)) if abs(likeness) > thresholds.FEEDBACK_MATCH**0.5 else 0.0
