"""Options about what flies in the simulation: model and effects."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

ModelOption = Annotated[
    str | None,
    typer.Option(
        "--model",
        metavar="NAME",
        help="Model simulated: multibody, paper, ...; else the one that the rig's file names, or multibody.",
        show_default=False,
    ),
]
EffectOption = Annotated[
    list[str] | None,
    typer.Option(
        "--effect",
        metavar="ID[=VALUE]",
        help="Effect simulated beyond the model, such as rotor_lag=0.1 or thrust_step.front=0.1@25; may be "
        "repeated. docs/effects.md lists them.",
        show_default=False,
    ),
]
EffectFilesOption = Annotated[
    list[Path] | None,
    typer.Option("--effects", metavar="FILE.py", help="More effects; may be repeated.", show_default=False),
]


def plant_options(
    model: str | None, effect: list[str] | None, files: list[Path] | None, *, simulated: bool
) -> dict[str, str]:
    """Spell model and effects as a ``sil://`` address does.

    Parameters
    ----------
    model : str or None
        Name of the model.
    effect : list of str or None
        Effects.
    files : list of Path or None
        Files of effects.
    simulated : bool
        Whether the board is simulated.

    Returns
    -------
    dict of str
        Options of the simulated board; empty for its own model.

    Raises
    ------
    typer.BadParameter
        If a real board should have a model or effects.
    """
    given = {
        "model": model or "",
        "effect": ";".join(effect or ()),
        "effects": ";".join(str(path.absolute()) for path in files or ()),
    }
    options = {key: value for key, value in given.items() if value}
    if options and not simulated:
        raise typer.BadParameter("--model, --effect and --effects are for a simulated board; add --sil")
    return options
