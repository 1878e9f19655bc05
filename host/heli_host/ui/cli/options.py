"""Options that several verbs share, and the checks of their values.

Nothing here simulates: a ``sil://`` address is opened by whichever package provides such transports.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final
from urllib.parse import urlencode

import typer

from heli_host.data.files import check_replaceable
from heli_host.ui.cli.say import STDOUT

if TYPE_CHECKING:
    from collections.abc import Callable

    from heli_host.board.heli import Heli
    from heli_host.board.twins import TwinMaker, TwinWatch

PortOption = Annotated[
    str | None,
    typer.Option(
        "--port",
        "-p",
        metavar="URL",
        help="Open the board on this port: /dev/ttyACM0, COM3, socket://HOST:PORT.",
        envvar="HELI_PORT",
        show_default=False,
    ),
]
JsonOption = Annotated[
    Path | None,
    typer.Option("--json", metavar="FILE", help="Write the result as JSON, to standard output for -."),
]
SchedulerOption = Annotated[
    str | None,
    typer.Option(
        "--scheduler",
        metavar="ADDRESS",
        help="Use a Dask cluster, such as tcp://10.0.0.1:8786.  [default: this machine]",
        show_default=False,
    ),
]
DurationOption = Annotated[
    float | None,
    typer.Option(
        "--duration",
        metavar="S",
        min=0.001,
        help="Stop after this time in s.  [default: until Ctrl-C]",
        show_default=False,
    ),
]
LogOption = Annotated[
    Path | None, typer.Option("--log", metavar="FILE", help="Write the log to this file, .mcap.")
]
FigureOption = Annotated[
    Path | None,
    typer.Option("--figure", metavar="FILE", help="Draw a figure to this file: .png, .pdf or .svg."),
]
FoxgloveOption = Annotated[
    int | None,
    typer.Option(
        "--foxglove",
        metavar="PORT",
        min=0,
        max=65535,
        help="Serve live samples to viewers on this local port, 0 for a free one.",
        show_default=False,
    ),
]
ClearFaultOption = Annotated[bool, typer.Option("--clear-fault", help="Clear a latched fault first.")]
DEFAULT_RIG: Final = "makki2024"
MAX_SPEED: Final = "max"
BOARDS: Final = ("native", "due", "auto")
SilOption = Annotated[bool, typer.Option("--sil", help="Use the simulated board.")]
RigOption = Annotated[
    str | None,
    typer.Option(
        "--rig",
        metavar="NAME|FILE",
        help="Simulate this rig, or compare the real board with it.  [default: makki2024 with --sil]",
    ),
]
BoardOption = Annotated[
    str | None,
    typer.Option(
        "--board",
        metavar="native|due|auto",
        help="Run the flight code natively, on an emulated Due, or choose automatically.  [default: native]",
        show_default=False,
    ),
]
ElfOption = Annotated[
    Path | None,
    typer.Option(
        "--elf", metavar="FILE", help="Run this firmware on the emulated Due.  [default: newest build]"
    ),
]
ModelOption = Annotated[
    str | None,
    typer.Option(
        "--model",
        metavar="NAME",
        help="Simulate these equations of motion.  [default: the rig's, or multibody]",
        show_default=False,
    ),
]
EffectOption = Annotated[
    list[str] | None,
    typer.Option(
        "--effect",
        metavar="ID[=VALUE]",
        help="Add an effect to the simulation, such as rotor_lag=0.1. Repeatable.",
        show_default=False,
    ),
]
EffectFilesOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--effect-file",
        metavar="FILE.py",
        help="Load effects from this file, and run its code. Repeatable.",
        show_default=False,
    ),
]
SpeedOption = Annotated[
    str,
    typer.Option("--speed", metavar="N|max", help="Simulate N seconds per second, or as fast as possible."),
]
SeedOption = Annotated[int, typer.Option("--seed", min=0, help="Seed all random numbers of the simulation.")]
FlightSeedOption = Annotated[
    int | None,
    typer.Option(
        "--seed",
        metavar="N",
        min=0,
        help="Seed all random numbers of the simulation.  [default: 1, random with --blind]",
        show_default=False,
    ),
]
BlindOption = Annotated[
    bool, typer.Option("--blind", help="Hide rig, effects and seed in all files but LOG.truth.json.")
]
TwinOption = Annotated[
    str | None,
    typer.Option(
        "--twin",
        metavar="NAME|FILE",
        help="Compare the flight with this rig, or twin file, and report alarms.",
    ),
]
OnAlarmOption = Annotated[
    str | None,
    typer.Option(
        "--on-alarm",
        metavar="warn|land",
        help="Choose what an alarm of the twin does.  [default: warn]",
        show_default=False,
    ),
]
WARN: Final = "warn"
LAND: Final = "land"
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
        "--params", metavar="FILE", help="Fly with the parameters of this file, and do not save them."
    ),
]
_FIGURE_ENDS: Final = (".png", ".pdf", ".svg")


def flight_folder(base: Path = Path("flights")) -> Path:
    """Make the folder of a new flight in `base`, named after the local time; it did not exist before."""
    import time

    name = time.strftime("%Y-%m-%d_%H-%M-%S")
    for suffix in ("", *(f"_{number}" for number in range(2, 100))):
        folder = base / f"{name}{suffix}"
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            continue
        return folder
    raise typer.BadParameter(f"{base} already has 100 flights of this second; try again in a second")


def rig_name(rig: str | None, *, simulated: bool) -> str:
    """Return the name of the requested `rig` for the log. Without a rig, return the default rig if
    `simulated`, otherwise an empty text.
    """
    if rig is not None:
        return Path(rig).stem
    return DEFAULT_RIG if simulated else ""


def parse_speed(text: str) -> float | None:
    """Read the `text` of a ``--speed``, a positive number or ``max``, as simulated seconds a second; None for
    ``max``. Anything else is a typer.BadParameter.
    """
    if text == MAX_SPEED:
        return None
    try:
        speed = float(text)
    except ValueError:
        speed = 0.0
    if not 0.0 < speed < 1e4:
        raise typer.BadParameter(
            f"invalid --speed '{text}'; give a number between 0 and 10000, or {MAX_SPEED}"
        )
    return speed


def check_speed(text: str) -> None:
    """Refuse the `text` of a ``--speed`` that `parse_speed` cannot read."""
    parse_speed(text)


def which_board(board: str | None, elf: Path | None) -> str:
    """Settle which simulated `board` is meant: without a name the native one, or the Due when there is an
    `elf`. A typer.BadParameter when the two contradict each other.
    """
    board = board if board is not None else ("due" if elf is not None else "native")
    if board not in BOARDS:
        raise typer.BadParameter(f"unknown --board '{board}'; choose {', '.join(BOARDS)}")
    if board == "native" and elf is not None:
        raise typer.BadParameter("--elf needs the emulated Due; add --board due, or leave one of them out")
    return board


def sil_address(
    *,
    rig: str | None = None,
    speed: str = "1",
    seed: int = 1,
    board: str | None = None,
    elf: Path | None = None,
    model: str | None = None,
    effect: Sequence[str] | None = None,
    effect_files: Sequence[Path] | None = None,
) -> str:
    """Return the address of a simulated board, for ``heli_host.connect``."""
    factor = parse_speed(speed)
    options = {
        "rig": rig if rig is not None else DEFAULT_RIG,
        "seed": str(seed),
        "speed": MAX_SPEED if factor is None else repr(factor),
        # In real time, the board must not wait for this process, so it gets one of its own.
        "process": "" if factor is None else "1",
        "board": which_board(board, elf),
        "elf": str(elf) if elf is not None else "",
        "model": model or "",
        "effect": ";".join(effect or ()),
        "effects": ";".join(str(path.absolute()) for path in effect_files or ()),
    }
    return "sil://?" + urlencode({key: value for key, value in options.items() if value})


def refuse_without_sil(**options: object) -> None:
    """Refuse options of a simulated board if a real board is used."""
    used_options = [f"--{name.replace('_', '-')}" for name, value in options.items() if value]
    if used_options:
        verb = "is" if len(used_options) == 1 else "are"
        raise typer.BadParameter(f"{' and '.join(used_options)} {verb} for a simulated board only; add --sil")


def lands_on_alarm(twin: str | None, on_alarm: str | None) -> bool:
    """Return whether an alarm ends the flight in a landing, as `on_alarm` says; refuse any other word, and
    any word without a `twin`.
    """
    # A twin's matrices are small, so that more threads only wait for each other. Set it before numpy is
    # loaded.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if on_alarm is None:
        return False
    if on_alarm not in (WARN, LAND):
        raise typer.BadParameter(f"unknown --on-alarm '{on_alarm}'; choose {WARN} or {LAND}")
    if twin is None:
        raise typer.BadParameter("--on-alarm needs a twin; add --twin NAME|FILE")
    return on_alarm == LAND


def read_twin(twin: str | None) -> TwinMaker | None:
    """Read a `twin`, the name of a rig or a file, so that an error in it is reported before anything starts;
    None without a twin.
    """
    if twin is None:
        return None
    from heli_host.board.twins import open_twin

    return open_twin(twin)


def open_watch(
    heli: Heli, twin: TwinMaker | None, on_alarm: Callable[[], None] | None = None
) -> TwinWatch | None:
    """Let a `twin`, as `read_twin` gives it, fly along with a board; an alarm calls `on_alarm`."""
    if twin is None:
        return None
    from heli_host.board.twins import FALSE_ALARM_INTERVAL_h, TwinWatch

    return TwinWatch(heli.session, twin(dict(heli.params), FALSE_ALARM_INTERVAL_h), on_alarm)


def chosen_parameters(file: Path | None, gains: str | None) -> Mapping[str, float]:
    """Read and check a file of parameters, and return its values by name."""
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


def check_place(path: Path) -> None:
    """Check that a file can be written later, and create its folder."""
    if str(path).startswith("--"):
        raise typer.BadParameter(f"{path} is an option, but a file name is needed there; give a file")
    folder = path.absolute().parent
    for part in (folder, *folder.parents):
        if part.is_file():
            raise typer.BadParameter(f"cannot write {path}: {part} is a file; give the name of a folder")
    folder.mkdir(parents=True, exist_ok=True)
    if path.is_dir() or not os.access(path if path.exists() else folder, os.W_OK):
        reason = "it is a folder" if path.is_dir() else "you have no permission to write there"
        raise typer.BadParameter(f"cannot write {path}: {reason}; give another file")
    check_replaceable(path)


def check_parameters_place(path: Path | None) -> None:
    """Refuse to replace a file that holds no parameters, such as a rig: both are TOML."""
    if path is None:
        return
    check_place(path)
    if path.is_file():
        text = path.read_text(encoding="utf-8", errors="replace")
        if text.strip() and "[parameters]" not in text:
            raise typer.BadParameter(f"{path} exists and holds no parameters; give another file")


def check_result_places(*files: Path | None, figure: Path | None = None, report: Path | None = None) -> None:
    """Refuse places that the results of long work cannot be written to, before the work begins."""
    if figure is not None and figure.suffix.lower() not in _FIGURE_ENDS:
        raise typer.BadParameter(
            f"--figure {figure} has an unknown format; give a file that ends in {', '.join(_FIGURE_ENDS)}"
        )
    for target in (*files, figure):
        if target is not None and str(target) != STDOUT:
            check_place(target)
    if report is not None:
        for name in ("index.html", "result.json"):
            check_place(report / name)
