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
SilOption = Annotated[bool, typer.Option("--sil", help="Fly the simulated board instead.")]
RigOption = Annotated[
    str | None,
    typer.Option(
        "--rig", metavar="NAME|FILE", help="Rig simulated: a name or a TOML file; of a real board: its name."
    ),
]
SpeedOption = Annotated[
    str,
    typer.Option("--speed", metavar="N|max", help="Simulated seconds a second, or max: as fast as possible."),
]
ClearFaultOption = Annotated[bool, typer.Option("--clear-fault", help="Clear a latched fault first.")]
SeedOption = Annotated[
    int, typer.Option("--seed", min=0, help="Seed of everything random in the simulation.")
]

DEFAULT_RIG = "makki2024"
MAX_SPEED = "max"


def rig_name(rig: str | None, *, simulated: bool) -> str:
    """Name a rig for the log.

    Parameters
    ----------
    rig : str or None
        What was asked for.
    simulated : bool
        Whether the board is simulated; without a name it then is the default rig.

    Returns
    -------
    str
        Empty when nobody knows.
    """
    if rig is not None:
        return Path(rig).stem
    return DEFAULT_RIG if simulated else ""


def parse_speed(text: str) -> float | None:
    """Read a ``--speed``.

    Parameters
    ----------
    text : str
        A positive number, or ``max``.

    Returns
    -------
    float or None
        Simulated seconds a second; None for ``max``.

    Raises
    ------
    typer.BadParameter
        If it is neither.
    """
    if text == MAX_SPEED:
        return None
    try:
        speed = float(text)
    except ValueError:
        speed = 0.0
    if not 0.0 < speed < 1e4:
        raise typer.BadParameter(f"--speed takes a number between 0 and 10000, or {MAX_SPEED}, not '{text}'")
    return speed


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
