"""Content of a file from another program: named columns of numbers, whose meaning is not yet known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from heli_host.arrays import Floats
from heli_host.errors import FlightDataError

SHARED_TIME = "time [s]"
"""Name of the time that columns of different clocks are brought to."""


@dataclass(frozen=True)
class Column:
    """One column as the file has it."""

    values: Floats  # (n,): Numbers; nan where a cell is empty
    unit: str = ""  # Unit that the file states; empty if it states none
    t_s: Floats | None = None
    """(n,): Separate times of the column, if the file has them for each signal (bags, Simulink). None if the
    rows of the column are those of the table."""


@dataclass(frozen=True)
class Table:
    """Columns of one file."""

    source: str  # The file, for messages
    columns: Mapping[str, Column]
    """Columns by their names in the file, or `column 1` and so on if the file has no names."""
    notes: str = ""  # Notes in the file
    named: bool = True  # Whether the file contains the names

    def __len__(self) -> int:
        return max((column.values.size for column in self.columns.values()), default=0)

    def aligned(self) -> Table:
        """Bring all columns to the clock of the column with the most rows.

        At each time, the other columns have their last value up to that time. If no column has separate
        times, the columns are not resampled. Columns shorter than the longest are then omitted, and so are
        rows of zeros at the end, which come from a buffer that is too long.
        """
        timed = {name: column for name, column in self.columns.items() if column.t_s is not None}
        if not timed:
            length = len(self)
            longest_columns = {
                name: column for name, column in self.columns.items() if column.values.size == length
            }
            used_count = _rows_before_trailing_zeros([column.values for column in longest_columns.values()])
            if used_count < length:
                longest_columns = {
                    name: Column(column.values[:used_count], column.unit)
                    for name, column in longest_columns.items()
                }
            return Table(self.source, longest_columns, self.notes, self.named)
        fullest = max(timed.values(), key=lambda column: column.values.size)
        assert fullest.t_s is not None
        start_s = max(
            float(column.t_s[0]) for column in timed.values() if column.t_s is not None and column.t_s.size
        )
        t_s = fullest.t_s[fullest.t_s >= start_s]
        if t_s.size < 2:
            raise FlightDataError(
                f"{self.source}: its signals have no common time span", "give the signals of one flight"
            )
        columns = {SHARED_TIME: Column(t_s - t_s[0], "s")}
        for name, column in timed.items():
            assert column.t_s is not None
            if column.t_s.size:
                last_rows = np.clip(np.searchsorted(column.t_s, t_s, side="right") - 1, 0, None)
                columns[name] = Column(column.values[last_rows], column.unit)
        return Table(self.source, columns, self.notes, self.named)


def _rows_before_trailing_zeros(columns: list[Floats]) -> int:
    """How many rows there are before those at the end in which every column, time too, is 0."""
    length = columns[0].size if columns else 0
    last = 0
    for values in columns:
        filled = np.flatnonzero(values != 0.0)
        last = max(last, int(filled[-1]) + 1 if filled.size else 0)
    return last if len(columns) > 1 and last else length
