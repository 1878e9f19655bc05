"""Options that several verbs share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

PortOption = Annotated[
    str | None,
    typer.Option(
        "--port",
        "-p",
        metavar="URL",
        help="Open the board on this port: /dev/ttyACM0, COM3, socket://HOST:PORT.",
        envvar="HELI_PORT",
        show_default=False,
    ),
]
JsonOption = Annotated[
    Path | None,
    typer.Option("--json", metavar="FILE", help="Write the result as JSON, to standard output for -."),
]
SchedulerOption = Annotated[
    str | None,
    typer.Option(
        "--scheduler",
        metavar="ADDRESS",
        help="Use a Dask cluster, such as tcp://10.0.0.1:8786.  [default: this machine]",
        show_default=False,
    ),
]
DurationOption = Annotated[
    float | None,
    typer.Option(
        "--duration",
        metavar="S",
        min=0.001,
        help="Stop after this time in s.  [default: until Ctrl-C]",
        show_default=False,
    ),
]
LogOption = Annotated[
    Path | None, typer.Option("--log", metavar="FILE", help="Write the log to this file, .mcap.")
]
FigureOption = Annotated[
    Path | None,
    typer.Option("--figure", metavar="FILE", help="Draw a figure to this file: .png, .pdf or .svg."),
]
FoxgloveOption = Annotated[
    int | None,
    typer.Option(
        "--foxglove",
        metavar="PORT",
        min=0,
        max=65535,
        help="Serve live samples to viewers on this local port, 0 for a free one.",
        show_default=False,
    ),
]
ClearFaultOption = Annotated[bool, typer.Option("--clear-fault", help="Clear a latched fault first.")]


def flight_folder(base: Path = Path("flights")) -> Path:
    """Make the folder of a new flight in `base`, named after the local time; it did not exist before."""
    import time

    name = time.strftime("%Y-%m-%d_%H-%M-%S")
    for suffix in ("", *(f"_{number}" for number in range(2, 100))):
        folder = base / f"{name}{suffix}"
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            continue
        return folder
    raise typer.BadParameter(f"{base} already has 100 flights of this second; try again in a second")
