"""Tables of text, in the dialects that programs and countries write them."""

from __future__ import annotations

import csv
import gzip
import io
import itertools
import re
import statistics
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from heli_host.errors import FlightDataError, file_remedy
from heli_host.files import read_file
from heli_host.tables.clocks import seconds_of
from heli_host.tables.limits import MAX_BYTES, MAX_ROWS, check_columns, too_large
from heli_host.tables.table import Column, Table
from heli_host.tables.units import unit_of

_MAX_LINE_CHARACTERS: Final = 1 << 16
"""Longest line: a thousand columns have 20 thousand characters."""
_LINE_ENDS: Final = tuple(bytes([code]) for code in b"\n\x0b\x0c\x1c\x1d\x1e\x85\xa8\xa9")
"""Bytes in which the ends of a line end, those of Unicode too; a return counts by itself."""
_COMMENTS: Final = ("#", "%", "//", '"#')
_SEPARATORS: Final = (";", "\t", ",", "|", " ")
_LOOKED_AT: Final = 60
"""Number of lines from which the dialect is determined."""
_EMPTY: Final = frozenset({"", "nan", "na", "n/a", "null", "none", "-nan", "inf", "-inf", "#n/a"})
_HIGH_BYTES: Final = re.compile(rb"[\x80-\xff]+")
_ENCODING_BYTES: Final = 1 << 16
"""Number of bytes, such as a header, from which the encoding is determined."""
_NUMBER: Final = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eEdD][-+]?\d+)?$")


@dataclass(frozen=True)
class Dialect:
    """How a table of text is written: the `separator` of columns, and the `decimal` mark of numbers."""

    separator: str
    decimal: str


def read_text(path: Path) -> Table:
    """Read a table of text at `path`: any usual separator, points or commas in numbers, names and units in a
    header or none, comments, gzip.

    Raises
    ------
    FlightDataError
        If it cannot be read, or holds no table of numbers.
    """
    import pandas

    lines = _lines(path)
    notes = "\n".join(line.strip().lstrip("#%/ ") for line in lines if line.strip().startswith(_COMMENTS))
    body = [line for line in lines if line.strip() and not line.strip().startswith(_COMMENTS)]
    if not body:
        raise FlightDataError(f"{path}: the file is empty", "record a flight into it first")
    # A flight begins at rest, with whole numbers that tell no decimal mark: rows of all of it are looked at.
    spread = body[:: max(1, len(body) // _LOOKED_AT)]
    dialect = find_dialect([*body[:_LOOKED_AT], *spread])
    if dialect is None:
        raise FlightDataError(
            f"{path}: the file has no columns of numbers",
            "give a table with one row per sample, separated by , ; or tabs",
        )
    start = _first_row(body[:_LOOKED_AT], dialect, spread)
    header, rows = body[:start], body[start:]
    if not rows:
        raise FlightDataError(
            f"{path}: the file has no row of numbers",
            "give a table with one row per sample, separated by , ; or tabs",
        )
    width = len(_cells(rows[0], dialect))
    check_columns(path, width)
    names, units = _names(header, dialect, width)
    try:
        frame = pandas.read_csv(
            io.StringIO("\n".join(rows)),
            sep=r"\s+" if dialect.separator == " " else dialect.separator,
            decimal=dialect.decimal,
            header=None,
            names=range(width),
            usecols=range(width),
            on_bad_lines="skip",
            low_memory=False,
            skipinitialspace=True,
        )
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise FlightDataError(f"{path}: not a table ({reason})", "check its quotes and separators") from error
    columns = {}
    for index, name in enumerate(names):
        values = pandas.to_numeric(frame[index], errors="coerce").to_numpy(np.float64)
        at_s = None if np.isfinite(values).mean() > 0.5 else seconds_of(frame[index])
        if at_s is not None:
            columns[name] = Column(at_s, "s")
        elif np.isfinite(values).any():
            columns[name] = Column(values, units[index])
    if not columns:
        raise FlightDataError(
            f"{path}: the file has no columns of numbers", "give a table with one row per sample"
        )
    return Table(str(path), columns, notes, bool(header))


def find_dialect(lines: list[str]) -> Dialect | None:
    """Find the dialect in which `lines` have most numbers, all of one length; None where no line has two."""
    best, best_rank = None, (0.0, 0)
    for separator, decimal in itertools.product(_SEPARATORS, ".,"):
        if separator == decimal:
            continue
        dialect = Dialect(separator, decimal)
        cells = [_cells(line, dialect) for line in lines]
        width = statistics.mode(map(len, cells))
        if width < 2:
            continue
        shares = [
            sum(_is_number(cell, dialect) for cell in row) / width for row in cells if len(row) == width
        ]
        good = sum(shares) / len(cells)
        if (good, width) > best_rank:
            best, best_rank = dialect, (good, width)
    return best


def _lines(path: Path) -> list[str]:
    lines = _text(path).splitlines()
    if max(map(len, lines), default=0) > _MAX_LINE_CHARACTERS:
        raise FlightDataError(
            f"{path}: a line has more than {_MAX_LINE_CHARACTERS} characters", "give one row per line"
        )
    return lines


def _text(path: Path) -> str:
    """Return the text of a file, unpacked if its name ends in .gz, by the encoding that its bytes suggest."""
    try:
        data = read_file(path, MAX_BYTES)
        if path.name.lower().endswith(".gz"):
            with gzip.GzipFile(fileobj=io.BytesIO(data)) as packed:
                data = packed.read(MAX_BYTES + 1)
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise FlightDataError(f"{path}: not a gzip file, or damaged", "copy it again") from error
    except OSError as error:
        raise FlightDataError(f"cannot read {path}: {error.strerror or error}", file_remedy(error)) from error
    if len(data) > MAX_BYTES:
        raise too_large(path, f"{MAX_BYTES >> 20} MiB")
    if max(data.count(b"\r"), sum(data.count(line_end) for line_end in _LINE_ENDS)) > MAX_ROWS:
        raise too_large(path, f"{MAX_ROWS // 1_000_000} million lines")
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return data.decode("utf-16", errors="replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        # Chinese characters are pairs of high bytes; a western letter with an accent is a single one.
        paired = all(len(run) % 2 == 0 for run in _HIGH_BYTES.findall(data[:_ENCODING_BYTES]))
        return data.decode("gb18030" if paired else "latin-1", errors="replace")


def _cells(line: str, dialect: Dialect) -> list[str]:
    if dialect.separator == " ":
        return line.split()
    cells = next(csv.reader([line.strip(" \r\n")], delimiter=dialect.separator, skipinitialspace=True), [])
    # A separator at the end of each line makes no column.
    return cells[:-1] if cells and not cells[-1].strip() else cells


def _first_row(lines: list[str], dialect: Dialect, spread: list[str]) -> int:
    """Find the first row of numbers: it is as wide as most, at least half of its cells are numbers, and no
    row of names follows, as in LabVIEW's headers, which contain numbers too.
    """
    width = statistics.mode(len(_cells(line, dialect)) for line in spread)
    cells = [_cells(line, dialect) for line in lines]
    numbers = [sum(_is_number(cell, dialect) for cell in row) for row in cells]
    named = [
        index
        for index, row in enumerate(cells)
        if len(row) >= width and not numbers[index] and all(cell.strip() for cell in row[:width])
    ]
    start = max(named, default=-1) + 1
    for index in range(start, len(lines)):
        if len(cells[index]) >= width and 2 * numbers[index] >= max(len(cells[index]), 1):
            return index
    return len(lines)


def _is_number(cell: str, dialect: Dialect) -> bool:
    text = cell.strip()
    if dialect.decimal != ".":
        if "." in text:
            return False
        text = text.replace(dialect.decimal, ".")
    return bool(_NUMBER.match(text)) or text.lower() in _EMPTY - {""}


def _names(header: list[str], dialect: Dialect, width: int) -> tuple[list[str], list[str]]:
    """Column names, made different where they are not, and units, from a row of their own where there is
    one.
    """
    rows = [_cells(line, dialect) for line in header]
    # LabVIEW names a column of comments that no row has.
    rows = [row[:width] for row in rows if len(row) in {width, width + 1}]
    units = [""] * width
    if len(rows) > 1 and sum(bool(_stated(cell)) for cell in rows[-1]) >= max(1, width // 2):
        units = [_stated(cell) for cell in rows[-1]]
        rows = rows[:-1]
    raw = [cell.strip() for cell in rows[-1]] if rows else [f"column {i + 1}" for i in range(width)]
    names: list[str] = []
    for index, name in enumerate(raw):
        wanted = name or f"column {index + 1}"
        while wanted in names:
            wanted += "'"
        names.append(wanted)
    return names, units


def _stated(cell: str) -> str:
    return unit_of(cell.strip().strip("[]()"))
