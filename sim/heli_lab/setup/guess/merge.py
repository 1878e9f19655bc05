"""Merge files that together contain one flight, such as angles in one and voltages in another."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from heli_host.data.arrays import Floats
from heli_host.data.tables import Column, Table
from heli_host.data.tables.table import TIME_UNITS
from heli_host.errors import FlightDataError

from heli_lab.setup.guess.times import Clock, clock_of


def merge_tables(tables: Sequence[Table]) -> Table:
    """Merge the columns of several files of one flight, by their times or by their rows.

    A file without times is merged row by row with a file that has times and as many rows. Without any
    times, all files must have equally many rows.

    Parameters
    ----------
    tables : sequence of Table
        The files. All times start at the same moment.

    Returns
    -------
    Table
        Has the name of the first file; each column's name starts with the position of its file, as in
        ``1: time``. The notes state which files were merged row by row.

    Raises
    ------
    FlightDataError
        When a file has neither times nor as many rows as another one.
    """
    aligned = [table.aligned() for table in tables]
    clocks = [clock_of(table) for table in aligned]
    times_s = [_times_s(table, clock) for table, clock in zip(aligned, clocks, strict=True)]
    notes = [table.notes for table in tables]
    columns: dict[str, Column] = {}
    for number, table in enumerate(aligned):
        t_s = times_s[number]
        has_times = t_s is not None
        if t_s is None:
            partner = _merge_partner(number, aligned, times_s)
            t_s = times_s[partner]
            notes.append(
                f"{_file_name(tables[number])} was merged row by row with {_file_name(tables[partner])}"
            )
        for name, column in table.columns.items():
            if not has_times or name != clocks[number].column:
                # The position, not the file's name, so that the profile also fits the next flight.
                columns[f"{number + 1}: {name}"] = Column(column.values, column.unit, t_s)
    return Table(tables[0].source, columns, " / ".join(filter(None, notes)))


def _times_s(table: Table, clock: Clock) -> Floats | None:
    """Return the times of a table [s], shape (n,), as its clock states them; None if it has none."""
    if not clock.column or not clock.unit:
        return None
    times: Floats = table.columns[clock.column].values * TIME_UNITS[clock.unit]
    return times


def _merge_partner(number: int, tables: Sequence[Table], times_s: Sequence[Floats | None]) -> int:
    """Find the file with which a file without times is merged row by row; both are positions in `tables`.
    Shapes: `times_s` (n,).
    """
    rows = len(tables[number])
    no_file_has_times = all(t_s is None for t_s in times_s)
    for other, table in enumerate(tables):
        is_usable = times_s[other] is not None or no_file_has_times
        if other != number and is_usable and len(table) == rows:
            return other
    sizes = ", ".join(f"{_file_name(table)} with {len(table)}" for table in tables)
    raise FlightDataError(
        f"{_file_name(tables[number])}: it has no times, and no other file with times has its {rows} rows "
        f"({sizes})",
        "log the times with each file of one flight, or cut the files to equal lengths",
    )


def _file_name(table: Table) -> str:
    """Name of the file of a table."""
    return Path(table.source).name
