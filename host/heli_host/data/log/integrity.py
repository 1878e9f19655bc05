"""Checksums of a log, by which its reader detects changed bytes.

The MCAP format has CRCs for chunks and for the index. It also has a CRC over everything before the index, but
only a closed log contains it. Therefore each metadata record has a separate CRC. The first metadata record,
`HEAD`, also has a CRC of the schemas and channels before it.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping

HEAD = "head"
"""Name of the metadata record with the CRC of all bytes before it."""
RECORD_CRC = "(crc32)"
"""Key of a metadata record's own CRC; in brackets, because names of plans are keys too."""


def metadata_crc(name: str, values: Mapping[str, str]) -> str:
    """Return the CRC-32 of a metadata record, in hexadecimal digits.

    The CRC covers the name, then every key and value, each as a 32-bit length and UTF-8. The keys are sorted,
    because a tool that copies a log may change their order.
    """
    crc = _crc_after_text(0, name)
    for key in sorted(values):
        if key != RECORD_CRC:
            crc = _crc_after_text(_crc_after_text(crc, key), values[key])
    return f"{crc:08x}"


def head_values(head: bytes) -> dict[str, str]:
    """Return the content of the record `HEAD`."""
    return {"crc32": f"{zlib.crc32(head):08x}", "bytes": str(len(head))}


def _crc_after_text(crc: int, text: str) -> int:
    """Return a CRC after the length and the bytes of a text."""
    encoded = text.encode("utf-8", errors="surrogatepass")
    return zlib.crc32(encoded, zlib.crc32(struct.pack("<I", len(encoded)), crc))
