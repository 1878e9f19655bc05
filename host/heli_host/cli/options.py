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
        help="Board: /dev/ttyACM0, COM3, socket://host:port, ... Without it: the only Due plugged in.",
        envvar="HELI_PORT",
        show_default=False,
    ),
]
ClearFaultOption = Annotated[bool, typer.Option("--clear-fault", help="Clear a latched fault first.")]


def flight_folder(base: Path = Path("flights")) -> Path:
    """Make the folder of a new flight, named after the local time.

    Parameters
    ----------
    base : Path
        Where the folders of all flights are.

    Returns
    -------
    Path
        A folder that did not exist before.
    """
    import time

    name = time.strftime("%Y-%m-%d_%H-%M-%S")
    for suffix in ("", *(f"_{number}" for number in range(2, 100))):
        folder = base / f"{name}{suffix}"
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            continue
        return folder
    raise typer.BadParameter(f"there are a hundred flights of this second in {base}; wait a moment")
