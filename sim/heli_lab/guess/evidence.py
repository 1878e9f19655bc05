"""Evidence of one or several files of one rig, and how it is added up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from heli_host.arrays import Booleans, Floats
from heli_host.errors import FlightDataError
from heli_host.tables import Table
from heli_host.tables.units import ANGLE_UNITS, COUNT, SHARES, VOLTAGE_UNITS, split_unit

from heli_lab.guess import names, thresholds
from heli_lab.guess.known import KnownEntries
from heli_lab.guess.regression.assignment import ColumnAssignment, RegressionFit, assignments, free_rows
from heli_lab.guess.regression.axis_regression import axis_regressions, sum_and_difference, voltages
from heli_lab.guess.regression.candidates import candidates
from heli_lab.guess.regression.reference import Reference
from heli_lab.guess.regression.scales import (
    AXES,
    LimitedMotion,
    MeasuredMotion,
    Scale,
    VoltageScale,
    is_encoder,
    scales,
    step_of,
    voltage_scales,
)
from heli_lab.guess.regression.signals import Signals, column_signals
from heli_lab.guess.times import NO_RATE, Clock, clock_of, longest_run, times_in_s

_ANGLE_UNITS: Final = frozenset({*ANGLE_UNITS, COUNT})
_VOLTAGE_UNITS: Final = frozenset({*VOLTAGE_UNITS, *SHARES})
_UNRANKED_NATS: Final = 40.0
"""Distance below the best of an assignment or unit that one file excludes and another one does not [nats]."""


@dataclass(frozen=True)
class PreparedFile:
    """One file with its filtered signals: the longest part of its `table`, its `clock`, the `signals` of its
    columns, and the columns that are quantised by `encoders`.
    """

    table: Table
    clock: Clock
    signals: Signals
    encoders: frozenset[str]


def prepare_file(table: Table, reference: Reference, rate_Hz: float | None) -> PreparedFile:
    """Find the times of an aligned table, cut its longest part, and filter its columns.

    Parameters
    ----------
    rate_Hz : float or None
        Sampling rate [Hz], for a table without times.

    Raises
    ------
    FlightDataError
        When no column is the time, and no `rate_Hz` is given.
    """
    clock = Clock("", "s", True) if rate_Hz else clock_of(table)
    if not rate_Hz and (not clock.column or not clock.unit):
        raise FlightDataError(f"{table.source}: no column is the time ({clock.alternative})", NO_RATE)
    t_s = np.arange(len(table)) / rate_Hz if rate_Hz else times_in_s(table, clock)
    table, t_s = longest_run(table, t_s)
    others = [name for name in table.columns if name != clock.column and not names.is_time(name)]
    signals = column_signals(table, t_s, others, reference.counts.values())
    encoders = frozenset(name for name in others if is_encoder(table.columns[name].values, reference))
    return PreparedFile(table, clock, signals, encoders)


def common_candidates(
    files: Sequence[PreparedFile], known: Mapping[str, str]
) -> tuple[list[str], dict[str, str]]:
    """List the columns that may be an angle or a voltage in all files, and the others with the reason.

    Parameters
    ----------
    known : Mapping[str, str]
        Roles that the user knows, by column.
    """
    lists = [candidates(file.signals, file.encoders, known) for file in files]
    columns, dropped = lists[0]
    for others, reasons in lists[1:]:
        missing = {name: reasons.get(name, "not in every file") for name in columns if name not in others}
        columns = [name for name in columns if name not in missing]
        dropped = {**dropped, **missing}
    return columns, dropped


def rank(
    files: Sequence[PreparedFile], columns: list[str], reference: Reference, known: KnownEntries
) -> tuple[list[ColumnAssignment], list[MeasuredMotion]]:
    """Rank the assignments of columns by the evidence of all files, with the likelihood of their best units.

    Parameters
    ----------
    files : sequence of PreparedFile
        Files of one rig.
    columns : list of str
        Columns that may be an angle or a voltage.
    known : KnownEntries
        Entries of the profile that the user knows.

    Returns
    -------
    tuple of (list of ColumnAssignment, list of MeasuredMotion)
        The assignments, the most likely first, and the motion of the axes in each file for the first of them.
    """
    ranked = _added_up(
        [assignments(file.signals, reference, columns, file.encoders, known.columns) for file in files]
    )
    close = [
        assignment
        for assignment in ranked
        if ranked[0].log_likelihood - assignment.log_likelihood < thresholds.CANDIDATE_MARGIN_NATS
    ]
    fits = []
    for assignment in close[: thresholds.MAX_CANDIDATES]:
        motions = []
        for file in files:
            first = axis_regressions(file.signals, assignment, reference)
            motions.append(_measured_motion(file.table, file.signals, assignment, first, reference))
        nats = pooled_scales(motions, reference)[0].log_likelihood
        fits.append(
            (
                replace(
                    assignment,
                    log_likelihood=assignment.log_likelihood + nats,
                    physics_log_likelihood=assignment.physics_log_likelihood + nats,
                ),
                motions,
            )
        )
    fits.sort(key=lambda fit: -fit[0].log_likelihood)
    return [assignment for assignment, _ in fits], fits[0][1]


def _added_up(lists: Sequence[list[ColumnAssignment]]) -> list[ColumnAssignment]:
    """Add up the log-likelihoods of the motion; those of the names count once."""
    if len(lists) == 1:
        return lists[0]
    by_columns = [{(a.columns, a.summed): a for a in ranked} for ranked in lists]
    floors = [max(a.physics_log_likelihood for a in ranked) - _UNRANKED_NATS for ranked in lists]
    added = []
    for key in {key for by_file in by_columns for key in by_file}:
        of_files = [by_file.get(key) for by_file in by_columns]
        best = max((a for a in of_files if a is not None), key=lambda a: a.log_likelihood)
        physics = sum(
            floor if a is None else a.physics_log_likelihood
            for a, floor in zip(of_files, floors, strict=True)
        )
        words = best.log_likelihood - best.physics_log_likelihood
        added.append(replace(best, log_likelihood=physics + words, physics_log_likelihood=physics))
    return sorted(added, key=lambda a: (-a.log_likelihood, a.columns))


def pooled_scales(motions: Sequence[MeasuredMotion], reference: Reference) -> list[Scale]:
    """List all choices of units, the most likely first, by the mean over all files.

    Files of one rig share its deviation from the rig file, so that their likelihoods are not independent.
    """
    lists = [scales(motion, reference) for motion in motions]
    if len(lists) == 1:
        return lists[0]
    by_units = [{(s.units, s.bias_removed): s for s in scales} for scales in lists]
    pooled = []
    for key, first in by_units[0].items():
        scales_of_key = [by_unit[key] for by_unit in by_units if key in by_unit]
        missing = len(lists) - len(scales_of_key)
        nats = float(np.mean([s.log_likelihood for s in scales_of_key])) - _UNRANKED_NATS * missing / len(
            lists
        )
        deviation = {
            name: float(np.mean([s.deviation_std[name] for s in scales_of_key]))
            for name in first.deviation_std
        }
        pooled.append(replace(first, log_likelihood=nats, deviation_std=deviation))
    return sorted(pooled, key=lambda s: -s.log_likelihood)


def pooled_fits(files: Sequence[Mapping[str, RegressionFit]]) -> dict[str, RegressionFit]:
    """Add up the regressions of all files by axis; files with opposite signs weaken each other."""
    pooled = {}
    for axis in AXES:
        fits = [fit[axis] for fit in files]
        nats = sum(fit.log_likelihood_ratio * np.sign(fit.gain) for fit in fits)
        strongest = max(fits, key=lambda fit: fit.log_likelihood_ratio)
        weights = np.array([max(fit.log_likelihood_ratio, 1e-6) for fit in fits])
        lag_s = float(np.average([fit.lag_s for fit in fits], weights=weights))
        gain = abs(strongest.gain) * (1.0 if nats >= 0.0 else -1.0)
        pooled[axis] = RegressionFit(abs(float(nats)), gain, lag_s)
    return pooled


def _measured_motion(
    table: Table,
    signals: Signals,
    assignment: ColumnAssignment,
    first: dict[str, RegressionFit],
    reference: Reference,
) -> MeasuredMotion:
    first_V, second_V = voltages(signals, assignment)
    rows = free_rows(signals, assignment.elevation)
    level = (
        float(np.mean(first_V[rows] if assignment.summed else (first_V + second_V)[rows]))
        if rows.any()
        else 0.0
    )
    columns = dict(zip(AXES, (assignment.elevation, assignment.pitch, assignment.travel), strict=True))
    values = {axis: table.columns[column].values for axis, column in columns.items()}
    stated = {axis: _unit(table, column, _ANGLE_UNITS) for axis, column in columns.items()}
    stated["voltage"] = next(
        filter(None, (_unit(table, column, _VOLTAGE_UNITS) for column in assignment.voltages)), ""
    )
    limited = _limited_motions(signals, assignment, reference, rows, first)
    return MeasuredMotion(
        {axis: first[axis].gain for axis in AXES},
        level,
        _peak_voltage(first_V, second_V, assignment.summed),
        {axis: step_of(values[axis]) for axis in AXES},
        {axis: bool(np.all(np.mod(values[axis][np.isfinite(values[axis])], 1.0) == 0.0)) for axis in AXES},
        stated,
        assignment.summed,
        any(names.is_half(column) for column in assignment.voltages),
        limited,
    )


def _limited_motions(
    signals: Signals,
    assignment: ColumnAssignment,
    reference: Reference,
    rows: Booleans,
    first: dict[str, RegressionFit],
) -> dict[VoltageScale, LimitedMotion]:
    """Repeat the regressions with limited commands, for each unit in which some exceed the supply."""
    limited = {}
    for choice in voltage_scales(assignment.summed):
        volts = choice.volts(reference)
        bias, limit = reference.hover_V / volts * choice.bias_removed, reference.supply_V / volts
        total, difference = sum_and_difference(signals, assignment, bias)
        largest = 0.5 * (np.abs(total) + np.abs(difference))
        share = float(np.mean(largest > thresholds.CLIP_SHARE * limit))
        if not thresholds.MIN_CLIPPED_SHARE < share <= thresholds.MAX_CLIPPED_SHARE or not rows.any():
            continue
        fits = axis_regressions(signals, assignment, reference, bias=bias, limit=limit)
        total, _ = sum_and_difference(signals, assignment, bias, limit)
        gain = {axis: fits[axis].gain for axis in AXES} | {"travel": first["travel"].gain}
        ratio = sum(
            fits[axis].log_likelihood_ratio - first[axis].log_likelihood_ratio
            for axis in ("elevation", "pitch")
        )
        limited[choice] = LimitedMotion(gain, float(np.mean(total[rows])), ratio)
    return limited


def _peak_voltage(first_V: Floats, second_V: Floats, summed: bool) -> float:
    """Largest voltage of a motor; half the largest sum or difference, because the bias is unknown."""
    peaks = [float(np.quantile(np.abs(values), 0.995)) for values in (first_V, second_V)]
    return max(peaks) * (0.5 if summed else 1.0)


def _unit(table: Table, column: str, known: frozenset[str]) -> str:
    unit = table.columns[column].unit or split_unit(column)[1]
    return unit if unit in known else ""
