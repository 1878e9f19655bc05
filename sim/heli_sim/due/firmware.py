"""The ELF of the flight code: where it is, whether this host supports it, and an emulated board with it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from heli_sim.errors import FirmwareError

if TYPE_CHECKING:
    from due_emulator import Image

    from heli_sim.due._due_board import DueBoard

# The control tick is the interrupt of timer channel TC3, number 30 after the 16 exceptions.
TICK_HANDLER: Final = 16 + 30
# Where `make firmware`, and make in firmware/due, leave it.
_BUILT: Final = ("build/pio/due/firmware.elf", "build/firmware/heli.elf")
_MAKE: Final = "make firmware"


def candidates() -> list[Path]:
    """All ELF files of the flight code, newest first: the one in the package, if it was built with a
    cross-compiler, and in a checkout those built since.
    """
    import heli_sim

    places = [Path(folder) / "due" / "firmware" / "heli.elf" for folder in heli_sim.__path__]
    root = Path(heli_sim.__file__).resolve().parents[2]
    if (root / "firmware" / "link.toml").exists():
        places += [root / name for name in _BUILT]
    return sorted((path for path in places if path.is_file()), key=lambda path: -path.stat().st_mtime)


def new_board(image: Image) -> DueBoard:
    """Return an emulated Due for the simulated world, powered off. Its flash holds a program with the timing
    of our firmware.
    """
    from due_emulator import load_image

    from heli_sim.due._due_board import DueBoard

    board = DueBoard()
    load_image(board.due, image)
    # The flight code has a handler of its own, which stops the motors and starts anew.
    board.due.stop_at_hardfault(False)
    board.align(TICK_HANDLER)
    return board


def read_firmware(path: Path | str) -> Image:
    """Read an ELF at `path`; a FirmwareError if it is missing or not a program for the Due."""
    from due_emulator import ImageError, read_image

    try:
        return read_image(path)
    except ImageError as error:
        raise FirmwareError(error.cause, error.remedy) from error


def check_firmware(path: Path) -> Image:
    """Read an ELF at `path` and ask it on a separate emulated board for its version of the link."""
    # A FirmwareError, which states both versions, when it is not a program for the Due, does not answer, or
    # has another version.
    from due_emulator import Stop

    from heli_sim import _native

    image = read_firmware(path)
    try:
        board_link = _native.greet(new_board(image))
    except Stop as stop:
        raise FirmwareError(f"{path} does not start on the emulated Due ({stop})", _MAKE) from stop
    if board_link is None:
        raise FirmwareError(f"{path} does not answer a host", f"give the flight code's ELF, or {_MAKE}")
    host_link = _native.identity()
    if board_link[0] != host_link[0]:
        raise FirmwareError(
            f"{path} (firmware {board_link[3]}) has link version {board_link[1]}.{board_link[2]} "
            f"({board_link[0]:08x}), but this host has {host_link[1]}.{host_link[2]} ({host_link[0]:08x})",
            f"build it again, {_MAKE}",
        )
    return image


def find_firmware() -> Path:
    """Return the newest of `candidates` with this host's version of the link. A FirmwareError states why the
    newest is unsuitable, and what to do.
    """
    newest_first = candidates()
    reason: FirmwareError | None = None
    for path in newest_first:
        try:
            check_firmware(path)
        except FirmwareError as error:
            reason = reason or error
            continue
        return path
    if reason is not None:
        raise reason
    raise FirmwareError(
        "no firmware for the emulated Due is built",
        "sudo apt-get install gcc-arm-none-eabi libnewlib-arm-none-eabi libstdc++-arm-none-eabi-dev, then "
        f"{_MAKE}; or fly --board native",
    )
