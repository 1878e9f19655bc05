"""``heli-host fly``: fly plans, and leave a log, a summary and a figure."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from heli_host.ui.cli import simulated
from heli_host.ui.cli.again import fly_again
from heli_host.ui.cli.flight_command import FlightOptions, fly_plans
from heli_host.ui.cli.option_group import with_option_groups
from heli_host.ui.cli.verb import Verb


@with_option_groups()
def fly(
    plans: Annotated[
        list[str] | None,
        typer.Argument(metavar="PLAN...", help="Fly these plans: built-in (hover, sine) or TOML files."),
    ] = None,
    again: Annotated[
        Path | None,
        typer.Option("--again", metavar="LOG", help="Repeat the simulated flight of this log exactly."),
    ] = None,
    *,
    options: FlightOptions,
) -> None:
    """Take off, fly plans one after the other, and land.

    Writes the log, a summary and a figure into a new folder, flights/TIME/. With --log, --json or --figure,
    it writes a log, and the other files only if you name them. Ctrl-C lands. A second Ctrl-C stops the
    motors.

    --blind leaves rig, effects and seed out of the log, and seals them by a salted digest. The truth goes to
    LOG.truth.json next to the log. Keep it, and share the other files. `heli-host info LOG --truth
    LOG.truth.json` compares the two.

    --again reads rig, effects, seed, parameters and plans from the log of an earlier flight, and compares the
    samples. Files with effects are code, so the log does not hold them: give them with --effect-file.

    Example: `heli-host fly hover sine --sil --speed 5`
    """
    from heli_host.fly.plan import load_plan

    if not plans and again is None:
        raise typer.BadParameter("no plan is given; name one, such as hover, or give --again LOG")
    if again is not None:
        _refuse_with_again(again, options, plans or ())
        flown = fly_again(again, options)
    else:
        named = list(plans or ())
        flown = fly_plans(options, [load_plan(plan) for plan in named], plan_names=named)
    flown.report()
    flown.write()
    flown.end()


def _refuse_with_again(again: Path, options: FlightOptions, plans: Sequence[str]) -> None:
    """Refuse options that a log gives: a typer.BadParameter that names the first."""
    given_options = {
        **{f"PLAN {plan}": True for plan in plans},
        "--port": options.port is not None and options.port != os.environ.get("HELI_PORT"),
        "--sil": options.sil,
        "--board": options.board,
        "--elf": options.elf,
        "--rig": options.rig,
        "--model": options.model,
        "--effect": options.effect,
        "--speed": options.speed not in ("1", simulated.MAX_SPEED),
        "--seed": options.seed is not None,
        "--blind": options.blind,
        "--gains": options.gains,
        "--params": options.params,
        "--clear-fault": options.clear_fault,
        "--twin": options.twin,
    }
    for name, value in given_options.items():
        if value:
            raise typer.BadParameter(f"--again {again} takes this from the log: {name}; leave it out")


VERB = Verb(fly, "Fly")
