"""The newest numbers of a board as a table for a terminal of 80 columns; what `watch` and `fly` show live."""

from __future__ import annotations

from collections.abc import Mapping
from math import degrees
from typing import TYPE_CHECKING

from heli_host.declaration import AXES

if TYPE_CHECKING:
    from rich.table import Table

    from heli_host.board.samples import Sample


def numbers_table(
    sample: Sample, counts: Mapping[str, int] | None = None, illegal: Mapping[str, int] | None = None
) -> Table:
    """Make the table: a row for each axis and one for the motors."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column("", no_wrap=True)
    for heading in ("is", "setpoint", *(("count",) if counts else ()), *(("bad edges",) if illegal else ())):
        table.add_column(heading, justify="right", no_wrap=True)
    for axis in AXES:
        is_deg = degrees(getattr(sample, f"{axis}_rad"))
        goal_deg = degrees(getattr(sample, f"{axis}_setpoint_rad"))
        row = [axis, f"{is_deg:+8.2f} deg", f"{goal_deg:+8.2f} deg"]
        row += [f"{counts[axis]:+d}"] if counts else []
        if illegal:
            row.append(f"[bold red]{illegal[axis]}[/]" if illegal[axis] else "0")
        table.add_row(*row)
    table.add_row("front, back", f"{sample.front_V:+8.2f} V  ", f"{sample.back_V:+8.2f} V  ")
    return table
