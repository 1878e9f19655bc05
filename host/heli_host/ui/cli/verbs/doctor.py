"""``heli-host doctor``: find what prevents this computer from flying, and show how to fix it."""

from __future__ import annotations

import importlib.metadata
import os
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from heli_host.link.installation import plugins
from heli_host.ui.cli.board import is_due, is_due_native
from heli_host.ui.cli.extras import USERS_EXTRAS, packages_of
from heli_host.ui.cli.finding import ENTRY_POINT_GROUP, Finding, Verdict
from heli_host.ui.cli.modem_manager import check_modem_manager
from heli_host.ui.cli.options import JsonOption
from heli_host.ui.cli.say import write_result
from heli_host.ui.cli.verb import Verb

if TYPE_CHECKING:
    from heli_host.link.transport import PortInfo


def doctor(json: JsonOption = None) -> None:
    """Check this computer, and print how to fix each problem.

    Checks Python, packages, compiler, serial ports and ModemManager. Opens no port. The exit code is 1 if
    something required does not work.

    Example: `heli-host doctor`
    """
    from rich.console import Console
    from rich.markup import escape

    from heli_host.errors import printable

    if json is not None:
        findings = list(examine())
        bad_count = sum(finding.verdict is Verdict.BAD for finding in findings)
        shown_findings = [
            {"verdict": finding.verdict.value, "what": finding.what, "remedy": finding.remedy}
            for finding in findings
        ]
        write_result(json, {"ready": not bad_count, "findings": shown_findings})
        raise typer.Exit(1 if bad_count else 0)
    mark_of_verdict = {Verdict.GOOD: "[green]✓[/]", Verdict.NOTE: "[yellow]–[/]", Verdict.BAD: "[red]✗[/]"}
    console = Console(highlight=False, soft_wrap=True)
    bad_count = 0
    for finding in examine():
        console.print(f"{mark_of_verdict[finding.verdict]} {escape(printable(finding.what))}")
        if finding.remedy:
            console.print(f"    {escape(printable(finding.remedy))}")
        bad_count += finding.verdict is Verdict.BAD
    if bad_count:
        console.print(f"{bad_count} problem{'s' if bad_count > 1 else ''} to fix, see ✗ above")
        raise typer.Exit(1)
    console.print("ready to fly")


def examine() -> Iterator[Finding]:
    """Yield one finding at a time, in an order in which no check depends on a later one.

    Other packages add their own checks by an entry point.
    """
    yield check_python()
    yield check_packages()
    yield from check_extras()
    for entry in plugins(ENTRY_POINT_GROUP):
        yield from entry.load()()
    from heli_host.link.transport import available_ports

    ports = available_ports()
    yield from check_boards(ports)
    yield from check_permissions(ports)
    dues = [port for port in ports if is_due(port)]
    yield check_modem_manager({port.vendor_id for port in dues if port.vendor_id is not None})


def check_python(version: tuple[int, ...] = sys.version_info[:3]) -> Finding:
    """Check the interpreter's `version`: major, minor, micro."""
    text = f"Python {'.'.join(map(str, version))}"
    if version >= (3, 11):
        return Finding(Verdict.GOOD, text)
    return Finding(Verdict.BAD, f"{text} is too old", "install Python 3.11 or newer, then: make setup")


def check_packages(is_installed: Callable[[str], bool] | None = None) -> Finding:
    """Check that all packages that heli-host needs are installed; `is_installed` takes a package's name."""
    is_installed = is_installed or _is_installed
    required = importlib.metadata.requires("heli-host") or []
    names = [re.split(r"[^\w.-]", line, maxsplit=1)[0] for line in required if "extra ==" not in line]
    missing = [name for name in names if not is_installed(name)]
    if missing:
        return Finding(Verdict.BAD, f"packages missing: {', '.join(missing)}", "run: make setup")
    return Finding(Verdict.GOOD, f"{len(names)} packages: {', '.join(names)}")


def check_extras(is_installed: Callable[[str], bool] | None = None) -> Iterator[Finding]:
    """Yield the optional parts that work, and one note per part that lacks a package."""
    from heli_host.errors import install_remedy

    is_installed = is_installed or _is_installed
    complete = []
    for extra, purpose in USERS_EXTRAS.items():
        missing = [name for name in packages_of(extra) if not is_installed(name)]
        if missing:
            yield Finding(
                Verdict.NOTE,
                f"not installed: {purpose} (needs {', '.join(missing)})",
                f"if you want it, {install_remedy(extra)}",
            )
        else:
            complete.append(purpose)
    if complete:
        yield Finding(Verdict.GOOD, f"optional: {', '.join(complete)}")


def _is_installed(name: str) -> bool:
    """Whether a Python package is installed."""
    try:
        importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return False
    return True


def check_boards(ports: list[PortInfo]) -> Iterator[Finding]:
    """Yield one finding per connected board, or a note if there is none."""
    boards = [port for port in ports if is_due(port)]
    for port in boards:
        yield Finding(Verdict.GOOD, f"board: Arduino Due, programming port, on {port.device}")
    for port in ports:
        if is_due_native(port):
            yield Finding(
                Verdict.BAD,
                f"board: the Due on {port.device} is plugged in by its native port",
                "move the cable to the programming port, next to the power jack",
            )
    if not boards:
        yield Finding(Verdict.NOTE, "no Due is plugged in: only the simulated board can fly")


def check_permissions(ports: list[PortInfo]) -> Iterator[Finding]:
    """Check that this user may open the serial ports: bad for a Due that may not be opened, a note for any
    other port.
    """
    for port in ports:
        if not port.device.startswith("/") or os.access(port.device, os.R_OK | os.W_OK):
            continue
        group = _group_for_ports(port.device)
        yield Finding(
            Verdict.BAD if is_due(port) else Verdict.NOTE,
            f"you have no permission to open {port.device}",
            f"run: sudo usermod -aG {group} $USER, then log out and in again",
        )


def _group_for_ports(device: str) -> str:
    """Group that may open a port: dialout on Debian, uucp on Arch."""
    try:
        return Path(device).group()
    except (OSError, KeyError):
        return "dialout"


VERB = Verb(doctor, "Board")
