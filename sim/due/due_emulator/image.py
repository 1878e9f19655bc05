"""Programs for the Due: ELF files with their symbols, and plain images of the flash."""

from __future__ import annotations

import io
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from due_emulator.errors import ImageError

FLASH_BASE = 0x0008_0000
FLASH_SIZE = 512 * 1024


@dataclass(frozen=True)
class Symbol:
    """A function or an object of a program."""

    name: str  # As in the ELF, mangled
    address: int  # Without the Thumb bit
    size: int  # Bytes; 0 when the ELF does not say
    is_function: bool  # False for data


@dataclass(frozen=True)
class Image:
    """Content of the flash, with the symbols of the program."""

    path: Path  # File that it was read from
    segments: tuple[tuple[int, bytes], ...]  # Address and bytes of each piece
    symbols: tuple[Symbol, ...]  # Functions and objects, in no particular order

    def address(self, name: str) -> int:
        """Address of a symbol by its `name` in the ELF, mangled; an ImageError when there is none."""
        for symbol in self.symbols:
            if symbol.name == name:
                return symbol.address
        raise ImageError(f"{self.path.name} has no symbol {name}", "build it without stripping")


def _in_flash(address: int, size: int) -> bool:
    return address >= FLASH_BASE and address + size <= FLASH_BASE + FLASH_SIZE


def _symbol(name: str, value: int, size: int, is_function: bool) -> Symbol:
    return Symbol(name, value & ~1 if is_function else value, size, is_function)


@lru_cache(maxsize=4)
def _read_elf(path: Path, content: bytes) -> Image:
    """Read an ELF of this `content`; again only if it differs: each symbol takes 0.01 ms."""
    # Imported late: only programs with symbols need the library, which has no types.
    from elftools.common.exceptions import ELFError  # type: ignore[import-not-found,unused-ignore]
    from elftools.elf.elffile import ELFFile  # type: ignore[import-not-found,unused-ignore]

    try:
        return _read_segments(path, ELFFile(io.BytesIO(content)))
    except ELFError as error:
        raise ImageError(f"{path} is not a readable ELF file ({error})", "build it again") from error


def _read_segments(path: Path, elf: Any) -> Image:
    if elf["e_machine"] != "EM_ARM":
        raise ImageError(f"{path} is for {elf['e_machine']}, not for ARM", "give the firmware's ELF")
    segments = tuple(
        (int(segment["p_paddr"]), bytes(segment.data()))
        for segment in elf.iter_segments()
        if segment["p_type"] == "PT_LOAD" and segment["p_filesz"]
    )
    table = elf.get_section_by_name(".symtab")
    entries = list(table.iter_symbols()) if table is not None else []
    symbols = tuple(
        _symbol(entry.name, entry["st_value"], entry["st_size"], entry["st_info"]["type"] == "STT_FUNC")
        for entry in entries
        if entry["st_info"]["type"] in ("STT_FUNC", "STT_OBJECT")
    )
    return Image(path, segments, symbols)


def read_image(path: Path | str) -> Image:
    """Read a program at `path`: an ELF, or the bytes of the flash from 0x80000 on (``.bin``). An ImageError
    when the file is missing, is not an ELF for ARM, or has addresses outside the Due's flash.
    """
    path = Path(path)
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ImageError(f"{path}: {error.strerror}", "give the path of an ELF or .bin") from error
    is_elf = content.startswith(b"\x7fELF")
    image = _read_elf(path, content) if is_elf else Image(path, ((FLASH_BASE, content),), ())
    for address, data in image.segments:
        if not _in_flash(address, len(data)):
            raise ImageError(
                f"{path.name} has {len(data)} bytes at {address:#x}, outside of the Due's flash",
                "link it for the SAM3X8E, from 0x80000 on",
            )
    if not any(data for _, data in image.segments):
        raise ImageError(f"{path} contains nothing to load", "link it for the SAM3X8E")
    return image
