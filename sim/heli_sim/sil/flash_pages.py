"""The flash pages of a board with saved parameters, in the layout of firmware/core/params/README.md."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from typing import Final

from heli_host.declaration import PARAMS, PARAMS_HASH

_SET_BYTES: Final = 512
_MAGIC: Final = 0x5048
_FORMAT: Final = 2
_FLASH_BYTES: Final = 2048


def saved(values: Mapping[str, float]) -> bytes:
    """Return the flash of a board that saved these `values` once; other parameters have the declared
    defaults.
    """
    head = struct.pack("<HBBII", _MAGIC, _FORMAT, len(PARAMS), PARAMS_HASH, 1)
    entries = (struct.pack("<Hf", spec.id, values.get(spec.name, spec.default)) for spec in PARAMS)
    page = (head + b"".join(entries)).ljust(_SET_BYTES - 4, b"\xff")
    page += struct.pack("<I", zlib.crc32(page))
    return (page + page).ljust(_FLASH_BYTES, b"\xff")
