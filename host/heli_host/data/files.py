"""Files and programs of other people within bounds, and files of our own: complete or not at all.

Reading refuses pipes, files above a given size, and TOML that would exhaust the parser. Writing replaces a
file only if the program itself wrote it, or with ``--force``. The program recognises its files by their
content. A text that people may edit ends with a line that holds the digest of the text before it: an edited
file is not the program's file any more.
"""

from __future__ import annotations

import codecs
import contextlib
import errno
import gzip
import hashlib
import json
import math
import os
import re
import secrets
import stat
import sys
import tomllib
from collections.abc import Iterator
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from heli_host.errors import HeliError

if TYPE_CHECKING:
    from matplotlib.figure import Figure


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
    """Return the text of a file that a user may have written with any editor."""
    # A byte order mark, as some editors of Windows write it, is left out. A text in UTF-16 begins with one.
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
    """Return a text as a string of TOML, with its quotation marks, such that `parse_toml` reads it back."""
    # Characters that are not printable are escaped, because they may control a terminal that shows the file.
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


WRITER: Final = "written by heli-host"
"""Text by which the program recognises its figures and tables."""
FORCE: Final[ContextVar[bool]] = ContextVar("force", default=False)
"""Whether any file may be replaced; `heli_host.ui.cli.entry` runs each command line in a separate context."""

_HEAD_BYTES: Final = 8192
_TAIL_BYTES: Final = 1 << 18
_LONGEST_TEXT_BYTES: Final = 1 << 26
_DIGEST_LINE_BYTES: Final = 200
"""More than a last line with a digest takes."""
_DIGEST_LINE: Final = re.compile(rb"[^\n]*\bwritten by heli-host, digest ([0-9a-f]{16})\b[^\n]*\n?\Z")
_JSON_HEAD: Final = re.compile(rb'\{\s*"schema":\s*\d+\s*,')
_COMMENTS: Final = {".c": ("// ", ""), **dict.fromkeys((".xml", ".html", ".md"), ("<!-- ", " -->"))}
_FIGURE_KEYS: Final = {".png": "Software", ".pdf": "Creator", ".svg": "Creator"}
_TABLE_HEADS: Final = (b"t_s,front_V,back_V,elevation_rad,", b"submission,points,of,")
"""Begins of the first line of tables, after lines of notes."""
_NOTES: Final = ".notes.txt"
_NOTE_LINE: Final = re.compile(rb"[\w .-]+: ")


class ForeignFile(HeliError):
    """A file that the program did not write is in the place of a result; it was not changed."""

    exit_code = 5


def check_replaceable(path: str | Path) -> None:
    """Check that a file may be written: there is none, the program itself wrote it, or ``--force`` was
    given.
    """
    path = Path(path)
    try:
        is_foreign = path.is_file() and not FORCE.get() and not is_own_file(path)
    except OSError as error:
        raise ForeignFile(f"cannot read {path}: {error.strerror or error}", "give another name") from error
    if is_foreign:
        raise ForeignFile(
            f"{path} exists, and heli-host did not write it, or it was edited since",
            "give another name, or replace it with --force",
        )


def is_own_file(path: Path) -> bool:
    """Return whether the program wrote a file, and, if it is a text for editing, it is unchanged."""
    size = path.stat().st_size
    if size == 0:
        return True  # nothing is lost
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
        file.seek(max(0, size - _TAIL_BYTES))
        tail = file.read()
        has_digest = b"written by heli-host, digest " in tail[-_DIGEST_LINE_BYTES:]
        if has_digest and size <= _LONGEST_TEXT_BYTES:
            file.seek(0)
            return _has_own_digest(file.read())
    if head.startswith(b"\x1f\x8b"):  # gzip
        head = _unpacked_head(path)
    # Otherwise each kind of file names its writer in another place.
    if head.startswith((b"\x89PNG", b"%PDF", b"<?xml", b"PAR1", b"PK")):
        return WRITER.encode() in head or WRITER.encode() in tail
    if head.startswith(b"\x89MCAP0"):
        return b"heli_host" in head[:200]
    if head.startswith(b"MATLAB 5.0"):
        return b"written by heli_host" in head[:116]  # the format's field for a text
    if path.name.endswith(_NOTES):
        return bool(_NOTE_LINE.match(head))
    if path.suffix == ".ipynb":
        return _is_own_notebook(path)
    lines = [line for line in head.splitlines() if not line.startswith(b"#")]
    is_table = bool(lines) and lines[0].startswith(_TABLE_HEADS)
    return is_table or bool(_JSON_HEAD.match(head))


@contextlib.contextmanager
def replacing(path: str | Path, *, force: bool = False) -> Iterator[Path]:
    """Write a file next to its place, and move it there when the ``with`` block has ended without an
    error.
    """
    # A full disk, an interrupt or any other error leaves the place as it was.
    path = Path(path)
    if not force:
        check_replaceable(path)
    # A link stays a link: its file is replaced.
    target = Path(os.path.realpath(path))
    if target.exists() and not target.is_file():
        # Such as /dev/null, or a folder, for which the writer gives the reason.
        yield target
        return
    unfinished = target.with_name(f".{secrets.token_hex(4)}.{target.name}")
    try:
        yield unfinished
        if target.exists():
            unfinished.chmod(stat.S_IMODE(target.stat().st_mode))
        unfinished.replace(target)
    finally:
        unfinished.unlink(missing_ok=True)


def write_bytes(path: str | Path, content: bytes, *, force: bool = False) -> None:
    """Write a file as `replacing` does."""
    with replacing(path, force=force) as unfinished:
        unfinished.write_bytes(content)


def write_text(path: str | Path, text: str) -> None:
    """Write a text without a digest, which the program recognises by its first line, as `replacing` does."""
    write_bytes(path, text.encode())


def write_signed(path: str | Path, text: str) -> None:
    """Write a text that people may edit, and a last line with its digest, as `replacing` does."""
    write_bytes(path, signed(text, Path(path).suffix).encode())


def signed(text: str, suffix: str) -> str:
    """Return a text with a last line that holds the digest of the text."""
    begin, end = _COMMENTS.get(suffix.lower(), ("# ", ""))
    text = text if text.endswith("\n") else text + "\n"
    return f"{text}{begin}{WRITER}, digest {_digest(text.encode())}{end}\n"


def save_figure(figure: Figure, path: str | Path, **options: Any) -> None:
    """Save a figure as `replacing` does, with the text by which the program recognises it."""
    with replacing(path) as unfinished:
        figure.savefig(unfinished, metadata=figure_metadata(Path(path).suffix), **options)


def figure_metadata(suffix: str) -> dict[str, str] | None:
    """Return the metadata of a figure's file; None for an ending that is no figure's."""
    key = _FIGURE_KEYS.get(suffix.lower())
    return {key: WRITER} if key is not None else None


def notebook_digest(cells: Any) -> str:
    """Return the digest of the sources of a notebook's cells, without outputs and numbers."""
    sources = [[cell["cell_type"], "".join(cell["source"])] for cell in cells]
    return _digest(json.dumps(sources).encode())


def _is_own_notebook(path: Path) -> bool:
    try:
        content = json.loads(path.read_bytes())
        return bool(content["metadata"]["heli_host"]["digest"] == notebook_digest(content["cells"]))
    except (ValueError, KeyError, TypeError, RecursionError):
        return False


def _has_own_digest(content: bytes) -> bool:
    # Only the last line is searched: before it, a page has lines of a megabyte, which took seconds.
    start = content.rfind(b"\n", 0, len(content) - 1) + 1
    line = _DIGEST_LINE.match(content, start)
    return line is not None and line[1].decode() == _digest(content[: line.start()])


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]


def _unpacked_head(path: Path) -> bytes:
    try:
        with gzip.open(path) as file:
            return file.read(_HEAD_BYTES)
    except (OSError, EOFError):
        return b""


def can_limit() -> bool:
    """Whether this system can limit processes; Windows cannot."""
    try:
        import resource  # noqa: F401 - whether it exists is the question
    except ImportError:
        return False
    return True


def limit_process(kind: str, soft: int, hard: int | None = None) -> None:
    """Set a limit of this process, as far as its present hard limit permits."""
    # If the system does not have this limit, nothing changes: Windows has no such limits, and macOS does not
    # limit the address space.
    if sys.platform == "win32" or not can_limit():
        return
    import resource

    def lowest(*limits: int) -> int:
        return min(limits, key=lambda limit: math.inf if limit == resource.RLIM_INFINITY else limit)

    with contextlib.suppress(AttributeError, OSError, ValueError):
        number = getattr(resource, f"RLIMIT_{kind}")
        hard_limit = resource.getrlimit(number)[1]
        hard = hard_limit if hard is None else lowest(hard, hard_limit)
        resource.setrlimit(number, (lowest(soft, hard), hard))
