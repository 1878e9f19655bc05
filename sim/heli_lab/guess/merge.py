"""Merge files that together contain one flight, such as angles in one and voltages in another."""

from __future__ import annotations

from collections.abc import Sequence

from heli_host.errors import FlightDataError
from heli_host.tables import Column, Table
from heli_host.tables.units import TIME_UNITS

from heli_lab.guess.times import clock_of


def merge_tables(tables: Sequence[Table]) -> Table:
    """Merge the columns of several files of one flight by their times.

    Parameters
    ----------
    tables : sequence of Table
        The files. Each has a column of times, and all times start at the same moment.

    Returns
    -------
    Table
        Has the name of the first file; each column's name starts with the position of its file, as in
        ``1: time``.

    Raises
    ------
    FlightDataError
        When a file has no column of times.
    """
    columns: dict[str, Column] = {}
    for number, table in enumerate(tables, 1):
        aligned = table.aligned()
        clock = clock_of(aligned)
        if not clock.column or not clock.unit:
            raise FlightDataError(
                f"{table.source}: no column is the time ({clock.alternative})",
                "each file of one flight needs a column of times",
            )
        t_s = aligned.columns[clock.column].values * TIME_UNITS[clock.unit]
        for name, column in aligned.columns.items():
            if name != clock.column:
                # The position, not the file's name, so that the profile also fits the next flight.
                columns[f"{number}: {name}"] = Column(column.values, column.unit, t_s)
    return Table(tables[0].source, columns, " / ".join(filter(None, (part.notes for part in tables))))
