"""Find the time column of a table and its unit."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_host.data.tables import Column, Table
from heli_host.data.tables.table import TIME_UNITS, split_unit

from heli_lab.setup.guess import names
from heli_lab.setup.guess.regression.scales import quantisation_step
from heli_lab.setup.guess.regression.signals import unwrapped

NO_RATE: Final = "give a column of times, or the sampling rate with --rate"
"""Fix of a file without times."""
_MIN_TIMES: Final = 10
"""Smallest number of values of a time column."""
_MIN_RISING_SHARE: Final = 0.995
"""Smallest share of rows in which a time column rises; a clock may be set back now and then."""
_MAX_UNEVENNESS: Final = 0.5
"""Largest deviation of an even step from the median step, as a share of it."""
_MAX_STEP_S: Final = 0.15
"""Largest step of a log [s]: logs of such flights have at least 7 Hz."""
_MIN_STEP_S: Final = 0.0002
"""Smallest step of a log [s]."""
_JUMP_STEPS: Final = 15.0
"""A step of an angle this many times above its usual largest one is a jump. Angles have up to 3; voltages
have up to 15, when a setpoint moves. Lower values cut flights there, higher ones miss jumps of slow logs."""
_JUMP_SHARE: Final = 0.03
"""Smallest jump as a share of the column's range. Smaller ones are left to the conversion, in degrees."""
_MIN_ROWS: Final = 100
_MAX_JUMPS: Final = 3
"""Columns with more jumps are not angles: voltages that a controller switches jump all the time."""
_MIN_MOVING_SHARE: Final = 0.03
"""Share of rows with a change; setpoints have less, encoders at 1 kHz more."""


@dataclass(frozen=True)
class Clock:
    """Time column of a table."""

    column: str  # Name of the column; empty if the table has no times
    unit: str  # Unit: `s`, `ms`, `us`, `ns` or `min`; empty if no unit fits
    sure: bool  # Whether column and unit are unambiguous
    alternative: str = ""  # Other meaning of the column, or the reason why no unit fits


def clock_of(table: Table) -> Clock:
    """Find the time column of a table and its unit: the best of all columns that rise from row to row.

    A column counts for its name (2 points), for even steps (up to 1), for a unit with which it has a
    plausible step (1), and if column and unit are unambiguous (1).
    """
    scored_clocks: list[tuple[float, Clock]] = []
    for name, column in table.columns.items():
        values = column.values[np.isfinite(column.values)]
        if values.size < _MIN_TIMES:
            continue
        steps = np.diff(values)
        if float(np.mean(steps > 0.0)) < _MIN_RISING_SHARE:
            continue
        typical_step = float(np.median(steps))
        even_share = float(np.mean(np.abs(steps / typical_step - 1.0) < _MAX_UNEVENNESS))
        clock = _interpret_as_times(name, column.unit, typical_step)
        score = 2.0 * names.is_time(name) + even_share + bool(clock.unit) + clock.sure
        scored_clocks.append((score, clock))
    if not scored_clocks:
        return Clock("", "", False, "no column rises from row to row")
    return max(scored_clocks, key=lambda scored: scored[0])[1]


def _interpret_as_times(name: str, header_unit: str, step: float) -> Clock:
    """Interpret a column that rises from row to row as times."""
    possible_units = [unit for unit, s in TIME_UNITS.items() if _MIN_STEP_S <= step * s <= _MAX_STEP_S]
    stated_unit = header_unit or split_unit(name)[1]
    if not stated_unit and set(names.words_of(name)) & {"millis"}:
        stated_unit = "ms"
    if not stated_unit and set(names.words_of(name)) & {"micros"}:
        stated_unit = "us"
    if stated_unit in TIME_UNITS and (stated_unit in possible_units or not possible_units):
        return Clock(
            name,
            stated_unit if possible_units else "",
            bool(possible_units),
            f"steps of {step:g} {stated_unit} are implausible for a log",
        )
    if stated_unit in TIME_UNITS:
        return Clock(
            name, possible_units[0], False, f"in {stated_unit}, as its name says, with steps of {step:g}"
        )
    may_count_rows = abs(step - 1.0) < 1e-6
    if may_count_rows and not (names.is_time(name) and possible_units):
        return Clock(name, possible_units[0] if possible_units else "ms", False, "it may count rows")
    if not possible_units:
        return Clock(name, "", False, f"steps of {step:g} fit no unit of time")
    # A log has steps of 0.2 to 150 ms. At most two units fit, and the larger one is meant.
    return Clock(name, possible_units[0], not may_count_rows, "it may count rows" if may_count_rows else "")


def times_in_s(table: Table, clock: Clock) -> Floats:
    """Return the times of the rows since the first finite one [s], shape (n,)."""
    values = table.columns[clock.column].values
    first = values[np.isfinite(values)][0]
    result: Floats = (values - first) * TIME_UNITS[clock.unit]
    return result


def longest_run(table: Table, t_s: Floats) -> tuple[Table, Floats]:
    """Cut out the longest part of a table in which times rise and no angle jumps. Shapes: `t_s` (n,);
    returns `t_s` (k,).
    """
    known = np.flatnonzero(np.isfinite(t_s))
    breaks = set(known[1:][np.diff(t_s[known]) < 0.0].tolist())
    for name, column in table.columns.items():
        if names.role_of(name) not in names.VOLTAGE_ROLES:
            breaks |= _jump_rows(column.values, t_s)
    edges = [0, *sorted(breaks), len(t_s)]
    if len(edges) == 2:
        return table, t_s
    start, stop = max(itertools.pairwise(edges), key=lambda run: run[1] - run[0])
    columns = {name: Column(column.values[start:stop], column.unit) for name, column in table.columns.items()}
    return Table(table.source, columns, table.notes, table.named), t_s[start:stop]


def _jump_rows(values: Floats, t_s: Floats) -> set[int]:
    """Find the rows at which an encoder's angle jumps, as when a program joins two flights in one log."""
    known = np.flatnonzero(np.isfinite(values) & np.isfinite(t_s))
    # Voltages jump with their setpoints; only encoders are quantised.
    if known.size < _MIN_ROWS or not quantisation_step(values):
        return set()
    elapsed_rows = np.maximum(np.diff(t_s[known]) / float(np.median(np.diff(t_s[known]))), 1.0)
    changes = np.abs(np.diff(unwrapped(values[known])))
    moving = changes[changes > 0.0]
    # A setpoint stands still except for its jumps.
    if moving.size < _MIN_MOVING_SHARE * changes.size:
        return set()
    typical_maximum = float(np.quantile(moving, 0.99))
    is_jump = changes > _JUMP_STEPS * typical_maximum * elapsed_rows
    is_jump &= changes > _JUMP_SHARE * np.ptp(values[known])
    jumps = [int(row) for row in np.flatnonzero(is_jump)]
    if len(jumps) > _MAX_JUMPS:
        return set()
    for row in jumps:
        # The angle moves smoothly before and after its jump.
        neighbours = np.delete(changes[max(row - 5, 0) : row + 6], min(row, 5))
        if float(neighbours.max(initial=0.0)) > 3.0 * typical_maximum:
            return set()
    return {int(known[row + 1]) for row in jumps}
