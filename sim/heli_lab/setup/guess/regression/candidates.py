"""Select the columns that may be an angle or a voltage: no constants, rates or duplicates."""

from __future__ import annotations

import itertools
from collections.abc import Collection
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats

from heli_lab.setup.guess import names, thresholds
from heli_lab.setup.guess.regression.signals import Signal, Signals

_MAX_COLUMNS: Final = 14
"""Largest number of columns of which assignments to angles and voltages are tried."""
_DUPLICATE_CORRELATION: Final = 0.99999
"""Absolute correlation above which two columns are the same signal, in another unit or with another sign."""
_RATE_SCALES: Final = (1.0, 180.0 / np.pi, np.pi / 180.0)
"""Factors between the units of an angle and of its logged rate: equal units, or radians and degrees."""
_UNIT_SLOPE_RANGE: Final = (0.6, 1.5)
"""Range of the measured slope divided by a factor between units. It is wide enough for a rate that the
logging program has filtered, and far narrower than the ratio of two factors, 57.3."""


def candidates(
    signals: Signals, encoders: Collection[str] = frozenset(), known: Collection[str] = ()
) -> tuple[list[str], dict[str, str]]:
    """List the columns of a table that may be an angle or a voltage; columns in `known` come first. Returns
    `columns`, `dropped`.

    Constants, rates and duplicates are left out. One column of several duplicates stays: one in `encoders`,
    otherwise one that is not the rate of an angle. The second rule matters under state feedback: the sum of
    the voltages is then proportional to the rate of elevation, and is the column to keep.
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
    groups = _duplicates(signals, moving)
    first_columns = [group[0] for group in groups]
    rates = {
        name: angle
        for name, angle in _derivatives(signals, first_columns).items()
        if name not in encoders and name not in known
    }
    columns = []
    for group in groups:
        angle = rates.get(group[0]) or _angle_of_feedback(signals, group, first_columns)
        kept = _column_to_keep(signals, group, angle, is_rate=group[0] in rates)
        if kept is not None:
            columns.append(kept)
        reason = f"the rate of {angle}" if angle is not None else f"the same as {kept}"
        dropped |= {name: reason for name in group if name != kept}
    dropped |= dict.fromkeys(columns[_MAX_COLUMNS:], f"behind the first {_MAX_COLUMNS} columns")
    return columns[:_MAX_COLUMNS], dropped


def _column_to_keep(signals: Signals, group: list[str], angle: str | None, *, is_rate: bool) -> str | None:
    """Choose the column of a `group` of duplicates that may be an angle or a voltage; None if all are
    rates.
    """
    if angle is None:
        return group[0]
    rate = signals.filtered[angle].rate
    # A duplicate with another slope is not the rate, but a voltage that follows it.
    not_rates = [name for name in group if not _is_rate(name, rate, signals)]
    if not_rates:
        return not_rates[0]
    return None if is_rate else group[0]


def _duplicates(signals: Signals, columns: list[str]) -> list[list[str]]:
    """Group columns that are proportional to each other, in their order; most groups have one column."""
    groups: list[list[str]] = []
    for name in columns:
        for group in groups:
            if _abs_correlation(signals.raw[name], signals.raw[group[0]]) > _DUPLICATE_CORRELATION:
                group.append(name)
                break
        else:
            groups.append([name])
    return groups


def _angle_of_feedback(signals: Signals, group: list[str], columns: list[str]) -> str | None:
    """Find the angle whose rate explains a `group` of duplicates, as under state feedback."""
    if len(group) == 1:
        return None
    value = signals.filtered[group[0]].value
    correlation = {
        name: _abs_correlation(signals.filtered[name].rate, value) for name in columns if name != group[0]
    }
    best = max(correlation, key=lambda name: correlation[name], default=None)
    return best if best is not None and correlation[best] > thresholds.FEEDBACK_MATCH**0.5 else None


def _is_rate(name: str, rate: Floats, signals: Signals) -> bool:
    """Whether the column `name` is a logged `rate`, by its slope against the rate or by its name."""
    has_unit_slope = _has_unit_slope(rate, signals.filtered[name].value, signals.counts_per_turn)
    return has_unit_slope or names.is_derived_signal(name)


def _derivatives(signals: Signals, columns: list[str]) -> dict[str, str]:
    """Find the columns that are the time derivative of another column.

    A column cannot be judged alone. Pitch drives travel, so the derivative of a logged travel rate resembles
    pitch; likewise that of a logged pitch rate resembles a voltage. Neither pitch nor the voltage is a logged
    rate. Therefore a column counts as a derivative only if its origin is not itself a derivative.
    """
    correlations = _derivative_correlations(signals, columns)

    def origins(name: str) -> list[str]:
        """List the columns of which `name` may be the derivative."""
        return [origin for derivative, origin in correlations if derivative == name]

    derivatives: set[str] = set()
    decided: set[str] = set()
    remaining = set(columns)
    while remaining:
        # A column is decided after all columns of which it may be the derivative.
        ready = {name for name in remaining if decided.issuperset(origins(name))}
        if not ready:
            # The remaining columns may be derivatives of each other in a circle, as with sines, whose second
            # derivative is a sine again. The column with the lowest correlation then counts as no derivative.
            weakest = min((value, name) for (name, _), value in correlations.items() if name in remaining)[1]
            ready = {weakest}
            correlations = {pair: value for pair, value in correlations.items() if pair[0] != weakest}
        derivatives |= {name for name in ready if not derivatives.issuperset(origins(name))}
        decided |= ready
        remaining -= ready
    return {
        name: next(origin for origin in origins(name) if origin not in derivatives) for name in derivatives
    }


def _derivative_correlations(signals: Signals, columns: list[str]) -> dict[tuple[str, str], float]:
    """Correlate each column with the time derivative of each other one."""
    correlations: dict[tuple[str, str], float] = {}
    for name, origin in itertools.permutations(columns, 2):
        rate, value = signals.filtered[origin].rate, signals.filtered[name].value
        correlation = _abs_correlation(rate, value)
        # The threshold is a share of variance, the square of a correlation.
        if names.role_of(name) or correlation <= thresholds.RATE_MATCH**0.5:
            continue
        if _has_unit_slope(rate, value, signals.counts_per_turn):
            correlations[name, origin] = correlation
    return correlations


def _has_unit_slope(rate: Floats, value: Floats, counts_per_turn: Collection[float]) -> bool:
    """Whether a signal is an angle's rate, in the unit of the angle or in another unit. Shapes: `rate` (n,),
    `value` (n,).

    A negative slope is feedback: programs log an angle and its rate with the same sign.
    """
    variance = float(rate.var())
    slope = float(np.mean((rate - rate.mean()) * (value - value.mean()))) / variance if variance else 0.0
    scales_from_counts = (turn / counts for turn in (2.0 * np.pi, 360.0) for counts in counts_per_turn)
    min_ratio, max_ratio = _UNIT_SLOPE_RANGE
    return any(min_ratio < slope / scale < max_ratio for scale in (*_RATE_SCALES, *scales_from_counts))


def _abs_correlation(first: Floats, second: Floats) -> float:
    """Absolute correlation of two columns; 0 if one of them is constant."""
    if np.ptp(first) == 0.0 or np.ptp(second) == 0.0:
        return 0.0
    return abs(float(np.corrcoef(first, second)[0, 1]))


def feedback_sign(voltage_sum: Floats, angle: Signal, counts_per_turn: Collection[float]) -> float:
    """Find whether the sum of the voltages is proportional to an angle's rate, as under state feedback.
    Shapes: `voltage_sum` (n,).
    """
    is_constant = np.ptp(voltage_sum) == 0.0 or np.ptp(angle.rate) == 0.0
    if is_constant or _has_unit_slope(angle.rate, voltage_sum, counts_per_turn):
        return 0.0
    correlation = float(np.corrcoef(voltage_sum, angle.rate)[0, 1])
    return float(np.sign(correlation)) if abs(correlation) > thresholds.FEEDBACK_MATCH**0.5 else 0.0
