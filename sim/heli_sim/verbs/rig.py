"""``heli-host rig``: rigs as files of numbers, each with its unit, tolerance and source."""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from heli_host.data.files import write_signed
from heli_host.errors import printable
from heli_host.ui.cli.options import JsonOption
from heli_host.ui.cli.say import STDOUT, data_on_stdout, say, say_data, say_files, write_result
from heli_host.ui.cli.verb import Verb

if TYPE_CHECKING:
    from collections.abc import Mapping

    from heli_host.board.rig_check import RigDifference
    from rich.console import Console

    from heli_sim.bench import Weighed
    from heli_sim.rig import Number, Rig
    from heli_sim.rig.describe import Difference

WIDE = 160
"""Columns of a table that does not go to a terminal."""

app = typer.Typer(
    help="Describe, weigh, show, check, compare and export rigs.\n\n"
    "See `heli-host rig COMMAND --help` for options and examples.",
    no_args_is_help=True,
    rich_markup_mode="markdown",
)

RigArgument = Annotated[str, typer.Argument(metavar="NAME|FILE", help="Use this rig: a name or a TOML file.")]


BoardParametersOption = Annotated[
    Path | None,
    typer.Option("--params", metavar="FILE", help="Read a board's parameters from this file of params dump."),
]


@app.command("list")
def list_rigs(json: JsonOption = None) -> None:
    """List the rigs that come with the package.

    Prints each name with its description. Nothing is written.

    Example: `heli-host rig list`
    """
    from heli_sim.rig import load_rig, rig_names

    rigs = {name: load_rig(name).description for name in rig_names()}
    entries = [{"name": name, "description": text} for name, text in rigs.items()]
    if write_result(json, {"rigs": entries}):
        return
    say(*(f"{name}: {text}" for name, text in rigs.items()))


@app.command("show")
def show(
    rig: RigArgument,
    pattern: Annotated[
        str, typer.Argument(metavar="[TEXT]", help="Show only names that contain this text.")
    ] = "",
    json: JsonOption = None,
) -> None:
    """Show a rig's parameters with tolerance, unit, meaning and source.

    The true value is within the tolerance with about 95 % confidence. Nothing is written.

    Example: `heli-host rig show makki2024 friction`
    """
    from rich.table import Table

    from heli_sim.rig import RIG_QUANTITIES, load_rig

    loaded = load_rig(rig)
    meanings = {quantity.name: quantity.meaning for quantity in RIG_QUANTITIES}
    all_numbers = dict(loaded.items()) | {
        f"{effect}.{name}": number
        for effect, numbers in loaded.effects.items()
        for name, number in numbers.items()
    }
    numbers_shown = {name: asdict(number) for name, number in all_numbers.items() if pattern in name}
    content = {"name": loaded.name, "description": loaded.description, "numbers": numbers_shown}
    if write_result(json, content):
        return
    table = Table(box=None, pad_edge=False)
    for heading in ("name", "value", "tolerance", "unit"):
        table.add_column(heading, no_wrap=True)
    table.add_column("meaning; source", overflow="fold")
    for name, number in loaded.items():
        if pattern in name:
            text = f"{meanings[name]}; {number.source}"
            table.add_row(name, f"{number.value:g}", half_width(number), number.unit, plain(text))
    for effect, numbers in loaded.effects.items():
        for name, number in numbers.items():
            if pattern in f"{effect}.{name}":
                table.add_row(
                    f"{effect}.{name}",
                    f"{number.value:g}",
                    half_width(number),
                    number.unit,
                    plain(f"effect; {number.source}"),
                )
    if not table.row_count:
        raise typer.BadParameter(
            f"no rig parameter's name contains '{pattern}'; heli-host rig show RIG lists all"
        )
    console = _console()
    console.print(f"{plain(loaded.name)}: {plain(loaded.description)}")
    console.print(table)


@app.command("check")
def check(
    rigs: Annotated[
        list[str], typer.Argument(metavar="NAME|FILE...", help="Check these rigs: names or TOML files.")
    ],
    params: BoardParametersOption = None,
    json: JsonOption = None,
) -> None:
    """Check that rig files are complete and plausible, and that each rig can fly.

    Prints inertias and the hover voltage, and warns of implausible parameters. With --params it
    compares counts and direction of each encoder, rest angle, supply and limits with a board. The exit code
    is 1 if a rig cannot fly on its supply, or the board contradicts its encoders. It is 2 if a rig file is
    wrong.

    Example: `heli-host rig check my-rig.toml`
    """
    from heli_sim.errors import EffectError, RigError
    from heli_sim.model.effects import effects_of
    from heli_sim.model.linear import rig_findings
    from heli_sim.rig import load_rig

    data_on_stdout(json)
    board = _board_parameters(params)
    errors: list[RigError | EffectError] = []
    entries: list[dict[str, Any]] = []
    cannot_fly = contradicts_board = False
    for name in rigs:
        try:
            rig = load_rig(name)
            effects_of(rig)
        except (RigError, EffectError) as error:
            entries.append({"rig": name, "is_valid": False, "error": str(error)})
            # The error of a single rig is raised below, and printed then.
            if len(rigs) > 1:
                say(f"{name}: {error}")
            errors.append(error)
            continue
        findings = rig_findings(rig)
        cannot_fly |= not findings.can_fly
        entry = {
            "rig": name,
            "is_valid": True,
            "can_fly": findings.can_fly,
            "findings": list(findings.phrases),
        }
        say(f"{name}: {'; '.join(findings.phrases)}")
        if board is not None:
            differences = _say_board_differences(name, board)
            contradicts_board |= any(difference.is_refused for difference in differences)
            entry["board"] = [
                asdict(difference) | {"part": difference.part.value} for difference in differences
            ]
        entries.append(entry)
    write_result(json, {"rigs": entries})
    if len(rigs) > 1 and errors:
        raise RigError(f"{len(errors)} of {len(rigs)} rig files are wrong, see above", "correct them")
    if errors:
        raise errors[0]
    if cannot_fly or contradicts_board:
        raise typer.Exit(1)


def _board_parameters(params: Path | None) -> dict[str, float] | None:
    """Parameters of a board in a file; None without a file."""
    from heli_host.board.parameters import read_parameter_set

    return None if params is None else read_parameter_set(params).values


def _say_board_differences(rig: str, board: Mapping[str, float]) -> list[RigDifference]:
    """Print the differences between the parameters of a `board` and a rig, and return them."""
    from heli_host.board.rig_check import rig_differences, rig_parameters
    from heli_host.declaration import AXES

    stated = rig_parameters(rig)
    differences = rig_differences(stated.values, board, simulated=False, directed=stated.directed)
    texts = [str(difference) for difference in differences] or ["the board's parameters fit"]
    say(*(f"{rig}: {text}" for text in texts))
    axes_without_direction = [axis for axis in AXES if f"{axis}_counts_per_rev" not in stated.directed]
    if axes_without_direction:
        axes_text = ", ".join(axes_without_direction)
        say(f"{rig}: states no encoder direction of {axes_text}: signs not compared")
    return differences


@app.command("from-board")
def from_board(
    params: Annotated[
        Path,
        typer.Argument(metavar="PARAMS", help="Read a board's parameters from this file of params dump."),
    ],
    out: Annotated[
        Path, typer.Argument(metavar="FILE", help="Write the rig to this TOML file, which names the rig.")
    ],
    like: Annotated[
        str, typer.Option("--like", metavar="NAME|FILE", help="Copy every other parameter from this rig.")
    ] = "makki2024",
) -> None:
    """Convert a board's parameters into a rig file.

    Takes counts and direction of each encoder, rest angle, supply and dead zone from the board, and all other
    parameters from another rig. It never replaces a rig file.

    Example: `heli-host rig from-board board.toml mine.toml`
    """
    from heli_host.board.parameters import read_parameter_set
    from heli_host.ui.cli.options import check_place

    from heli_sim.errors import RigError
    from heli_sim.rig import load_rig, write_rig
    from heli_sim.rig.board import rig_of_board

    base = load_rig(like)
    check_place(out)
    if out.exists():
        raise RigError(f"{out} exists already", "give another name, because no rig is overwritten")
    rig = rig_of_board(read_parameter_set(params).values, base, out.stem)
    write_rig(rig, out, f"Written by heli-host rig from-board from {params.name}: the rest as {base.name}.")
    changed = [name for name in rig if rig[name].value != base[name].value]
    say(f"differs from {base.name} in: {', '.join(changed) or 'nothing'}")
    say_files([out])


@app.command("to-board")
def to_board(
    rig: RigArgument,
    out: Annotated[Path, typer.Argument(metavar="FILE", help="Write the parameters to this TOML file.")],
    params: BoardParametersOption = None,
) -> None:
    """Convert a rig file into parameters for a board.

    Writes counts per turn, rest angle, supply, dead zone and limits. If the rig file does not state the
    direction of an encoder, its sign comes from --params. Without --params, this encoder is left out. Limits
    are only lowered. An existing file of parameters is replaced.

    Example: `heli-host rig to-board mine.toml board.toml`
    """
    from heli_host.board.parameters import parameters_text
    from heli_host.ui.cli.options import check_parameters_place

    from heli_sim.rig import load_rig
    from heli_sim.rig.board import board_settings

    loaded = load_rig(rig)
    check_parameters_place(out)
    board = _board_parameters(params)
    settings = board_settings(loaded, board)
    write_signed(out, parameters_text(settings, f"heli-host rig to-board: parameters of rig {loaded.name}"))
    say(f"{len(settings)} parameters; to set them on a board: heli-host params restore {out} --port PORT")
    say_files([out])


@app.command("diff")
def diff(
    left: RigArgument,
    right: RigArgument,
    show_all: Annotated[bool, typer.Option("--all", "-a", help="Show equal parameters too.")] = False,
    json: JsonOption = None,
) -> None:
    """Compare two rigs, parameter by parameter.

    Each difference is divided by the combined tolerance of both rigs (the root of the sum of squares). A star
    marks a difference above 1, which two files of the same rig rarely have.

    Example: `heli-host rig diff makki2024 makki2024-identified`
    """
    from rich.table import Table

    from heli_sim.rig import load_rig
    from heli_sim.rig.describe import compare_rigs

    first, second = load_rig(left), load_rig(right)
    compared = compare_rigs(first, second)
    shown_rows = [_comparison_row(difference) for difference in compared if show_all or not difference.same]
    # A rig that was drawn or measured often keeps the name of the rig that it began from.
    names = (first.name, second.name) if first.name != second.name else (str(left), str(right))
    if write_result(json, {"left": names[0], "right": names[1], "numbers": shown_rows}):
        return
    table = Table(box=None, pad_edge=False)
    for heading in ("name", *map(plain, names), "unit", "tolerances"):
        table.add_column(heading, overflow="fold", no_wrap=heading == "name")
    for difference in compared:
        if show_all or not difference.same:
            known = difference.left or difference.right
            table.add_row(
                difference.name,
                with_tolerance(difference.left),
                with_tolerance(difference.right),
                known.unit if known is not None else "",
                signed(difference.tolerances),
            )
    if table.row_count:
        _console().print(table)
    differing = sum(not difference.same for difference in compared)
    beyond_count = sum(abs(difference.tolerances) > 1.0 for difference in compared)
    say(f"{differing} of {len(compared)} numbers differ, {beyond_count} beyond their tolerances")


@app.command("new")
def new(
    out: Annotated[
        Path, typer.Argument(metavar="FILE", help="Write the rig to this TOML file, which names the rig.")
    ],
    like: Annotated[
        str, typer.Option("--like", metavar="NAME|FILE", help="Copy every unstated parameter from this rig.")
    ] = "makki2024",
    table: Annotated[
        Path | None,
        typer.Option(
            "--table", metavar="FILE", help="Read a CSV table: name, value, unit, tolerance, source."
        ),
    ] = None,
    stated: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="NAME=VALUE", help="Set one parameter, such as 'M_f=355+-4 g'. Repeatable."
        ),
    ] = None,
    description: Annotated[
        str, typer.Option("--description", metavar="TEXT", help="Describe the rig in one line.")
    ] = "",
    force: Annotated[
        bool, typer.Option("--force", help="Write the rig even if a number is implausible.")
    ] = False,
) -> None:
    """Describe a rig by a table, options or answers to questions.

    Writes a rig file, and never replaces one. A number without a unit has the unit of rig files. Without a
    tolerance it gets that of a ruler or a kitchen scale. Unstated parameters come from another rig, with a
    wide tolerance.

    Example: `heli-host rig new mine.toml --set 'M_w=1.87 kg' --set 'L_a=66 cm'`
    """
    from heli_host.ui.cli.options import check_place

    from heli_sim.errors import RigError
    from heli_sim.model.linear import rig_findings
    from heli_sim.rig import load_rig, write_rig
    from heli_sim.rig.describe import described, numbers_from_table, numbers_from_words
    from heli_sim.rig.schema import beyond_a_table

    base = load_rig(like)
    check_place(out)
    if out.exists():
        raise RigError(f"{out} exists already", "give another name, because no rig is overwritten")
    given = {}
    if table is not None:
        given = numbers_from_table(read_text(table), str(table))
    given |= numbers_from_words(stated or ())
    if table is None and not stated:
        given = _ask_numbers(base)
    text = description or f"described by its builder, what is not stated as {base.name}"
    rig = described(out.stem, text, base, given)
    if not force and (beyond := beyond_a_table({name: rig[name].value for name in rig})):
        raise RigError(
            beyond[0], "correct the number or add its unit, such as g or cm; or write it with --force"
        )
    write_rig(
        rig, out, f"Written by heli-host rig new: {len(given)} numbers stated, the rest as {base.name}."
    )
    say(f"{out}: {'; '.join(rig_findings(rig).phrases)}")
    unstated = [name for name in rig if rig[name].source == f"not stated: as {base.name}"]
    say(f"not stated, so as {base.name} and wide: {', '.join(unstated) or 'none'}")


def _ask_numbers(like: Rig) -> dict[str, Number]:
    """Ask for the numbers of a new rig on the terminal; return those that were answered, by name."""
    from heli_sim.errors import RigError
    from heli_sim.rig import RIG_QUANTITIES
    from heli_sim.rig.describe import ASKED, number_from

    meanings = {quantity.name: quantity.meaning for quantity in RIG_QUANTITIES}
    say("Write a number as 0.5, 355 g or 0.64 +- 0.005 m; nothing where you do not know.")
    given: dict[str, Number] = {}
    for name in ASKED:
        known = like[name]
        question = f"{name}, {meanings[name]} [{known.unit}; {like.name} has {known.value:g}]"
        while True:
            answer = typer.prompt(question, default="", show_default=False)
            if not answer.strip():
                break
            try:
                given[name] = number_from(name, answer)
                break
            except RigError as error:
                say(str(error))
    return given


@app.command("weigh")
def weigh_rig(
    rig: RigArgument,
    tests: Annotated[
        Path | None, typer.Argument(metavar="[TESTS]", help="Read bench tests from this TOML file.")
    ] = None,
    save_rig: Annotated[
        Path | None, typer.Option("--save-rig", metavar="FILE", help="Write the estimated rig, TOML.")
    ] = None,
    template: Annotated[
        Path | None,
        typer.Option(
            "--template", metavar="FILE", help="Write an empty table of bench tests to this file, and exit."
        ),
    ] = None,
    json: JsonOption = None,
) -> None:
    """Estimate a rig's parameters from bench tests.

    The tests are thrust on a scale, the elevation at which the arm balances, and swings of the short arm.
    Without --save-rig the result is only printed.

    Example: `heli-host rig weigh mine.toml bench.toml --save-rig weighed.toml`
    """
    from heli_host.data.files import parse_toml
    from heli_host.ui.cli.options import check_place

    from heli_sim.bench import TEMPLATE, bench_tests_from, weigh
    from heli_sim.errors import RigError
    from heli_sim.rig import load_rig, write_rig

    before = load_rig(rig)
    if template is not None:
        check_place(template)
        write_signed(template, TEMPLATE)
        say(f"fill in {template}, then: heli-host rig weigh {rig} {template} --save-rig weighed.toml")
        return
    if tests is None:
        raise typer.BadParameter(
            "no bench tests are given; write a table to fill in with --template bench.toml"
        )
    try:
        table = parse_toml(read_text(tests))
    except ValueError as error:
        raise RigError(f"{tests} is not TOML: {error}", "correct that line") from None
    weighed = weigh(before, *bench_tests_from(table))
    if save_rig is not None:
        check_place(save_rig)
        weighed_rig = replace(weighed.rig, name=save_rig.stem)
        write_rig(weighed_rig, save_rig, f"Found by heli-host rig weigh from {tests.name} and {before.name}.")
    numbers = {name: asdict(weighed.rig[name]) for name in weighed.determined}
    tested = [{**asdict(test), "off": test.off} for test in weighed.tested]
    if not write_result(json, {"rig": weighed.rig.name, "numbers": numbers, "tests": tested}):
        _say_weighed(weighed, before)
        say_files([save_rig])


def _say_weighed(weighed: Weighed, before: Rig) -> None:
    """Print what the bench tests change, and how well the rig then predicts each reading."""
    from heli_sim.bench import OFF

    for name in weighed.determined:
        number_before, number_after = before[name], weighed.rig[name]
        change_in_tolerances = (
            abs(number_after.value - number_before.value) / number_before.tolerance
            if number_before.tolerance
            else 0.0
        )
        remark = (
            f", {change_in_tolerances:.1f} tolerances off: a wrong reading, or a wrong rig file"
            if change_in_tolerances > OFF
            else ""
        )
        after_text = f"{number_after.value:.4g} (tolerance {number_after.tolerance:.2g}) {number_after.unit}"
        say(f"{name}: {with_tolerance(number_before)} -> {after_text}{remark}")
    for test in weighed.tested:
        remark = f", {test.off:.1f} tolerances off: a wrong reading, or no such rig" if test.off > OFF else ""
        unit = "" if test.unit == "1" else f" {test.unit}"
        say(f"{test.what}: read {test.read:.4g}{unit}, the rig gives {test.after:.4g}{remark}")


@app.command("export")
def export_rig(
    rig: RigArgument,
    format_: Annotated[
        str,
        typer.Option(
            "--format",
            metavar="mjcf|fmu",
            help="Write MuJoCo XML, or a functional mock-up unit of FMI 3.0.",
            show_default=False,
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE",
            help="Write this file, XML also to standard output for -.  [default: RIG.xml or RIG.fmu]",
            show_default=False,
        ),
    ] = None,
    effect: Annotated[
        list[str] | None,
        typer.Option(
            "--effect",
            metavar="ID[=VALUE]",
            help="Add an effect to the FMU, such as rotor_lag=0.1. Repeatable.",
        ),
    ] = None,
    model: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="Use these equations of motion in the FMU.  [default: the rig's, or multibody]",
        ),
    ] = "",
    seed: Annotated[int, typer.Option(min=0, help="Seed all random numbers of the FMU.")] = 1,
) -> None:
    """Convert a rig for MuJoCo, or as an FMU for Simulink and Modelica tools.

    For MuJoCo it prints what the file cannot describe. An FMU contains the rig's effects, model exchange,
    co-simulation, its sources and a binary for this system.

    Example: `heli-host rig export makki2024 --format mjcf -o makki2024.xml`
    """
    if format_ == "mjcf":
        if effect or model:
            raise typer.BadParameter("--effect and --model apply to --format fmu only; leave them out")
        _export_mjcf(rig, output)
    elif format_ == "fmu":
        _export_fmu(rig, effect or [], model, seed, output)
    else:
        raise typer.BadParameter(f"unknown --format '{format_}'; choose mjcf or fmu")


def _export_mjcf(rig: str, output: Path | None) -> None:
    """Write a rig as a MuJoCo model, and print what that model leaves out."""
    from heli_host.ui.cli.options import check_place

    from heli_sim.model.mjcf import left_out, mjcf
    from heli_sim.rig import load_rig

    loaded = load_rig(rig)
    target = output if output is not None else Path(f"{loaded.name}.xml")
    data_on_stdout(target)
    if str(target) == STDOUT:
        say_data(mjcf(loaded))
    else:
        check_place(target)
        write_signed(target, mjcf(loaded))
    say("the model leaves out:", *(f"  {line}" for line in left_out(loaded)))
    say_files([target])


def _export_fmu(rig: str, effects: list[str], model: str, seed: int, out: Path | None) -> None:
    """Write a rig as an FMU, and print what it contains."""
    from heli_sim.fmu import write_fmu
    from heli_sim.sil.options import SilOptions, plant_of

    plant = plant_of(SilOptions(rig=rig, seed=seed, model=model, effects=tuple(effects)))
    target = out if out is not None else Path(f"{plant.rig.name}.fmu")
    system = write_fmu(plant, target)
    binary = f"binary for {system}" if system else "sources only: there is no C compiler here"
    names = ", ".join(effect.name for effect in plant.model.effects) or "no effects"
    say(f"{plant.rig.name}, {plant.model.name}, {names}; {binary} -> {target}")


def read_text(path: Path) -> str:
    """Read the text at `path`, a RigError where there is none."""
    from heli_host.data.files import TOML_BYTES, decode_text, read_file
    from heli_host.errors import file_remedy

    from heli_sim.errors import RigError

    try:
        return decode_text(read_file(path, TOML_BYTES))
    except OSError as error:
        raise RigError(f"cannot read {path}: {error.strerror}", file_remedy(error)) from None
    except UnicodeDecodeError:
        raise RigError(f"{path} is not text in UTF-8", "save it as UTF-8") from None


def _comparison_row(difference: Difference) -> dict[str, Any]:
    return {**asdict(difference), "tolerances": difference.tolerances}


def _console() -> Console:
    """Return the console for tables, which are not cut if the output is a file."""
    from rich.console import Console

    console = Console(highlight=False)
    # A file or another program has no width; rich would take 80 columns and cut.
    return console if console.is_terminal else Console(highlight=False, width=WIDE)


def half_width(number: Number) -> str:
    """Write the tolerance of a `number`."""
    return f"{number.tolerance:g}" if number.tolerance else "exact"


def with_tolerance(number: Number | None) -> str:
    """Write a `number` with its tolerance; a dash for none."""
    if number is None:
        return "-"
    return f"{number.value:g} (tolerance {number.tolerance:g})" if number.tolerance else f"{number.value:g}"


def signed(tolerances: float) -> str:
    """Write a difference in `tolerances`, with a star if it is above one."""
    if math.isinf(tolerances):
        return "no tolerance"
    return f"{tolerances:+.1f}{' *' if abs(tolerances) > 1.0 else ''}"


def plain(text: str) -> str:
    """Escape a `text` from another source, so that a terminal prints it unchanged."""
    from rich.markup import escape

    return escape(printable(text))


VERB = Verb(app, "Simulation")
