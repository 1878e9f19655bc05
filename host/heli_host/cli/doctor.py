"""``heli-host doctor``: what keeps this computer from flying, and the remedy."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import re
import shutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from heli_host.cli.board import ARDUINO_VID, is_due, is_due_native

if TYPE_CHECKING:
    from heli_host.link.transport import PortInfo

UDEV_FOLDERS = (Path("/etc/udev/rules.d"), Path("/run/udev/rules.d"), Path("/usr/lib/udev/rules.d"))
UDEV_REMEDY = (
    'echo \'ATTRS{idVendor}=="2341", ENV{ID_MM_DEVICE_IGNORE}="1"\' | '
    "sudo tee /etc/udev/rules.d/99-heli.rules; sudo udevadm control --reload; then plug the board in again"
)


class Verdict(Enum):
    """How a finding counts."""

    GOOD = "good"
    NOTE = "note"  # only matters for something that may not be wanted, such as hardware
    BAD = "bad"


@dataclass(frozen=True)
class Finding:
    """One line of the report.

    Parameters
    ----------
    verdict : Verdict
        Whether it is all right.
    what : str
        What was looked at and found.
    remedy : str
        What to do about it; empty when it is all right.
    """

    verdict: Verdict
    what: str
    remedy: str = ""


def doctor() -> None:
    """Check this computer: Python, packages, compiler, serial port, ModemManager.

    Says the remedy of each problem; the exit code is 1 when something that is needed does not work.

    Example: `heli-host doctor`
    """
    from rich.console import Console
    from rich.markup import escape

    marks = {Verdict.GOOD: "[green]✓[/]", Verdict.NOTE: "[yellow]–[/]", Verdict.BAD: "[red]✗[/]"}
    console = Console(highlight=False, soft_wrap=True)
    bad_count = 0
    for finding in examine():
        console.print(f"{marks[finding.verdict]} {escape(finding.what)}")
        if finding.remedy:
            console.print(f"    {escape(finding.remedy)}")
        bad_count += finding.verdict is Verdict.BAD
    if bad_count:
        console.print(f"{bad_count} thing{'s' if bad_count > 1 else ''} to mend, see ✗ above")
        raise typer.Exit(1)
    console.print("ready to fly")


def examine() -> Iterator[Finding]:
    """Look at everything, one finding at a time.

    Yields
    ------
    Finding
        In the order in which things depend on each other.
    """
    yield check_python()
    yield check_packages()
    yield check_core()
    yield check_compiler()
    yield check_cache()
    yield check_pseudo_terminal()
    from heli_host.link.transport import available_ports

    ports = available_ports()
    yield from check_boards(ports)
    yield from check_permissions(ports)
    yield check_modem_manager(any(is_due(port) for port in ports))


def check_python(version: tuple[int, ...] = sys.version_info[:3]) -> Finding:
    """Check the interpreter's version.

    Parameters
    ----------
    version : tuple of int
        Major, minor, micro.

    Returns
    -------
    Finding
        Bad below 3.11.
    """
    text = f"Python {'.'.join(map(str, version))}"
    if version >= (3, 11):
        return Finding(Verdict.GOOD, text)
    return Finding(Verdict.BAD, f"{text} is too old", "install Python 3.11 or newer, then: make setup")


def check_packages(is_installed: Callable[[str], bool] | None = None) -> Finding:
    """Check that every package this one depends on is installed.

    Parameters
    ----------
    is_installed : callable, optional
        Takes a distribution's name and says whether it is there.

    Returns
    -------
    Finding
        Bad when one is missing.
    """
    is_installed = is_installed or _is_installed
    required = importlib.metadata.requires("heli-host") or []
    names = [re.split(r"[^\w.-]", line, maxsplit=1)[0] for line in required if "extra ==" not in line]
    missing = [name for name in names if not is_installed(name)]
    if missing:
        return Finding(Verdict.BAD, f"packages missing: {', '.join(missing)}", "run: make setup")
    return Finding(Verdict.GOOD, f"{len(names)} packages: {', '.join(names)}")


def _is_installed(name: str) -> bool:
    try:
        importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return False
    return True


def check_core() -> Finding:
    """Check that the flight code was compiled for this machine.

    Returns
    -------
    Finding
        Bad when it cannot be loaded: nothing can be simulated.
    """
    try:
        import heli_sim._native  # noqa: F401  -- whether it loads is the question
    except ImportError as error:
        return Finding(Verdict.BAD, f"the simulated board does not load: {error}", "run: make setup")
    return Finding(Verdict.GOOD, "simulated board: the flight code compiled for this machine loads")


def check_compiler() -> Finding:
    """Check that a C compiler is there; the simulated helicopter's equations are compiled with it.

    Returns
    -------
    Finding
        Bad without one.
    """
    wanted = [name for name in (os.environ.get("CC"), "cc", "gcc", "clang") if name]
    for name in wanted:
        path = shutil.which(name)
        if path:
            return Finding(Verdict.GOOD, f"C compiler: {path}")
    return Finding(Verdict.BAD, "no C compiler", "install one, for example: sudo apt-get install g++")


def check_cache() -> Finding:
    """Check that compiled equations can be kept between runs.

    Returns
    -------
    Finding
        Bad when the folder cannot be written.
    """
    base = os.environ.get("XDG_CACHE_HOME")
    folder = Path(base) if base else Path.home() / ".cache"
    probe = folder / f"heli-doctor-{os.getpid()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe.write_bytes(b"")
        probe.unlink()
    except OSError as error:
        return Finding(
            Verdict.BAD,
            f"cache folder {folder} cannot be written: {error.strerror}",
            "name another one in the environment: XDG_CACHE_HOME=...",
        )
    return Finding(Verdict.GOOD, f"cache folder {folder} can be written")


def check_pseudo_terminal() -> Finding:
    """Check pseudo-terminals and, through one, that the system takes the link's odd baud rate.

    Returns
    -------
    Finding
        Bad when the simulated board could not be reached; a note on systems without pseudo-terminals.
    """
    from heli_host.link.declaration import BAUD

    if not hasattr(os, "openpty"):
        return Finding(
            Verdict.NOTE, "no pseudo-terminals on this system", "simulate with --speed max, or over TCP"
        )
    import serial

    board_end = -1
    host_end = -1
    try:
        board_end, host_end = os.openpty()
        with serial.Serial(os.ttyname(host_end), BAUD, timeout=1.0) as port:
            os.write(board_end, b"heli")
            if port.read(4) != b"heli":
                return Finding(Verdict.BAD, "a pseudo-terminal loses bytes", "restart this computer")
    except (OSError, serial.SerialException, ValueError) as error:
        return Finding(
            Verdict.BAD,
            f"pseudo-terminals at {BAUD} baud do not work: {error}",
            "mount /dev/pts (in a container: start it with a terminal), or simulate with --speed max",
        )
    finally:
        for descriptor in (board_end, host_end):
            if descriptor >= 0:
                os.close(descriptor)
    return Finding(Verdict.GOOD, f"pseudo-terminals work, at {BAUD} baud too")


def check_boards(ports: list[PortInfo]) -> Iterator[Finding]:
    """Say which boards are plugged in.

    Parameters
    ----------
    ports : list of PortInfo
        The serial ports of this machine.

    Yields
    ------
    Finding
        One a board; a note when there is none.
    """
    boards = [port for port in ports if is_due(port)]
    for port in boards:
        yield Finding(Verdict.GOOD, f"board: Arduino Due, programming port, on {port.device}")
    for port in ports:
        if is_due_native(port):
            yield Finding(
                Verdict.BAD,
                f"board: a Due on {port.device}, but by its native port",
                "move the cable to the programming port, next to the power jack",
            )
    if not boards:
        yield Finding(Verdict.NOTE, "no Due is plugged in: only the simulated board can fly")


def check_permissions(ports: list[PortInfo]) -> Iterator[Finding]:
    """Check that this user may open the serial ports.

    Parameters
    ----------
    ports : list of PortInfo
        The serial ports of this machine.

    Yields
    ------
    Finding
        Bad for a Due that may not be opened, a note for any other port.
    """
    for port in ports:
        if not port.device.startswith("/") or os.access(port.device, os.R_OK | os.W_OK):
            continue
        group = _group_of(port.device)
        yield Finding(
            Verdict.BAD if is_due(port) else Verdict.NOTE,
            f"no permission for {port.device}",
            f"run: sudo usermod -aG {group} $USER, then log out and in again",
        )


def _group_of(device: str) -> str:
    """Group that may open a port: dialout on Debian, uucp on Arch."""
    try:
        return Path(device).group()
    except (OSError, KeyError):
        return "dialout"


def check_modem_manager(due_is_present: bool) -> Finding:
    """Check that ModemManager leaves the board alone; it may hold a new port for half a minute.

    Parameters
    ----------
    due_is_present : bool
        Whether a Due is plugged in.

    Returns
    -------
    Finding
        Bad when it runs, may grab a Due, and one is there.
    """
    if not _process_runs("ModemManager"):
        return Finding(Verdict.GOOD, "ModemManager does not run")
    if _udev_ignores_arduino():
        return Finding(Verdict.GOOD, "ModemManager runs and is told to leave Arduinos alone")
    verdict = Verdict.BAD if due_is_present else Verdict.NOTE
    return Finding(verdict, "ModemManager runs and may grab the board when it is plugged in", UDEV_REMEDY)


def _process_runs(name: str) -> bool:
    for entry in Path("/proc").glob("[0-9]*/comm"):
        try:
            if entry.read_text().strip() == name:
                return True
        except OSError:  # it ended meanwhile
            continue
    return False


def _udev_ignores_arduino() -> bool:
    vendor = f"{ARDUINO_VID:04x}"
    for folder in UDEV_FOLDERS:
        for rules in folder.glob("*.rules"):
            try:
                lines = rules.read_text(errors="replace").splitlines()
            except OSError:
                continue
            if any(vendor in line and "ID_MM_DEVICE_IGNORE" in line for line in lines):
                return True
    return False
