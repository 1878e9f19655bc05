"""Options of a simulated board, and the address that they spell.

Nothing here simulates: a ``sil://`` address is opened by whichever package provides such transports.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Final
from urllib.parse import urlencode

import typer

DEFAULT_RIG: Final = "makki2024"
MAX_SPEED: Final = "max"
BOARDS: Final = ("native", "due", "auto")

SilOption = Annotated[bool, typer.Option("--sil", help="Use the simulated board.")]
RigOption = Annotated[
    str | None,
    typer.Option(
        "--rig",
        metavar="NAME|FILE",
        help="Simulate this rig, or compare the real board with it.  [default: makki2024 with --sil]",
    ),
]
BoardOption = Annotated[
    str | None,
    typer.Option(
        "--board",
        metavar="native|due|auto",
        help="Run the flight code natively, on an emulated Due, or choose automatically.  [default: native]",
        show_default=False,
    ),
]
ElfOption = Annotated[
    Path | None,
    typer.Option(
        "--elf", metavar="FILE", help="Run this firmware on the emulated Due.  [default: newest build]"
    ),
]
ModelOption = Annotated[
    str | None,
    typer.Option(
        "--model",
        metavar="NAME",
        help="Simulate these equations of motion.  [default: the rig's, or multibody]",
        show_default=False,
    ),
]
EffectOption = Annotated[
    list[str] | None,
    typer.Option(
        "--effect",
        metavar="ID[=VALUE]",
        help="Add an effect to the simulation, such as rotor_lag=0.1. Repeatable.",
        show_default=False,
    ),
]
EffectFilesOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--effect-file",
        metavar="FILE.py",
        help="Load effects from this file, and run its code. Repeatable.",
        show_default=False,
    ),
]
SpeedOption = Annotated[
    str,
    typer.Option("--speed", metavar="N|max", help="Simulate N seconds per second, or as fast as possible."),
]
SeedOption = Annotated[int, typer.Option("--seed", min=0, help="Seed all random numbers of the simulation.")]
FlightSeedOption = Annotated[
    int | None,
    typer.Option(
        "--seed",
        metavar="N",
        min=0,
        help="Seed all random numbers of the simulation.  [default: 1, random with --blind]",
        show_default=False,
    ),
]
BlindOption = Annotated[
    bool,
    typer.Option("--blind", help="Hide rig, effects and seed in all files but LOG.truth.json."),
]


def rig_name(rig: str | None, *, simulated: bool) -> str:
    """Return the name of the requested `rig` for the log. Without a rig, return the default rig if
    `simulated`, otherwise an empty text.
    """
    if rig is not None:
        return Path(rig).stem
    return DEFAULT_RIG if simulated else ""


def parse_speed(text: str) -> float | None:
    """Read the `text` of a ``--speed``, a positive number or ``max``, as simulated seconds a second; None for
    ``max``. Anything else is a typer.BadParameter.
    """
    if text == MAX_SPEED:
        return None
    try:
        speed = float(text)
    except ValueError:
        speed = 0.0
    if not 0.0 < speed < 1e4:
        raise typer.BadParameter(
            f"invalid --speed '{text}'; give a number between 0 and 10000, or {MAX_SPEED}"
        )
    return speed


def which_board(board: str | None, elf: Path | None) -> str:
    """Settle which simulated `board` is meant: without a name the native one, or the Due when there is an
    `elf`. A typer.BadParameter when the two contradict each other.
    """
    board = board if board is not None else ("due" if elf is not None else "native")
    if board not in BOARDS:
        raise typer.BadParameter(f"unknown --board '{board}'; choose {', '.join(BOARDS)}")
    if board == "native" and elf is not None:
        raise typer.BadParameter("--elf needs the emulated Due; add --board due, or leave one of them out")
    return board


def sil_address(
    *,
    rig: str | None = None,
    speed: str = "1",
    seed: int = 1,
    board: str | None = None,
    elf: Path | None = None,
    model: str | None = None,
    effect: Sequence[str] | None = None,
    effect_files: Sequence[Path] | None = None,
) -> str:
    """Return the address of a simulated board, for ``heli_host.connect``."""
    factor = parse_speed(speed)
    options = {
        "rig": rig if rig is not None else DEFAULT_RIG,
        "seed": str(seed),
        "speed": MAX_SPEED if factor is None else repr(factor),
        "process": "" if factor is None else "1",
        "board": which_board(board, elf),
        "elf": str(elf) if elf is not None else "",
        "model": model or "",
        "effect": ";".join(effect or ()),
        "effects": ";".join(str(path.absolute()) for path in effect_files or ()),
    }
    return "sil://?" + urlencode({key: value for key, value in options.items() if value})


def flown(
    address: str,
    *,
    rig: str | None,
    model: str | None,
    effect: Sequence[str] | None,
    effect_files: Sequence[Path] | None,
    seed: int,
    plans: Sequence[str],
) -> dict[str, object]:
    """Return all settings of a simulated flight, for the truth file of a blind flight."""
    files = [*([Path(rig)] if rig is not None else []), *(effect_files or ())]
    return {
        "rig": rig if rig is not None else DEFAULT_RIG,
        "model": model or "",
        "effects": list(effect or ()),
        "seed": seed,
        "plans": list(plans),
        "address": address,
        "files": {
            str(file): file.read_text(encoding="utf-8", errors="replace") for file in files if file.is_file()
        },
    }


def refuse_without_sil(**options: object) -> None:
    """Refuse options of a simulated board if a real board is used."""
    used_options = [f"--{name.replace('_', '-')}" for name, value in options.items() if value]
    if used_options:
        verb = "is" if len(used_options) == 1 else "are"
        raise typer.BadParameter(f"{' and '.join(used_options)} {verb} for a simulated board only; add --sil")
