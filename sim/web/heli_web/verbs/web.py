"""``heli-host web``: the page that flies in a browser, as one file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from heli_host.ui.cli.options import EffectOption, RigOption
from heli_host.ui.cli.say import say, say_progress
from heli_host.ui.cli.verb import Verb


def web(
    plans: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[PLAN]...", help="Plans that the page offers.  [default: all built-in plans]"
        ),
    ] = None,
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FILE.html", help="Write the page to FILE.html.")
    ] = Path("heli-lab.html"),
    rig: RigOption = None,
    effect: EffectOption = None,
    laws: Annotated[
        list[Path] | None,
        typer.Option(
            "--law",
            metavar="FILE.py",
            help="Offer this control law too, and run its code. Repeatable.",
            show_default=False,
        ),
    ] = None,
    puzzle: Annotated[
        bool,
        typer.Option("--puzzle", help="Hide the effects, and write them with a seal to FILE.truth.json."),
    ] = False,
) -> None:
    """Write a page that flies the simulated rig in a browser.

    The page is one file that works offline, without an installation. It contains the flight code, the
    emulated Due if its firmware is built, and all effects of the catalogue. With --effect, the page begins
    with these effects. With --puzzle, it hides them, and its logs contain the digest of FILE.truth.json.

    Example: `heli-host web --puzzle --effect cable_spring.travel=0.06 --output puzzle.html`
    """
    from heli_host.board.law_program import read_law

    from heli_web.build import write_page

    programs = [read_law(path, rig) for path in laws or ()]
    lines = write_page(
        output, plans or [], rig, effect or [], puzzle=puzzle, laws=programs, progress=say_progress
    )
    for line in lines:
        say(line)


VERB = Verb(web, "Simulation")
