"""Options of the verbs that learn from flights, identify and diagnose, some of which tune takes too."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from heli_host.cli.simulated import DEFAULT_RIG

DEFAULT_MODEL = "multibody"

FlightsArgument = Annotated[
    list[Path], typer.Argument(metavar="FLIGHT...", help="Flights to fit: .mcap, .csv or .csv.gz.")
]
ValidateOption = Annotated[
    list[Path] | None,
    typer.Option("--validate", metavar="FLIGHT...", help="Other flights, to judge the result on."),
]
KnownRigOption = Annotated[
    str,
    typer.Option(
        "--rig",
        metavar="NAME|FILE",
        help=f"What is known beforehand: values, tolerances.  [default: {DEFAULT_RIG}]",
        show_default=False,
    ),
]
EquationsOption = Annotated[
    str | None,
    typer.Option(
        "--model",
        metavar="NAME",
        help=f"Equations of motion; else those that the rig names, or {DEFAULT_MODEL}.",
        show_default=False,
    ),
]
OwnEffectsOption = Annotated[
    list[Path] | None,
    typer.Option("--effects", metavar="FILE...", help="Python files with effects of your own."),
]
FromOption = Annotated[
    list[float] | None,
    typer.Option(
        "--from",
        "--from-s",
        metavar="S...",
        help="Fit nothing before this time: one for all, or one for each flight, those to validate last.",
    ),
]
ToOption = Annotated[
    list[float] | None,
    typer.Option("--to", "--to-s", metavar="S...", help="Fit nothing from this time on; as --from."),
]
GapsOption = Annotated[
    bool, typer.Option("--allow-gaps", help="Leave out missing rows instead of refusing the flight.")
]
AsIsOption = Annotated[
    bool, typer.Option("--as-is", help="Fit though signs, zeros, units or motion look wrong.")
]
ReportOption = Annotated[
    Path | None, typer.Option("--report", metavar="DIR", help="A page with figures to look at.")
]
NumbersOption = Annotated[
    Path | None,
    typer.Option(
        "--json", metavar="FILE", help="All numbers; - for standard output, which then has nothing else."
    ),
]
FoundRigOption = Annotated[
    Path | None, typer.Option("--out", metavar="FILE", help="The rig found, TOML, to be flown.")
]
