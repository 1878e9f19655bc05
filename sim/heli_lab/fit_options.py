"""Command-line options shared by identify and diagnose, and some of them by tune, pool and law."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from heli_host.ui.cli.simulated import DEFAULT_RIG

DEFAULT_MODEL = "multibody"

FlightsArgument = Annotated[
    list[Path],
    typer.Argument(metavar="FLIGHT...", help="Fit the model to these: .mcap, .csv or .csv.gz."),
]
ValidateOption = Annotated[
    list[Path] | None,
    typer.Option("--validate", metavar="FLIGHT...", help="Check the result on these other flights."),
]
KnownRigOption = Annotated[
    str,
    typer.Option(
        "--rig",
        metavar="NAME|FILE",
        help=f"Use this rig's parameters and tolerances as priors.  [default: {DEFAULT_RIG}]",
        show_default=False,
    ),
]
EquationsOption = Annotated[
    str | None,
    typer.Option(
        "--model",
        metavar="NAME",
        help=f"Use these equations of motion.  [default: the rig's, or {DEFAULT_MODEL}]",
        show_default=False,
    ),
]
OwnEffectsOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--effect-file", metavar="FILE.py...", help="Add the effects of these files, and run their code."
    ),
]
FromOption = Annotated[
    list[float] | None,
    typer.Option(
        "--from",
        "--from-s",
        metavar="S...",
        help="Ignore rows before this time in s: one for all fitted flights, or one each.",
    ),
]
ToOption = Annotated[
    list[float] | None,
    typer.Option(
        "--to",
        "--to-s",
        metavar="S...",
        help="Ignore rows from this time in s on: one value or several, as for --from.",
    ),
]
GapsOption = Annotated[
    bool, typer.Option("--allow-gaps", help="Skip missing rows instead of refusing the flight.")
]
SkipSignCheckOption = Annotated[
    bool, typer.Option("--skip-sign-check", help="Fit even if signs, zeros, units or motion look wrong.")
]
ReportOption = Annotated[
    Path | None,
    typer.Option("--report", metavar="DIR", help="Write an HTML report with figures into this folder."),
]
SaveRigOption = Annotated[
    Path | None, typer.Option("--save-rig", metavar="FILE", help="Write the estimated rig, TOML.")
]
SeedsOption = Annotated[
    int, typer.Option("--seeds", metavar="N", min=1, max=100, help="Fly N times, with the seeds 1 to N.")
]
