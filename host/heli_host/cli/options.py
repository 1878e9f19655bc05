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
JsonFlag = Annotated[bool, typer.Option("--json", help="One JSON object instead of text.")]
ForOption = Annotated[
    float | None, typer.Option("--for-s", metavar="S", min=0.001, help="How long; else until Ctrl-C.")
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
    raise typer.BadParameter(f"there are a hundred flights of this second in {base}; wait a moment")
