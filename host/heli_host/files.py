"""Reading of files from other people, within bounds, and strings for files of our own.

The functions refuse pipes, files above a given size, and TOML that would exhaust the parser.
"""

from __future__ import annotations

import codecs
import errno
import hashlib
import os
import re
import stat
import tomllib
from pathlib import Path
from typing import Any, Final

RESULT_SCHEMA: Final = 1
"""Number of the layout of results as JSON; it grows when a key is renamed or removed."""
LOG_WRITER: Final = "heli_host (link"
"""Begin of the library's name in the header of a log; a ROS 2 export names ``heli_host`` alone."""
TOML_BYTES = 1 << 20
"""A plan with a thousand segments has 100 kB."""

_MAX_WHOLE = 2**63
_TOO_MANY_DIGITS = "it has a whole number of more than 64 bits"
# The parser's time grows with the square of a dotted key's parts: 200,000 of them took it over five minutes.
_LONG_KEY = re.compile(r"""(?<![\w-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){50}""")


def read_file(path: Path, most_bytes: int) -> bytes:
    """Read a whole file."""
    # Without O_NONBLOCK, opening a pipe waits for its writer.
    opened = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    with os.fdopen(opened, "rb") as file:
        status = os.fstat(file.fileno())
        if stat.S_ISDIR(status.st_mode):
            raise OSError(errno.EISDIR, os.strerror(errno.EISDIR))
        if not stat.S_ISREG(status.st_mode):
            raise OSError(errno.EINVAL, "it is a pipe or a device, not a file")
        if status.st_size > most_bytes:
            raise OSError(errno.EFBIG, f"it has more than {most_bytes >> 20} MiB")
        # No more than this: Python sets aside as much memory as a read may need.
        return file.read(status.st_size)


def file_digest(path: Path) -> str:
    """Return the SHA-256 digest of the bytes of a file, in hexadecimal digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def decode_text(content: bytes) -> str:
    """Return the text of a file that a user may have written with any editor.

    A byte order mark, as some editors of Windows write it, is left out. A text in UTF-16 begins with one.
    """
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return content.decode("utf-16")
    return content.decode("utf-8-sig")


def parse_toml(text: str) -> dict[str, Any]:
    """Parse TOML, and refuse whole numbers of more than 64 bits and deep nesting."""
    if _LONG_KEY.search(text):
        raise ValueError("it is nested too deeply")
    try:
        content = tomllib.loads(text)
        _refuse_long_integers(content)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    except tomllib.TOMLDecodeError:
        raise
    except ValueError:
        raise ValueError(_TOO_MANY_DIGITS) from None
    return content


def toml_string(text: str) -> str:
    """Return a text as a string of TOML, with its quotation marks, such that `parse_toml` reads it back.

    Characters that are not printable are escaped, because they may control a terminal that shows the file.
    """
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(c if c.isprintable() else f"\\U{ord(c):08x}" for c in escaped) + '"'


def _refuse_long_integers(value: object) -> None:
    """Refuse whole numbers anywhere in a value that have too many digits for a float."""
    if isinstance(value, dict):
        for element in value.values():
            _refuse_long_integers(element)
    elif isinstance(value, list):
        for element in value:
            _refuse_long_integers(element)
    elif isinstance(value, int) and not -_MAX_WHOLE <= value < _MAX_WHOLE:
        raise ValueError(_TOO_MANY_DIGITS)
