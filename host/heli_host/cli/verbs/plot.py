"""``heli-host plot``: a log as a figure."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from heli_host.cli.verb import Verb


def plot(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="A .mcap log.")],
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="FILE", help="A .png, .pdf or .svg; else figure.png beside it."),
    ] = None,
) -> None:
    """Draw setpoints, angles, voltages and events of a log.

    Example: `heli-host plot flights/2026-01-31_12-00-00/flight.mcap -o flight.pdf`
    """
    from heli_host.log.figure import write_figure
    from heli_host.log.reader import read_log
    from heli_host.log.summary import summarise

    read = read_log(log)
    target = out if out is not None else log.with_name("figure.png")
    write_figure(read.flight(), summarise(read), target)
    print(f"{read.ticks.size} ticks -> {target}")


VERB = Verb(plot, "Logs")
