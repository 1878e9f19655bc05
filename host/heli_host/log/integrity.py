"""What a log carries so that its reader can tell whether it is what was written.

Chunks and the index have CRCs by the format. MCAP has one over everything before the index too, but only a
log that was closed gets that far. So each metadata record carries a CRC of its own, and the first of them,
`HEAD`, one of the schemas and channels before it.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping

HEAD = "head"
"""Name of the metadata record that vouches for what stands before it."""
RECORD_CRC = "(crc32)"
"""Key of a metadata record's own CRC; in brackets, because plans stand under names that users chose."""


def metadata_crc(name: str, values: Mapping[str, str]) -> str:
    """Return the CRC-32 of a metadata record, in hexadecimal digits.

    It is taken of the name, then of every key and value in the order of the keys, each as a 32-bit length and
    UTF-8: a tool that copies a log may change the order.

    Parameters
    ----------
    name : str
        Name of the record.
    values : Mapping of str to str
        Its content; a CRC among it does not count.
    """
    crc = _add(0, name)
    for key in sorted(values):
        if key != RECORD_CRC:
            crc = _add(_add(crc, key), values[key])
    return f"{crc:08x}"


def head_values(head: bytes) -> dict[str, str]:
    """Return the content of the record `HEAD`.

    Parameters
    ----------
    head : bytes
        All bytes of the file before that record.
    """
    return {"crc32": f"{zlib.crc32(head):08x}", "bytes": str(len(head))}


def _add(crc: int, text: str) -> int:
    data = text.encode("utf-8", errors="surrogatepass")
    return zlib.crc32(data, zlib.crc32(struct.pack("<I", len(data)), crc))
