"""The command line: its verbs, and the one place where errors become a line and an exit code.

Exit code 0 means done, and 1 means that ``doctor`` found a problem that you must fix. Code 2 is an invalid
request (usage, plan, parameter, setpoint). Code 3 is a failure of the board or the link, and 4 is a flight
that ended before its plan did. Code 5 is a file that cannot be read or written. Code 70 is a mistake of this
program, and 130 is an interrupt.

An error is one line on stderr; its class determines the exit code. ``HELI_DEBUG=1`` shows the traceback
instead.
"""

from __future__ import annotations

import contextvars
import copy
import functools
import os
import signal
import stat
import sys
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer
import typer.main

from heli_host.ui.cli.verb import installed_verbs

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import FrameType

app = typer.Typer(
    name="heli-host",
    help="Fly, identify and diagnose a 3-DOF laboratory helicopter, real or simulated.\n\n"
    "See `heli-host COMMAND --help` for options and examples. No command opens a board unless you "
    "name it with --port or HELI_PORT, or use the simulation with --sil.",
    no_args_is_help=True,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _say_version(wanted: bool) -> None:
    """Print the version of the program and of the link, and exit."""
    if wanted:
        from heli_host.declaration import LINK_VERSION
        from heli_host.link.installation import installed_version
        from heli_host.ui.cli.say import say

        say(f"heli-host {installed_version()}, link {LINK_VERSION}")
        raise typer.Exit


def _suppress_progress(wanted: bool) -> None:
    """Suppress progress messages, for the option --quiet."""
    if wanted:
        from heli_host.ui.cli.say import QUIET

        QUIET.set(True)


def _replace_any_file(wanted: bool) -> None:
    """Permit the replacement of files that the program did not write, for the option --force."""
    if wanted:
        from heli_host.data.files import FORCE

        FORCE.set(True)


@app.callback()
def _common_options(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_say_version, is_eager=True, help="Print the version and exit."),
    ] = False,
    quiet: Annotated[
        bool,
        typer.Option(
            "--quiet", "-q", callback=_suppress_progress, help="Print results and errors only, no progress."
        ),
    ] = False,
    force: Annotated[
        bool,
        typer.Option(
            "--force",
            callback=_replace_any_file,
            is_eager=True,
            help="Replace files that heli-host did not write, or that were edited.",
        ),
    ] = False,
) -> None:
    """Options that come before any verb."""


for _name, _verb in installed_verbs().items():
    _verb.add_to(app, _name)

# Typer raises its errors from click, or from its own copy of click since 0.25; this class is in both.
_UsageError = next(base for base in typer.BadParameter.__mro__ if base.__name__ == "ClickException")

_OUTPUT_OPTIONS = {
    "--figure",
    "--json",
    "--learn",
    "--log",
    "--output",
    "--report",
    "--save-params",
    "--save-rig",
    "--template",
}
"""Options of all verbs that name a file or folder to write."""

_SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")
EXIT_ASKED, EXIT_FILE, EXIT_BUG, EXIT_INTERRUPTED = 2, 5, 70, 130


def main() -> NoReturn:
    """Run the command line; ends the process."""
    _land_on_signals()
    code = run()
    # All is written; while Python ends, a signal would only change the exit code.
    for name in _SIGNALS:
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    sys.exit(code)


def run(arguments: list[str] | None = None) -> int:
    """Run the command line of `arguments`, what follows ``heli-host``, or of this process, and return its
    exit code, as in the module's docstring.
    """
    try:
        words = sys.argv[1:] if arguments is None else arguments
        verb = next((word for word in words if not word.startswith("-")), None)
        # In a copy, because --force sets a variable, which must not outlast the command.
        code = contextvars.copy_context().run(
            command_line(verb), arguments, "heli-host", standalone_mode=False
        )
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        # The reader of our output (`| head`) is gone; Python would complain about it once more at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_ASKED
    except Exception as error:
        if os.environ.get("HELI_DEBUG"):
            raise
        from heli_host.errors import printable

        message, exit_code = _line_and_exit_code(error)
        if message:
            print(f"error: {printable(message)}", file=sys.stderr)
        return exit_code
    if code == EXIT_INTERRUPTED:
        # typer has turned the KeyboardInterrupt of a verb into this code, without a word.
        print("interrupted", file=sys.stderr)
    return code if isinstance(code, int) else 0


def _check_output(_context: object, parameter: Any, value: Any) -> Any:
    """Refuse a place for a result that has a foreign file, before any work begins; return `value`."""
    from pathlib import Path

    from heli_host.data.files import check_replaceable

    if value is not None and str(value) != "-":
        is_report = "--report" in parameter.opts
        for name in ("index.html", "result.json") if is_report else ("",):
            check_replaceable(Path(value, name))
    return value


@functools.cache
def command_line(verb: str | None = None) -> Callable[..., object]:
    """Build the command line, and let each verb accept ``--quiet`` and ``--force``, too."""
    reduced_app = copy.copy(app)
    reduced_app.registered_commands = [info for info in app.registered_commands if info.name == verb]
    reduced_app.registered_groups = [info for info in app.registered_groups if info.name == verb]
    is_verb = bool(reduced_app.registered_commands or reduced_app.registered_groups)
    command_group = typer.main.get_command(reduced_app if is_verb else app)
    common = [copy.copy(option) for option in command_group.params if option.name in ("quiet", "force")]
    for option in common:
        option.expose_value = False
    commands = list(getattr(command_group, "commands", {}).values())
    while commands:
        command = commands.pop()
        commands += getattr(command, "commands", {}).values()
        names = {name for known in command.params for name in known.opts}
        command.params += [option for option in common if not names & set(option.opts)]
        for parameter in command.params:
            if _OUTPUT_OPTIONS & set(parameter.opts) and parameter.callback is None:
                parameter.callback = _check_output
    return command_group


def _land_on_signals() -> None:
    """Make SIGINT, SIGTERM and SIGHUP the same: the end of a flight is a landing."""
    for name in _SIGNALS:
        number = getattr(signal, name, None)
        # Started with & by a script, a program finds SIGINT ignored, and kill -INT would do nothing. Under
        # nohup it finds SIGHUP ignored, which is what its user wants.
        ignored = number is not None and signal.getsignal(number) == signal.SIG_IGN
        if number is not None and not (ignored and name == "SIGHUP"):
            signal.signal(number, _raise_interrupt)


def _raise_interrupt(number: int, _frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt for a signal, unless one has ended a flight already; after SIGHUP the terminal
    is not used any more.
    """
    from heli_host.board.interrupts import flight_was_interrupted

    name = signal.Signals(number).name
    if name == "SIGHUP":
        _leave_the_terminal()
    if flight_was_interrupted():
        # The motors are off, and the result of the flight is being written.
        return
    raise KeyboardInterrupt(name)


def _leave_the_terminal() -> None:
    """Redirect standard output and error to /dev/null if the terminal was closed."""
    # Otherwise each printed line would raise an error.
    null = os.open(os.devnull, os.O_WRONLY)
    for descriptor in (1, 2):
        if stat.S_ISCHR(os.fstat(descriptor).st_mode):
            os.dup2(null, descriptor)
    os.close(null)


def _line_and_exit_code(error: Exception) -> tuple[str, int]:
    """Return one line and an exit code for any error."""
    from heli_host.errors import HeliError, file_remedy

    if isinstance(error, _UsageError):
        return _usage_text(error)
    if isinstance(error, typer.Abort):
        return "interrupted", EXIT_INTERRUPTED
    if isinstance(error, HeliError):
        return str(error), error.exit_code
    if isinstance(error, OSError):
        name = f"{error.filename}: " if error.filename else ""
        return f"{name}{error.strerror or error}; {file_remedy(error)}", EXIT_FILE
    if isinstance(error, ModuleNotFoundError):
        return f"the Python package {error.name} is missing; {_module_remedy(error.name or '')}", EXIT_ASKED
    summary = " ".join(f"{type(error).__name__}: {error}".split())
    return f"unexpected {summary}; please report it with what HELI_DEBUG=1 prints", EXIT_BUG


def _module_remedy(package: str) -> str:
    """Return how to get a missing package: by an extra, by a new installation, or from its author."""
    # The name of an unknown module is no command to install it: a stranger may offer a package of that name.
    from heli_host.errors import install_remedy
    from heli_host.ui.cli.doctor import extra_with, needs

    if extra := extra_with(package):
        return install_remedy(extra)
    if needs(package):
        return "in your checkout of heli-lab, run: pip install -e ."
    return "correct its name in the file that imports it, or install the package that contains it"


def _usage_text(error: Exception) -> tuple[str, int]:
    """Return typer's message about a wrong command line, with the help command, and the exit code."""
    message = " ".join(error.format_message().split()) if hasattr(error, "format_message") else str(error)
    problems = getattr(error.__cause__, "errors", None)
    if problems is not None and "Input should be a valid" in message:
        # pydantic's message does not contain the typed text or the usual reason, a comma or a unit.
        message = message.partition("Input should be a valid")[0] + _not_a_number(
            str(problems()[0]["input"]), command_group="integer" in message
        )
    context = getattr(error, "ctx", None)
    if not message:  # no_args_is_help has printed the help already
        return "", EXIT_ASKED
    command = context.command_path if context is not None else "heli-host"
    return f"{message.rstrip('.')}; see {command} --help", EXIT_ASKED


def _not_a_number(written: str, *, command_group: bool) -> str:
    """Return an error message for text that should be a number, and how to write one."""
    if command_group:
        return f"'{written}' is not a whole number; give one, such as 3"
    return f"'{written}' is not a number; write it with a decimal point and without a unit, such as 0.5"
