"""Add up the evidence of several files of one rig: for columns, for units, and for signs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from heli_host.data.arrays import Booleans, Floats
from heli_host.data.tables import Table
from heli_host.data.tables.table import ANGLE_UNITS, COUNT, SHARES, VOLTAGE_UNITS, split_unit
from heli_host.errors import FlightDataError

from heli_lab.setup.guess import names, thresholds
from heli_lab.setup.guess.known import KnownEntries
from heli_lab.setup.guess.regression.acceleration_fit import RegressionFit
from heli_lab.setup.guess.regression.assignment import ColumnAssignment, assignments, free_rows
from heli_lab.setup.guess.regression.axis_regression import axis_regressions, sum_and_difference, voltages
from heli_lab.setup.guess.regression.candidates import candidates
from heli_lab.setup.guess.regression.reference import Reference
from heli_lab.setup.guess.regression.scales import (
    AXES,
    LimitedMotion,
    MeasuredMotion,
    Scale,
    VoltageScale,
    is_encoder,
    quantisation_step,
    scales,
    voltage_scales,
)
from heli_lab.setup.guess.regression.signals import Signals, column_signals
from heli_lab.setup.guess.times import NO_RATE, Clock, clock_of, longest_run, times_in_s

_ANGLE_UNITS: Final = frozenset({*ANGLE_UNITS, COUNT})
_VOLTAGE_UNITS: Final = frozenset({*VOLTAGE_UNITS, *SHARES})
_UNRANKED_NATS: Final = 40.0
"""Penalty of an assignment or unit that one file excludes and another one does not, below the best of the
file that excludes it [nats]."""


@dataclass(frozen=True)
class PreparedFile:
    """One file with its filtered signals."""

    table: Table  # The longest part of the file in which times rise and no angle jumps
    clock: Clock  # Time column of the file
    signals: Signals  # All other columns of the file, at even times
    encoders: frozenset[str]  # Columns that are quantised by an encoder of the rig


def prepare_file(table: Table, reference: Reference, rate_Hz: float | None) -> PreparedFile:
    """Find the times of an aligned table, cut its longest part, and filter its columns."""
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
    """List the columns that may be an angle or a voltage in all files. Returns `columns`, `dropped`."""
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
    """Rank the assignments of columns by the evidence of all files. Returns `ranked`, `motions`.

    The likelihood of an assignment includes that of its best units: wrong columns have implausible gains.
    """
    ranked = _sum_over_files(
        [assignments(file.signals, reference, columns, file.encoders, known.columns) for file in files]
    )
    close = [
        assignment
        for assignment in ranked
        if ranked[0].log_likelihood - assignment.log_likelihood < thresholds.CANDIDATE_MARGIN_NATS
    ]
    with_units = []
    for assignment in close[: thresholds.MAX_CANDIDATES]:
        motions = []
        for file in files:
            regressions = axis_regressions(file.signals, assignment, reference)
            motions.append(_measured_motion(file.table, file.signals, assignment, regressions, reference))
        units_nats = pooled_scales(motions, reference)[0].log_likelihood
        scored = replace(
            assignment,
            log_likelihood=assignment.log_likelihood + units_nats,
            physics_log_likelihood=assignment.physics_log_likelihood + units_nats,
        )
        with_units.append((scored, motions))
    with_units.sort(key=lambda pair: -pair[0].log_likelihood)
    _, best_motions = with_units[0]
    return [assignment for assignment, _ in with_units], best_motions


def _sum_over_files(ranked_by_file: Sequence[list[ColumnAssignment]]) -> list[ColumnAssignment]:
    """Add up the log-likelihoods of each assignment over the files; return the most likely one first.

    The evidence of the motion is added up. The evidence of the columns' names counts once, because all files
    have the same names.
    """
    if len(ranked_by_file) == 1:
        return ranked_by_file[0]
    by_columns = [
        {(assignment.columns, assignment.summed): assignment for assignment in ranked}
        for ranked in ranked_by_file
    ]
    # Log-likelihood of the motion for an assignment that a file excludes.
    floors = [
        max(assignment.physics_log_likelihood for assignment in ranked) - _UNRANKED_NATS
        for ranked in ranked_by_file
    ]
    result = []
    for columns_and_kind in {key for by_file in by_columns for key in by_file}:
        in_files = [by_file.get(columns_and_kind) for by_file in by_columns]
        best = max(
            (assignment for assignment in in_files if assignment is not None),
            key=lambda assignment: assignment.log_likelihood,
        )
        physics_nats = sum(
            floor if assignment is None else assignment.physics_log_likelihood
            for assignment, floor in zip(in_files, floors, strict=True)
        )
        names_nats = best.log_likelihood - best.physics_log_likelihood
        result.append(
            replace(best, log_likelihood=physics_nats + names_nats, physics_log_likelihood=physics_nats)
        )
    return sorted(result, key=lambda assignment: (-assignment.log_likelihood, assignment.columns))


def pooled_scales(motions: Sequence[MeasuredMotion], reference: Reference) -> list[Scale]:
    """Score all combinations of units by the mean log-likelihood over all files; the most likely first.

    Files of one rig share the rig's deviation from its rig file. Their likelihoods are therefore not
    independent, and must not be added up.
    """
    ranked_by_file = [scales(motion, reference) for motion in motions]
    if len(ranked_by_file) == 1:
        return ranked_by_file[0]
    by_units = [{(scale.units, scale.bias_removed): scale for scale in ranked} for ranked in ranked_by_file]
    pooled = []
    for units, first in by_units[0].items():
        in_files = [scales_of_file[units] for scales_of_file in by_units if units in scales_of_file]
        missing = len(by_units) - len(in_files)
        mean_nats = float(np.mean([scale.log_likelihood for scale in in_files]))
        nats = mean_nats - _UNRANKED_NATS * missing / len(by_units)
        deviation_std = {
            name: float(np.mean([scale.deviation_std[name] for scale in in_files]))
            for name in first.deviation_std
        }
        pooled.append(replace(first, log_likelihood=nats, deviation_std=deviation_std))
    return sorted(pooled, key=lambda scale: -scale.log_likelihood)


def pooled_fits(fits_by_file: Sequence[Mapping[str, RegressionFit]]) -> dict[str, RegressionFit]:
    """Add up the regressions of all files by axis; files whose gains have opposite signs weaken each other.

    Lags are averaged with the evidence of the files as weights; the gain is that of the strongest file.
    """
    pooled = {}
    for axis in AXES:
        fits = [fits_of_file[axis] for fits_of_file in fits_by_file]
        nats = sum(fit.log_likelihood_ratio * np.sign(fit.gain) for fit in fits)
        strongest = max(fits, key=lambda fit: fit.log_likelihood_ratio)
        weights = np.array([max(fit.log_likelihood_ratio, 1e-6) for fit in fits])
        lag_s = float(np.average([fit.lag_s for fit in fits], weights=weights))
        shortest_s, longest_s = np.average([fit.lag_range_s for fit in fits], axis=0, weights=weights)
        gain = abs(strongest.gain) * (1.0 if nats >= 0.0 else -1.0)
        lag_range_s = float(shortest_s), float(longest_s)
        no_rotor_lag_nats = sum(fit.no_rotor_lag_nats for fit in fits)
        pooled[axis] = RegressionFit(abs(float(nats)), gain, lag_s, lag_range_s, no_rotor_lag_nats)
    return pooled


def _measured_motion(
    table: Table,
    signals: Signals,
    assignment: ColumnAssignment,
    regressions: dict[str, RegressionFit],
    reference: Reference,
) -> MeasuredMotion:
    """Measure gains, ranges and quantisation steps of the assigned columns of one file."""
    first, second = voltages(signals, assignment)
    voltage_sum = first if assignment.summed else first + second
    rows = free_rows(signals, assignment.elevation)
    columns = dict(zip(AXES, (assignment.elevation, assignment.pitch, assignment.travel), strict=True))
    values = {axis: table.columns[column].values for axis, column in columns.items()}
    stated_units = {axis: _stated_unit(table, column, _ANGLE_UNITS) for axis, column in columns.items()}
    voltage_units = [_stated_unit(table, column, _VOLTAGE_UNITS) for column in assignment.voltages]
    stated_units["voltage"] = voltage_units[0] or voltage_units[1]
    return MeasuredMotion(
        gain={axis: regressions[axis].gain for axis in AXES},
        mean_sum=float(np.mean(voltage_sum[rows])) if rows.any() else 0.0,
        peak=_peak_voltage(first, second, assignment.summed),
        quantisation_step={axis: quantisation_step(values[axis]) for axis in AXES},
        integer_valued={axis: _is_integer_valued(values[axis]) for axis in AXES},
        stated_units=stated_units,
        summed=assignment.summed,
        halved=any(names.is_half(column) for column in assignment.voltages),
        limited=_limited_motions(signals, assignment, reference, rows, regressions),
    )


def _is_integer_valued(values: Floats) -> bool:
    """Whether all finite `values` are whole numbers."""
    return bool(np.all(np.mod(values[np.isfinite(values)], 1.0) == 0.0))


def _limited_motions(
    signals: Signals,
    assignment: ColumnAssignment,
    reference: Reference,
    rows: Booleans,
    regressions: dict[str, RegressionFit],
) -> dict[VoltageScale, LimitedMotion]:
    """Measure the motion with commands limited to the supply, for each unit in which a few exceed it.
    Shapes: `rows` (n,).
    """
    limited = {}
    for choice in voltage_scales(assignment.summed):
        volts = choice.volts(reference)
        bias, limit = reference.hover_V / volts * choice.bias_removed, reference.supply_V / volts
        total, difference = sum_and_difference(signals, assignment, bias)
        # The larger of |front| and |back| in each row.
        larger_voltage = 0.5 * (np.abs(total) + np.abs(difference))
        share = float(np.mean(larger_voltage > thresholds.CLIP_SHARE * limit))
        if not thresholds.MIN_CLIPPED_SHARE < share <= thresholds.MAX_CLIPPED_SHARE or not rows.any():
            continue
        fits = axis_regressions(signals, assignment, reference, bias=bias, limits=(-limit, limit))
        total, _ = sum_and_difference(signals, assignment, bias, (-limit, limit))
        gain = {axis: fits[axis].gain for axis in AXES} | {"travel": regressions["travel"].gain}
        ratio = sum(
            fits[axis].log_likelihood_ratio - regressions[axis].log_likelihood_ratio
            for axis in ("elevation", "pitch")
        )
        limited[choice] = LimitedMotion(gain, float(np.mean(total[rows])), ratio)
    return limited


def _peak_voltage(first: Floats, second: Floats, summed: bool) -> float:
    """Largest voltage of a motor, in the unit of the columns, from both voltage columns, shape (n,) each.

    For sum and difference, `summed`, it is half the larger of the two, because the bias is unknown.
    """
    # Half a percent of the rows may be outliers.
    peaks = [float(np.quantile(np.abs(values), 0.995)) for values in (first, second)]
    return max(peaks) * (0.5 if summed else 1.0)


def _stated_unit(table: Table, column: str, valid_units: frozenset[str]) -> str:
    """Return the unit that the header or the name of a `column` states; empty if it is not a valid unit."""
    unit = table.columns[column].unit or split_unit(column)[1]
    return unit if unit in valid_units else ""
