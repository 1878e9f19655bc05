"""The options ``--gains`` and ``--params``: gains to fly with, other than the board's own."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer

GainsOption = Annotated[
    str | None,
    typer.Option(
        "--gains",
        metavar="paper|paper-printed",
        help="Use the gains of the paper's Table 6, in simulation only.",
        show_default=False,
    ),
]
ParamsFileOption = Annotated[
    Path | None,
    typer.Option(
        "--params",
        metavar="FILE",
        help="Fly with the parameters of this file, and do not save them.",
    ),
]


def chosen_parameters(file: Path | None, gains: str | None) -> Mapping[str, float]:
    """Read and check a file of parameters, and return its values by name.

    If a file has another parameter schema, its known parameters are used, and the others are printed.
    """
    from heli_host.board.parameters import read_parameter_set
    from heli_host.ui.cli.say import say_dropped

    if file is None:
        return {}
    if gains is not None:
        raise typer.BadParameter("--gains and --params both set the gains; leave one of them out")
    parameter_set = read_parameter_set(file)
    say_dropped(parameter_set.dropped)
    return parameter_set.values


def check_gains(gains: str | None, sil: bool) -> None:
    """Refuse `gains` that are unknown, or that only a simulated board (`sil`) should fly: a
    typer.BadParameter.
    """
    from heli_host.board.parameters import SETS

    if gains is None:
        return
    if gains not in SETS:
        raise typer.BadParameter(f"unknown --gains '{gains}'; choose {' or '.join(SETS)}")
    if not sil:
        raise typer.BadParameter(
            f"--gains {gains} is unstable with the thrust lag of real rotors; add --sil, "
            "or set the gains one by one with heli-host params"
        )
