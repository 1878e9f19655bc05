"""``heli-host params``: the board's parameters."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from heli_host.data.files import write_signed
from heli_host.ui.cli.board import board_versions, open_board
from heli_host.ui.cli.options import (
    MAX_SPEED,
    JsonOption,
    PortOption,
    SilOption,
    check_parameters_place,
    sil_address,
)
from heli_host.ui.cli.say import data_on_stdout, say, say_dropped, write_result
from heli_host.ui.cli.verb import Verb

if TYPE_CHECKING:
    from heli_host.board.heli import Heli
    from heli_host.declaration import ParamSpec

app = typer.Typer(
    help="Read and set the board's parameters.\n\n"
    "See `heli-host params COMMAND --help` for options and examples.",
    no_args_is_help=True,
    rich_markup_mode="markdown",
)

_NameArgument = Annotated[
    str, typer.Argument(metavar="NAME", help="Use this parameter, as params list names it.")
]
_SaveOption = Annotated[bool, typer.Option("--save", help="Write all parameters to the board's flash too.")]


@app.command("list")
def list_parameters(
    pattern: Annotated[
        str, typer.Argument(metavar="[TEXT]", help="Show only names that contain this text.")
    ] = "",
    long: Annotated[bool, typer.Option("--long", "-l", help="Explain each parameter too.")] = False,
    port: PortOption = None,
    sil: SilOption = False,
    json: JsonOption = None,
) -> None:
    """List the board's parameters with values, units and ranges.

    A star marks each value that differs from its default. Nothing is changed.

    Example: `heli-host params list pitch --long --port /dev/ttyACM0`
    """
    from heli_host.board.parameters import controller_names

    with _open_board(port, sil) as heli:
        values = heli.params.dump()
        specs = {name: heli.params.spec(name) for name in values if pattern in name}
        controllers = controller_names(heli.session)
        content = {
            name: {
                "value": values[name],
                "unit": spec.unit,
                "min": spec.min,
                "max": spec.max,
                "default": spec.default,
                "meaning": spec.meaning,
                # Each value of this parameter selects a control law.
                **({"names": controllers} if name == "controller" else {}),
            }
            for name, spec in specs.items()
        }
        if write_result(json, {"parameters": content}):
            return
        if not specs:
            raise typer.BadParameter(
                f"no parameter's name contains '{pattern}'; heli-host params list lists all"
            )
        if long:
            _print_with_meanings(specs, values, controllers)
            return
        _print_table(specs, values)


def _print_table(specs: Mapping[str, ParamSpec], values: Mapping[str, float]) -> None:
    """Print each parameter as a row of a table."""
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for heading in ("name", "", "value", "unit", "range"):
        table.add_column(heading, no_wrap=True)
    for name, spec in specs.items():
        table.add_row(
            name, _mark_if_changed(spec, values[name]), f"{values[name]:g}", spec.unit, _limits_text(spec)
        )
    Console(highlight=False).print(table)


def _print_with_meanings(
    specs: Mapping[str, ParamSpec], values: Mapping[str, float], names: tuple[str, ...]
) -> None:
    """Print each parameter on one line, and its meaning indented below it, within the terminal's width."""
    from rich.console import Console
    from rich.padding import Padding
    from rich.text import Text

    console = Console(highlight=False)
    for name, spec in specs.items():
        unit = f" {spec.unit}" if spec.unit else ""
        console.print(
            Text(
                f"{name} = {values[name]:g}{unit}{_mark_if_changed(spec, values[name])}  "
                f"({_limits_text(spec)})"
            )
        )
        meaning = _with_names(spec.meaning, names) if name == "controller" else spec.meaning
        console.print(Padding(Text(meaning), (0, 0, 0, 4)))


def _mark_if_changed(spec: ParamSpec, value: float) -> str:
    return "" if abs(value - spec.default) <= 1e-6 * max(1.0, abs(value)) else "*"


def _limits_text(spec: ParamSpec) -> str:
    return f"{spec.min:g} .. {spec.max:g}"


@app.command("get")
def get(
    name: _NameArgument, port: PortOption = None, sil: SilOption = False, json: JsonOption = None
) -> None:
    """Print the value of one parameter.

    Prints the value in the board's memory. Nothing is changed.

    Example: `heli-host params get hover_V --port /dev/ttyACM0`
    """
    from heli_host.board.parameters import spec_of

    spec = spec_of(name)
    with _open_board(port, sil) as heli:
        if not write_result(json, {"name": name, "value": heli.params[name], "unit": spec.unit}):
            say(f"{heli.params[name]:g}")


@app.command("set", context_settings={"ignore_unknown_options": True})
def set_parameter(
    name: _NameArgument,
    value: Annotated[float, typer.Argument(metavar="VALUE", help="Set this value, in the parameter's unit.")],
    save: _SaveOption = False,
    port: PortOption = None,
    sil: SilOption = False,
    json: JsonOption = None,
) -> None:
    """Set one parameter in the board's memory.

    The value is lost when the board restarts, unless you add --save. Saving works only while the board is
    idle.

    Example: `heli-host params set hover_V 1.5 --save --port /dev/ttyACM0`
    """
    from heli_host.board.parameters import checked

    spec = checked(name, value)
    data_on_stdout(json)
    with _open_board(port, sil) as heli:
        before = heli.params[name]
        in_force = heli.params.set(name, value)
        unit = f" {spec.unit}" if spec.unit else ""
        generation = heli.params.save() if save else None
        say(f"{name}: {before:g} -> {in_force:g}{unit}{_saved_text(generation)}")
        write_result(
            json,
            {
                "name": name,
                "before": before,
                "value": in_force,
                "unit": spec.unit,
                "saved": generation is not None,
            },
        )


@app.command("save")
def save_parameters(port: PortOption = None, sil: SilOption = False) -> None:
    """Write all parameters to the board's flash.

    The board must be idle. The saved values replace the former ones.

    Example: `heli-host params save --port /dev/ttyACM0`
    """
    with _open_board(port, sil) as heli:
        say(f"parameters saved, generation {heli.params.save()}")


@app.command("dump")
def dump(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Write the parameters to this TOML file.")],
    port: PortOption = None,
    sil: SilOption = False,
) -> None:
    """Write all parameters of the board to a TOML file.

    An existing file of parameters is replaced. The board stays unchanged.

    Example: `heli-host params dump rig7.toml --port /dev/ttyACM0`
    """
    from heli_host.board.parameters import parameters_text

    check_parameters_place(file)
    with _open_board(port, sil) as heli:
        values = heli.params.dump()
        comment = board_versions(heli.info)
    write_signed(file, parameters_text(values, comment))
    say(f"{len(values)} parameters -> {file}")


@app.command("restore")
def restore(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Read the parameters from this TOML file.")],
    save: _SaveOption = False,
    port: PortOption = None,
    sil: SilOption = False,
    json: JsonOption = None,
) -> None:
    """Set all parameters that a TOML file contains.

    If the board refuses one value, none is set. The values are lost when the board restarts, unless you add
    --save. From a file of another parameter schema, known parameters are kept, and the others are listed.

    Example: `heli-host params restore rig7.toml --save --port /dev/ttyACM0`
    """
    from heli_host.board.parameters import read_parameter_set

    parameter_set = read_parameter_set(file)
    values = parameter_set.values
    data_on_stdout(json)
    say_dropped(parameter_set.dropped)
    with _open_board(port, sil) as heli:
        for name in parameter_set.new:
            say(f"not in {file}: {name} stays {heli.params[name]:g}")
        changed = heli.params.restore(values)
        for name, value in changed.items():
            say(f"{name} -> {value:g}")
        generation = heli.params.save() if save else None
        say(f"{len(changed)} of {len(values)} changed{_saved_text(generation)}")
        result = {
            "changed": dict(changed),
            "dropped": list(parameter_set.dropped),
            "new": list(parameter_set.new),
            "saved": generation is not None,
        }
        write_result(json, result)


def _open_board(port: str | None, sil: bool) -> AbstractContextManager[Heli]:

    return open_board(port, sil_address(speed=MAX_SPEED) if sil else None)


def _with_names(meaning: str, names: tuple[str, ...]) -> str:
    return f"{meaning}: {', '.join(f'{row} is {name}' for row, name in enumerate(names))}"


def _saved_text(generation: int | None) -> str:
    return ", not saved (lost when the board restarts)" if generation is None else ", saved to flash"


VERB = Verb(app, "Board")
