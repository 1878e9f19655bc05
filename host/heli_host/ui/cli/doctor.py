"""Checks of this computer for ``heli-host doctor``: packages, serial ports and ModemManager.

A package that checks its own requirements offers a function without arguments that yields findings, in the
entry-point group ``heli_host.checks``; `examine` calls this function.
"""

from __future__ import annotations

import importlib.metadata
import os
import re
import sys
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Final

from heli_host.link.installation import plugins
from heli_host.ui.cli.board import ARDUINO_VIDS, is_due, is_due_native
from heli_host.ui.cli.verb import DISTRIBUTION

if TYPE_CHECKING:
    from heli_host.link.transport import PortInfo

ENTRY_POINT_GROUP: Final = "heli_host.checks"
USERS_EXTRAS: Final[Mapping[str, str]] = {
    "page": "the dashboard",
    "import": "spreadsheets, Parquet files and ROS bags",
    "export": "logs as Parquet",
    "foxglove": "live samples for Foxglove and PlotJuggler",
    "gym": "the Gymnasium environment",
    "campaign": "campaigns on several computers",
    "benchmark": "the benchmark of hidden causes, with other methods",
}
"""Extras that users choose, and their purpose. Other extras are for developers."""
UDEV_FOLDERS = (Path("/etc/udev/rules.d"), Path("/run/udev/rules.d"), Path("/usr/lib/udev/rules.d"))
_UDEV_REMEDY = (
    'echo \'ATTRS{idVendor}=="2341|2a03", ENV{ID_MM_DEVICE_IGNORE}="1"\' | '
    "sudo tee /etc/udev/rules.d/99-heli.rules; sudo udevadm control --reload; then plug the board in again"
)


class Verdict(Enum):
    """Severity of a finding."""

    GOOD = "good"
    NOTE = "note"  # matters only for an optional part, such as hardware
    BAD = "bad"


@dataclass(frozen=True)
class Finding:
    """One line of the report."""

    verdict: Verdict
    what: str  # Subject of the check, and its result
    remedy: str = ""  # Instruction that fixes the problem; empty if there is no problem


def examine() -> Iterator[Finding]:
    """Yield one finding at a time, in an order in which no check depends on a later one."""
    # Other packages add their own checks by an entry point.
    yield check_python()
    yield check_packages()
    yield from check_extras()
    for entry in plugins(ENTRY_POINT_GROUP):
        yield from entry.load()()
    from heli_host.link.transport import available_ports

    ports = available_ports()
    yield from _check_boards(ports)
    yield from _check_permissions(ports)
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
    names = packages_of()
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


def packages_of(extra: str = "") -> tuple[str, ...]:
    """Return the names of the packages that heli-host needs, or of those that an `extra` installs."""
    lines = importlib.metadata.requires(DISTRIBUTION) or []
    if extra:
        marker = re.compile(rf"extra == ['\"]{re.escape(extra)}['\"]")
        lines = [line for line in lines if marker.search(line)]
    else:
        lines = [line for line in lines if "extra ==" not in line]
    return tuple(re.split(r"[^\w.-]", line, maxsplit=1)[0] for line in lines)


def needs(package: str) -> bool:
    """Return whether heli-host itself needs a package."""
    return _lists_package(packages_of(), package)


def extra_with(package: str) -> str | None:
    """Return the users' extra that installs a package, or None."""
    return next((extra for extra in USERS_EXTRAS if _lists_package(packages_of(extra), package)), None)


def _lists_package(names: Collection[str], package: str) -> bool:
    return package.partition(".")[0].lower() in {name.lower() for name in names}


def _check_boards(ports: list[PortInfo]) -> Iterator[Finding]:
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


def _check_permissions(ports: list[PortInfo]) -> Iterator[Finding]:
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


def check_modem_manager(vendors: Collection[int]) -> Finding:
    """Check that ModemManager ignores the board; it may occupy a new port for half a minute. The verdict is
    bad if ModemManager runs, and may open one of the Dues present, which have the USB numbers `vendors`.
    """
    if not _process_runs("ModemManager"):
        return Finding(Verdict.GOOD, "ModemManager does not run")
    if all(_udev_ignores(vendor) for vendor in vendors or ARDUINO_VIDS[:1]):
        return Finding(Verdict.GOOD, "ModemManager runs and is configured to ignore Arduinos")
    verdict = Verdict.BAD if vendors else Verdict.NOTE
    return Finding(verdict, "ModemManager runs and may grab the board when it is plugged in", _UDEV_REMEDY)


def _process_runs(name: str) -> bool:
    """Whether a process of this name runs; only Linux lists processes there."""
    for entry in Path("/proc").glob("[0-9]*/comm"):
        try:
            if entry.read_text().strip() == name:
                return True
        except OSError:  # it ended meanwhile
            continue
    return False


def _udev_ignores(vendor_id: int) -> bool:
    """Whether a udev rule tells ModemManager to ignore the ports of a vendor's boards."""
    vendor = f"{vendor_id:04x}"
    for folder in UDEV_FOLDERS:
        for rules in folder.glob("*.rules"):
            try:
                lines = rules.read_text(errors="replace").splitlines()
            except OSError:
                continue
            if any(vendor in line and "ID_MM_DEVICE_IGNORE" in line for line in lines):
                return True
    return False
