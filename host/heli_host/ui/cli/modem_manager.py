"""ModemManager, which may hold a board's port for half a minute after it was plugged in."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from heli_host.ui.cli.board import ARDUINO_VIDS
from heli_host.ui.cli.finding import Finding, Verdict

UDEV_FOLDERS = (Path("/etc/udev/rules.d"), Path("/run/udev/rules.d"), Path("/usr/lib/udev/rules.d"))
UDEV_REMEDY = (
    'echo \'ATTRS{idVendor}=="2341|2a03", ENV{ID_MM_DEVICE_IGNORE}="1"\' | '
    "sudo tee /etc/udev/rules.d/99-heli.rules; sudo udevadm control --reload; then plug the board in again"
)


def check_modem_manager(vendors: Collection[int]) -> Finding:
    """Check that ModemManager ignores the board; it may occupy a new port for half a minute. The verdict is
    bad if ModemManager runs, and may open one of the Dues present, which have the USB numbers `vendors`.
    """
    if not _process_runs("ModemManager"):
        return Finding(Verdict.GOOD, "ModemManager does not run")
    if all(_udev_ignores(vendor) for vendor in vendors or ARDUINO_VIDS[:1]):
        return Finding(Verdict.GOOD, "ModemManager runs and is configured to ignore Arduinos")
    verdict = Verdict.BAD if vendors else Verdict.NOTE
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
