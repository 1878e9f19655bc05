"""Options that several verbs share."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from heli_sim.sil.boards import Choice

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
BoardOption = Annotated[
    str | None,
    typer.Option(
        "--board",
        metavar="native|due|auto",
        help="Board simulated: the flight code on this machine, or its ELF on an emulated Due; auto: the Due "
        "when there is an ELF.  [default: native]",
        show_default=False,
    ),
]
ElfOption = Annotated[
    Path | None,
    typer.Option("--elf", metavar="FILE", help="ELF for the emulated Due; else the newest that is built."),
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
BOARDS = ("native", "due", "auto")


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


def choose_board(board: str | None, elf: Path | None, *, simulated: bool) -> Choice | None:
    """Settle which simulated board is meant.

    Parameters
    ----------
    board : str or None
        ``--board``; None for the native one, or the Due when there is an `elf`.
    elf : Path or None
        ``--elf``.
    simulated : bool
        Whether a simulated board is asked for at all.

    Returns
    -------
    Choice or None
        None for a real board.

    Raises
    ------
    typer.BadParameter
        When the options contradict each other.
    SimError
        When there is no firmware for the emulated Due, or only for another version of the link.
    """
    if not simulated:
        if board is not None or elf is not None:
            raise typer.BadParameter("--board and --elf are for a simulated board; add --sil")
        return None
    board = board if board is not None else ("due" if elf is not None else "native")
    if board not in BOARDS:
        raise typer.BadParameter(f"--board takes {', '.join(BOARDS)}, not '{board}'")
    if board == "native" and elf is not None:
        raise typer.BadParameter("--elf runs on --board due only; leave one of them out")
    from heli_sim.sil.boards import choose

    return choose(board, str(elf) if elf is not None else "")


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
