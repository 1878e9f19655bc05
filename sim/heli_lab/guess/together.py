"""Files that hold one flight together: the angles in one, the voltages in another."""

from __future__ import annotations

from collections.abc import Sequence

from heli_host.errors import FlightDataError
from heli_host.tables import Column, Table
from heli_host.tables.units import TIME_UNITS

from heli_lab.guess.times import clock_of


def together(tables: Sequence[Table]) -> Table:
    """Put the columns of several files of one flight side by side, by the times that each file has.

    Parameters
    ----------
    tables : sequence of Table
        The files, each with a column of times, counted from the same moment.

    Returns
    -------
    Table
        Named after the first file; columns have their file's place before their name.

    Raises
    ------
    FlightDataError
        When a file has no times.
    """
    columns: dict[str, Column] = {}
    for number, table in enumerate(tables, 1):
        aligned = table.aligned()
        clock = clock_of(aligned)
        if not clock.column or not clock.unit:
            raise FlightDataError(
                f"{table.source}: no column is the time ({clock.other})", "files of one flight need times"
            )
        t_s = aligned.columns[clock.column].values * TIME_UNITS[clock.unit]
        for name, column in aligned.columns.items():
            if name != clock.column:
                # By its place, not its file's name: a profile of one flight is that of the next.
                columns[f"{number}: {name}"] = Column(column.values, column.unit, t_s)
    return Table(tables[0].source, columns, " / ".join(filter(None, (part.notes for part in tables))))
