"""ModemManager, which may hold a board's port for half a minute after it was plugged in."""

from __future__ import annotations

from pathlib import Path

from heli_host.cli.board import ARDUINO_VID
from heli_host.cli.finding import Finding, Verdict

UDEV_FOLDERS = (Path("/etc/udev/rules.d"), Path("/run/udev/rules.d"), Path("/usr/lib/udev/rules.d"))
UDEV_REMEDY = (
    'echo \'ATTRS{idVendor}=="2341", ENV{ID_MM_DEVICE_IGNORE}="1"\' | '
    "sudo tee /etc/udev/rules.d/99-heli.rules; sudo udevadm control --reload; then plug the board in again"
)


def check_modem_manager(due_is_present: bool) -> Finding:
    """Check that ModemManager ignores the board; it may occupy a new port for half a minute. The verdict is
    bad if ModemManager runs, may open a Due, and `due_is_present`.
    """
    if not _process_runs("ModemManager"):
        return Finding(Verdict.GOOD, "ModemManager does not run")
    if _udev_ignores_arduino():
        return Finding(Verdict.GOOD, "ModemManager runs and is configured to ignore Arduinos")
    verdict = Verdict.BAD if due_is_present else Verdict.NOTE
    return Finding(verdict, "ModemManager runs and may grab the board when it is plugged in", UDEV_REMEDY)


def _process_runs(name: str) -> bool:
    """Whether a process of this name runs; only Linux lists processes there."""
    for entry in Path("/proc").glob("[0-9]*/comm"):
        try:
            if entry.read_text().strip() == name:
                return True
        except OSError:  # it ended meanwhile
            continue
    return False


def _udev_ignores_arduino() -> bool:
    """Whether a udev rule tells ModemManager to ignore the ports of Arduino boards."""
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
