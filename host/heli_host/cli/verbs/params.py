"""``heli-host params``: the board's parameters."""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from heli_host.cli.options import JsonFlag, PortOption
from heli_host.cli.say import say, say_json
from heli_host.cli.simulated import MAX_SPEED, SilOption, sil_address
from heli_host.cli.verb import Verb

if TYPE_CHECKING:
    from heli_host.heli import Heli

app = typer.Typer(
    help="Read and set the board's parameters.\n\nExample: `heli-host params set hover_V 1.5 --save`",
    no_args_is_help=True,
    rich_markup_mode="markdown",
)

NameArgument = Annotated[str, typer.Argument(metavar="NAME", help="Parameter, as params list shows it.")]
SaveOption = Annotated[bool, typer.Option("--save", help="Write all parameters to the board's flash too.")]


@app.command("list")
def list_parameters(
    pattern: Annotated[str, typer.Argument(metavar="[TEXT]", help="Only names that contain it.")] = "",
    long: Annotated[bool, typer.Option("--long", "-l", help="Say what each means too.")] = False,
    port: PortOption = None,
    sil: SilOption = False,
    json: JsonFlag = False,
) -> None:
    """List names, values, units and ranges; a star marks what differs from the default.

    Example: `heli-host params list pitch --long`
    """
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from heli_host.controllers import controller_names

    with _board(port, sil) as heli:
        values = heli.params.dump()
        names = controller_names(heli.session)
        if json:
            specs = {name: heli.params.spec(name) for name in values if pattern in name}
            say_json(
                {
                    name: {
                        "value": values[name],
                        "unit": spec.unit,
                        "min": spec.min,
                        "max": spec.max,
                        "default": spec.default,
                        "meaning": spec.meaning,
                        **({"names": names} if name == "controller" else {}),
                    }
                    for name, spec in specs.items()
                }
            )
            return
        table = Table(box=None, pad_edge=False)
        for heading in ("name", "", "value", "unit", "range", *(("meaning",) if long else ())):
            table.add_column(heading, no_wrap=heading != "meaning")
        for name, value in values.items():
            spec = heli.params.spec(name)
            if pattern in name:
                text = _with_names(spec.meaning, names) if name == "controller" else spec.meaning
                meaning = (escape(text),) if long else ()
                mark = "" if abs(value - spec.default) <= 1e-6 * max(1.0, abs(value)) else "*"
                limits = f"{spec.min:g} .. {spec.max:g}"
                table.add_row(name, mark, f"{value:g}", spec.unit, limits, *meaning)
    if not table.row_count:
        raise typer.BadParameter(f"no parameter's name contains '{pattern}'")
    Console(highlight=False).print(table)


@app.command("get")
def get(name: NameArgument, port: PortOption = None, sil: SilOption = False, json: JsonFlag = False) -> None:
    """Print one parameter's value.

    Example: `heli-host params get hover_V`
    """
    from heli_host.parameters import spec_of

    spec = spec_of(name)
    with _board(port, sil) as heli:
        if json:
            say_json({"name": name, "value": heli.params[name], "unit": spec.unit})
        else:
            say(f"{heli.params[name]:g}")


@app.command("set", context_settings={"ignore_unknown_options": True})
def set_parameter(
    name: NameArgument,
    value: Annotated[float, typer.Argument(metavar="VALUE", help="New value, in the parameter's unit.")],
    save: SaveOption = False,
    port: PortOption = None,
    sil: SilOption = False,
) -> None:
    """Set one parameter, in the board's memory or for good.

    Example: `heli-host params set hover_V 1.5 --save`
    """
    from heli_host.parameters import checked

    spec = checked(name, value)
    with _board(port, sil) as heli:
        before = heli.params[name]
        in_force = heli.params.set(name, value)
        unit = f" {spec.unit}" if spec.unit else ""
        say(f"{name}: {before:g} -> {in_force:g}{unit}{_saved(heli.params.save() if save else None)}")


@app.command("save")
def save_parameters(port: PortOption = None, sil: SilOption = False) -> None:
    """Write all parameters to the board's flash; only while it is idle.

    Example: `heli-host params save`
    """
    with _board(port, sil) as heli:
        say(f"parameters saved, generation {heli.params.save()}")


@app.command("dump")
def dump(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="TOML file to write.")],
    port: PortOption = None,
    sil: SilOption = False,
) -> None:
    """Write all parameters into a TOML file.

    Example: `heli-host params dump rig7.toml`
    """
    from heli_host.cli.board import board_versions
    from heli_host.parameter_file import parameters_text

    with _board(port, sil) as heli:
        values = heli.params.dump()
        comment = board_versions(heli.info)
    file.write_text(parameters_text(values, comment), encoding="utf-8")
    say(f"{len(values)} parameters -> {file}")


@app.command("restore")
def restore(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="TOML file that params dump wrote.")],
    save: SaveOption = False,
    port: PortOption = None,
    sil: SilOption = False,
) -> None:
    """Set all parameters of a file; if the board refuses one, none is set.

    From a file of another parameter schema, known parameters are kept, and the others are listed.

    Example: `heli-host params restore rig7.toml --save`
    """
    from heli_host.parameter_file import read_parameter_set

    given = read_parameter_set(file)
    values = given.values
    for reason in given.dropped:
        say(f"dropped: {reason}")
    with _board(port, sil) as heli:
        for name in given.new:
            say(f"not in {file}: {name} stays {heli.params[name]:g}")
        changed = heli.params.restore(values)
        for name, value in changed.items():
            say(f"{name} -> {value:g}")
        say(f"{len(changed)} of {len(values)} changed{_saved(heli.params.save() if save else None)}")


def _board(port: str | None, sil: bool) -> AbstractContextManager[Heli]:
    from heli_host.cli.board import open_board

    return open_board(port, sil_address(speed=MAX_SPEED) if sil else None)


def _with_names(meaning: str, names: tuple[str, ...]) -> str:
    return f"{meaning}: {', '.join(f'{row} is {name}' for row, name in enumerate(names))}"


def _saved(generation: int | None) -> str:
    return ", not saved (lost when the board restarts)" if generation is None else ", saved to flash"


VERB = Verb(app, "Board")
