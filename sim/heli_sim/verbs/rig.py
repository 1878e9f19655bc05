"""``heli-host rig``: rigs as files of numbers, each with its unit, tolerance and source."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated

import typer
from heli_host.cli.verb import Verb
from heli_host.errors import printable

if TYPE_CHECKING:
    from rich.console import Console

    from heli_sim.rig import Number, Rig

WIDE = 160
"""Columns of a table that does not go to a terminal."""

app = typer.Typer(
    help="Look at rigs: their numbers, whether a rig can be, and how two differ."
    "\n\nExample: `heli-host rig diff makki2024 makki2024-identified`",
    no_args_is_help=True,
    rich_markup_mode="markdown",
)

RigArgument = Annotated[str, typer.Argument(metavar="NAME|FILE", help="Rig: a name or a TOML file.")]


@app.command("list")
def list_rigs() -> None:
    """List the rigs that come with the package.

    Example: `heli-host rig list`
    """
    from heli_sim.rig import load_rig, rig_names

    for name in rig_names():
        print(f"{name}: {load_rig(name).description}")


@app.command("show")
def show(
    rig: RigArgument,
    pattern: Annotated[str, typer.Argument(metavar="[TEXT]", help="Only names that contain it.")] = "",
) -> None:
    """Show a rig's numbers: value, tolerance, unit, what each is and where it comes from.

    The tolerance is the half width that holds the true value with about 95 % confidence.

    Example: `heli-host rig show makki2024 friction`
    """
    from rich.table import Table

    from heli_sim.rig import RIG_QUANTITIES, load_rig

    shown = load_rig(rig)
    meanings = {quantity.name: quantity.meaning for quantity in RIG_QUANTITIES}
    table = Table(box=None, pad_edge=False)
    for heading in ("name", "value", "+-", "unit"):
        table.add_column(heading, no_wrap=True)
    table.add_column("meaning; source", overflow="fold")
    for name, number in shown.items():
        if pattern in name:
            text = f"{meanings[name]}; {number.source}"
            table.add_row(name, f"{number.value:g}", _half_width(number), number.unit, _plain(text))
    for effect, numbers in shown.effects.items():
        for name, number in numbers.items():
            if pattern in f"{effect}.{name}":
                table.add_row(
                    f"{effect}.{name}",
                    f"{number.value:g}",
                    _half_width(number),
                    number.unit,
                    _plain(f"effect; {number.source}"),
                )
    if not table.row_count:
        raise typer.BadParameter(f"no number's name contains '{pattern}'")
    console = _console()
    console.print(f"{_plain(shown.name)}: {_plain(shown.description)}")
    console.print(table)


def _plain(text: str) -> str:
    from rich.markup import escape

    return escape(printable(text))


@app.command("check")
def check(
    rigs: Annotated[list[str], typer.Argument(metavar="NAME|FILE...", help="Rigs: names or TOML files.")],
) -> None:
    """Say whether rigs can be: complete, in the right units, no mass or inertia that none can have.

    Of each that can, also what its numbers give: inertias, weight at the rotors, voltage at hover.

    Example: `heli-host rig check my-rig.toml`
    """
    from heli_sim.errors import EffectError, RigError
    from heli_sim.model.effects import effects_of
    from heli_sim.rig import load_rig

    refused: list[RigError | EffectError] = []
    for name in rigs:
        try:
            rig = load_rig(name)
            effects_of(rig)
        except (RigError, EffectError) as error:
            if len(rigs) > 1:
                print(f"{name}: {error}")
            refused.append(error)
            continue
        print(f"{name}: {'; '.join(_found(rig))}")
    if len(rigs) > 1 and refused:
        raise RigError(f"{len(refused)} of {len(rigs)} rigs cannot be, see above", "correct them")
    if refused:
        raise refused[0]


@app.command("diff")
def diff(
    left: RigArgument,
    right: RigArgument,
    show_all: Annotated[bool, typer.Option("--all", "-a", help="Show what is the same too.")] = False,
) -> None:
    """Compare two rigs, number by number, in tolerances. A star: beyond +-1, so not the same rig.

    The unit is both tolerances together, as the root of the sum of their squares.

    Example: `heli-host rig diff makki2024 makki2024-identified`
    """
    from rich.table import Table

    from heli_sim.rig import load_rig
    from heli_sim.rig.compare import compare_rigs

    first, second = load_rig(left), load_rig(right)
    compared = compare_rigs(first, second)
    table = Table(box=None, pad_edge=False)
    for heading in ("name", first.name, second.name, "unit", "tolerances"):
        table.add_column(heading, overflow="fold", no_wrap=heading == "name")
    for one in compared:
        if show_all or not one.same:
            known = one.left or one.right
            table.add_row(
                one.name,
                _with_tolerance(one.left),
                _with_tolerance(one.right),
                known.unit if known is not None else "",
                _signed(one.tolerances),
            )
    if table.row_count:
        _console().print(table)
    differing = sum(not one.same for one in compared)
    beyond = sum(abs(one.tolerances) > 1.0 for one in compared)
    print(f"{differing} of {len(compared)} numbers differ, {beyond} beyond their tolerances")


def _found(rig: Rig) -> list[str]:
    """What a rig's numbers give together."""
    from heli_sim.errors import PlantError
    from heli_sim.model import MultibodyModel
    from heli_sim.model.linear import trim
    from heli_sim.rig.inertia import inertias_kg_m2

    inertias = inertias_kg_m2({name: number.value for name, number in rig.items()})
    found = [
        f"{len(rig)} numbers",
        ", ".join(f"{name} {value:.4g}" for name, value in inertias.items()) + " kg m2",
    ]
    try:
        front_V, back_V = trim(MultibodyModel(), rig).volts_V
        found.append(f"hovers at {front_V:.2f} and {back_V:.2f} V")
        if max(front_V, back_V) > rig["supply"].value:
            found.append(f"more than its supply of {rig['supply'].value:g} V: it cannot fly")
    except PlantError as error:
        found.append(f"does not hover: {error}")
    return found


def _console() -> Console:
    from rich.console import Console

    console = Console(highlight=False)
    # A file or another program has no width; rich would take 80 columns and cut.
    return console if console.is_terminal else Console(highlight=False, width=WIDE)


def _half_width(number: Number) -> str:
    return f"{number.tolerance:g}" if number.tolerance else "exact"


def _with_tolerance(number: Number | None) -> str:
    if number is None:
        return "-"
    return f"{number.value:g} +-{number.tolerance:g}" if number.tolerance else f"{number.value:g}"


def _signed(tolerances: float) -> str:
    if math.isinf(tolerances):
        return "no tolerance"
    return f"{tolerances:+.1f}{' *' if abs(tolerances) > 1.0 else ''}"


VERB = Verb(app, "Simulation")
