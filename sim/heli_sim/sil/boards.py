"""The two boards of a simulation: the flight code compiled for this machine, and the emulated Due."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from heli_host.data.files import file_digest

from heli_sim import _native
from heli_sim.errors import SimError
from heli_sim.rig import Rig
from heli_sim.rig.rig import rig_text
from heli_sim.sil.options import AUTO, DUE, NATIVE, SilOptions

if TYPE_CHECKING:
    from heli_sim.due._due_board import DueBoard


# The two pages of the parameters, as in firmware/due/drivers.hpp. A flash file has them first, and is as long
# as the native board's flash, so that the two boards can take each other's.
_PAGES_AT: Final = 0x000FFC00
_PAGES_BYTES: Final = 1024
_FILE_BYTES: Final = 2048


@dataclass(frozen=True)
class Choice:
    """The board that is flown, and why."""

    name: str  # ``native`` or ``due``
    elf: str  # ELF of the emulated Due; empty for the native board
    named: bool  # Whether that ELF was asked for; otherwise it is the newest
    text: str  # For people, such as ``emulated Due, heli.elf``
    reason: str = ""  # With ``auto``: why it is not the Due


def choose(board: str, elf: str = "") -> Choice:
    """Choose the board that is flown."""
    if board == NATIVE:
        return Choice(NATIVE, "", named=False, text="native board")
    from heli_sim.due.firmware import check_firmware, find_firmware

    try:
        if elf:
            check_firmware(Path(elf))
        path = Path(elf) if elf else find_firmware()
    except (SimError, ImportError) as error:
        if board == AUTO and not elf:
            return Choice(NATIVE, elf="", named=False, text="native board", reason=str(error))
        raise
    return Choice(DUE, str(path), bool(elf), f"emulated Due, {path.name}")


def resolved(options: SilOptions) -> SilOptions:
    """Return options that name the board, ``native`` or ``due``, and its ELF file. Raises as `choose`
    does.
    """
    choice = choose(options.board, options.elf)
    return replace(options, board=choice.name, elf=choice.elf)


class NativeBoard:
    """The flight code compiled for this machine. Its flash pages are kept in `flash_file`; without a file
    they are lost at the end. Each start has a separate boot id, derived from `boot_seed`.
    """

    stops: tuple[type[Exception], ...] = ()
    """Exceptions that the board may raise while time passes."""

    def __init__(self, flash_file: str, boot_seed: int = 1) -> None:
        self.sim = _native.NativeBoard(flash_file, boot_seed=boot_seed)

    @property
    def bytes_lost(self) -> int:
        """Bytes from the host that were lost because the board's buffer was full."""
        return self.sim.rx_overflow

    def keep_flash(self) -> None:
        """Do nothing: this board writes its file by itself."""

    def fill_flash(self, flash: bytes) -> None:
        """Write `flash`, as `heli_sim.sil.world.saved` makes it, into the board before its first
        start.
        """
        self.sim.flash = flash


class EmulatedDue:
    """An emulated Due that runs the ELF file of the real firmware."""

    def __init__(self, elf: str, flash_file: str, boot_seed: int = 1) -> None:
        from due_emulator import Stop

        from heli_sim.due.firmware import new_board, read_firmware

        self.stops: tuple[type[Exception], ...] = (Stop,)
        """What the board may raise while time passes."""
        self.sim: DueBoard = new_board(read_firmware(elf))
        self.sim.due.seed_random(boot_seed)
        self._file = Path(flash_file) if flash_file else None
        if self._file is not None and self._file.exists():
            flash_content = self._file.read_bytes()
            if len(flash_content) != _FILE_BYTES:
                raise SimError(
                    f"the flash file {self._file} is not {_FILE_BYTES} bytes long",
                    "delete it; the simulated board creates it again",
                )
            self.sim.due.load(_PAGES_AT, flash_content[:_PAGES_BYTES])
        self._writes = self.sim.due.flash_writes

    @property
    def bytes_lost(self) -> int:
        """Bytes from the host that were lost because the board's buffer was full."""
        return self.sim.due.uart_overruns

    def fill_flash(self, flash: bytes) -> None:
        """Write `flash`, as `heli_sim.sil.world.saved` makes it, into the board before its first
        start.
        """
        self.sim.due.load(_PAGES_AT, flash[:_PAGES_BYTES])

    def keep_flash(self) -> None:
        """Write the parameter pages to their file, if the program has changed them."""
        due = self.sim.due
        if self._file is None or due.flash_writes == self._writes or due.flash_busy:
            return
        self._writes = due.flash_writes
        pages = due.peek(_PAGES_AT, _PAGES_BYTES)
        self._file.write_bytes(pages.ljust(_FILE_BYTES, b"\xff"))


SimBoard = NativeBoard | EmulatedDue


def make_board(options: SilOptions, boot_seed: int = 1) -> SimBoard:
    """Make the board that `resolved` options name, powered off."""
    # A SimError is raised when the ELF or the flash file cannot be used. `boot_seed` (0 to 2^64 - 1) gives
    # the boots of this board ids that no other board has.
    if options.board == DUE:
        return EmulatedDue(options.elf, options.flash_file, boot_seed)
    return NativeBoard(options.flash_file, boot_seed)


_EXACT_DIGITS = 17


def recipe_of(url: str, options: SilOptions, rig: Rig, choice: Choice) -> dict[str, str]:
    """Return the address of the simulation, the whole rig, and digests of the files that it executes."""
    # `heli_host.ui.cli.flight` reads this recipe from a log and repeats the flight. The recipe has no code,
    # because a log from another person must not execute code.
    return {
        "address": url,
        "rig_name": rig.name,
        "rig": rig_text(rig, digits=_EXACT_DIGITS),
        "effect_files": json.dumps({file: file_digest(Path(file)) for file in options.effect_files}),
        "flash": options.flash_file,
        "firmware": file_digest(Path(choice.elf)) if choice.elf else "",
    }
