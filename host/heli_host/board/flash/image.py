"""Check that a file is the firmware of this release for the Due."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

from heli_host.declaration import LINK_HASH
from heli_host.errors import ImageError

# Memory of the SAM3X8E, as in firmware/due/due.ld.
FLASH_START = 0x0008_0000
CODE_MAX_BYTES = 512 * 1024 - 512
RAM_START = 0x2007_0000
RAM_END = 0x2008_8000
VECTORS = 16 + 45

_BUILD = "build it with make firmware and give build/pio/due/firmware.bin"


@dataclass(frozen=True)
class FirmwareImage:
    """A file at `path` that may be flashed; its `content` goes to the start of the flash."""

    path: Path
    content: bytes


def read_image(path: Path) -> FirmwareImage:
    """Read an image and check that the Due would start it and this host could talk to it."""
    content = path.read_bytes()
    if content.startswith(b"\x7fELF"):
        raise ImageError(
            f"{path} is an ELF file", f"give the .bin file next to it ({path.with_suffix('.bin')})"
        )
    if content.startswith(b":") and content[1:9].isalnum():
        raise ImageError(f"{path} is an Intel HEX file", _BUILD)
    if not VECTORS * 4 <= len(content) <= CODE_MAX_BYTES:
        raise ImageError(
            f"{path} has {len(content)} bytes; an image for the Due has {VECTORS * 4} to {CODE_MAX_BYTES}",
            _BUILD,
        )
    _check_vector_table(path, content)
    if struct.pack("<I", LINK_HASH) not in content:
        raise ImageError(
            f"{path} does not hold the hash of this host's link ({LINK_HASH:08x}): "
            "it is other firmware, or firmware of another release",
            f"{_BUILD}, or use the heli_host that belongs to it",
        )
    return FirmwareImage(path, content)


def _check_vector_table(path: Path, content: bytes) -> None:
    """Refuse what the processor could not start: its first two words are stack and entry."""
    stack, *handlers = struct.unpack_from(f"<{VECTORS}I", content)
    code = range(FLASH_START, FLASH_START + len(content))
    if not (RAM_START < stack <= RAM_END and stack % 4 == 0):
        raise ImageError(f"{path} is not firmware for the Due: its stack is at {stack:#010x}", _BUILD)
    # Bit 0 of a vector says Thumb, which is all that this processor runs; 0 is a vector that is not used.
    if not (handlers[0] & 1 and handlers[0] - 1 in code):
        raise ImageError(
            f"{path} is not firmware for the Due: its entry point is at {handlers[0]:#010x}", _BUILD
        )
    for number, handler in enumerate(handlers[1:], 2):
        if handler and not (handler & 1 and handler - 1 in code):
            raise ImageError(
                f"{path} is damaged: interrupt vector {number} points to {handler:#010x}", _BUILD
            )
