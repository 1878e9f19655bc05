"""Flights as tables, .csv or .csv.gz, written and read; flights for MATLAB and as Parquet."""

from __future__ import annotations

import codecs
import difflib
import gzip
import io
import re
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from heli_host.data.files import WRITER, read_file, replacing, write_bytes, write_text
from heli_host.data.flight import (
    OWN_COLUMNS,
    REQUIRED_COLUMNS,
    SETPOINT_COLUMNS,
    STATUS_COLUMNS,
    Flight,
    FlightEvent,
    check_flight,
)
from heli_host.declaration import CHANNELS
from heli_host.errors import FlightDataError, LogWriteError, file_remedy, install_remedy

_FORMATS = {"t_s": "%.6f", "front_V": "%.6f", "back_V": "%.6f"} | dict.fromkeys(STATUS_COLUMNS, "%d")
# Ten digits distinguish all numbers of 32 bits at any scale.
_FORMATS |= {spec.column: "%.10g" for spec in CHANNELS if spec.column not in OWN_COLUMNS}
_FORMATS |= {spec.field: "%d" for spec in CHANNELS if spec.axis is not None}
_NUMBER_FORMAT = "%.9f"
_NOTE = re.compile(r"([\w .-]{1,40}):\s?(.*)")
_BLANK_LINE = re.compile(rb"\n(?:[^\S\n]*\n|[^\S\n]+\Z)")
_PLAN_MARK = "plan|"
_ROWS_A_BLOCK = 20_000
MAX_TABLE_BYTES = 1 << 28
"""Largest table, unpacked: half an hour at 1 kHz."""
MAX_NOTES_BYTES = 1 << 24
"""Largest file of notes: 4000 times the notes of a flight with ten events."""
MAX_LINES = 4_000_000
MAX_TABLE_COLUMNS = 1000


@dataclass(frozen=True)
class _Lines:
    """A table's text, taken apart: notes, column names, and the lines of numbers with their place in the
    file.
    """

    notes: tuple[str, ...]
    names: tuple[str, ...]
    body: bytes
    first_line: int
    skipped_lines: tuple[int, ...]

    def line_of(self, row: int) -> int:
        """Line of the file, counted from 1, that holds a row counted from 0."""
        line = self.first_line + row
        for skipped_line in self.skipped_lines:
            if skipped_line <= line:
                line += 1
        return line

    def where(self, row: int) -> str:
        return f"line {self.line_of(row)}"


def read_csv(path: Path, *, allow_gaps: bool = False) -> Flight:
    """Read a flight from a table."""
    lines = _split_lines(_read_bytes(path), path)
    _check_names(lines.names, path)
    numbers, names = _read_numbers(lines, path)
    columns = dict(zip(names, numbers.T, strict=True))
    flight = _flight_of_columns(columns, (*lines.notes, *_read_notes(notes_path(path))))
    check_flight(flight, str(path), allow_gaps=allow_gaps, where=lines.where)
    return flight


def notes_path(table: Path) -> Path:
    """Return the path of a table's notes, such as ``flight.csv.notes.txt``."""
    return table.with_name(table.name + ".notes.txt")


def write_csv(flight: Flight, path: str | Path, *, notes_inside: bool = False) -> int:
    """Write a flight as a table, and its notes next to it."""
    path = Path(path)
    columns = flight.columns()
    row_format = ",".join(_FORMATS.get(name, _NUMBER_FORMAT) for name in columns) + "\n"
    notes = _note_lines(flight)
    comment_lines = [f"# {line}" for line in notes] if notes_inside else []
    table = np.column_stack([column.astype(np.float64) for column in columns.values()])
    try:
        with replacing(path) as unfinished, unfinished.open("wb") as file:
            if path.name.lower().endswith(".gz"):
                # Without name and date in its header, the same flight compresses to the same bytes.
                with gzip.GzipFile(filename="", mode="wb", compresslevel=6, fileobj=file, mtime=0) as packed:
                    _write_rows(packed, comment_lines, list(columns), row_format, table)
                    size = packed.tell()
            else:
                _write_rows(file, comment_lines, list(columns), row_format, table)
                size = file.tell()
        notes_file = notes_path(path)
        if not path.is_file():
            # A device, such as /dev/null, has no file next to it.
            return size
        if notes and not notes_inside:
            write_text(notes_file, "".join(line + "\n" for line in notes))
        else:
            # The notes of an older table would describe another flight.
            notes_file.unlink(missing_ok=True)
        return size
    except OSError as error:
        raise LogWriteError(
            f"cannot write {path}: {error.strerror or error}", "choose another folder"
        ) from error


def _note_lines(flight: Flight) -> list[str]:
    notes = [f"{name}: {_one_line(value)}" for name, value in flight.meta.items()]
    notes += [f"parameter.{name}: {value!r}" for name, value in flight.parameters.items()]
    notes += [f"state.{number}: {name}" for number, name in flight.state_names.items()]
    notes += [f"fault.{number}: {name}" for number, name in flight.fault_names.items()]
    notes += [f"{_PLAN_MARK}{line}" for line in flight.plan.splitlines()]
    return notes + [f"event.{event.name}: {event.t_s:.6f} {_one_line(event.text)}" for event in flight.events]


def _read_notes(path: Path) -> list[str]:
    """Return the lines of a table's notes; none without such a file."""
    try:
        data = read_file(path, MAX_NOTES_BYTES)
    except FileNotFoundError:
        return []
    except OSError as error:
        raise FlightDataError(f"cannot read {path}: {error.strerror or error}", file_remedy(error)) from error
    lines = data.decode("utf-8-sig", errors="replace").splitlines()
    return [line for line in lines if line.strip()]


def _write_rows(
    file: Any, notes: Sequence[str], names: Sequence[str], row_format: str, table: NDArray[np.float64]
) -> None:
    """Write notes, names and rows, many rows per call for speed."""
    file.write("".join(line + "\n" for line in (*notes, ",".join(names))).encode())
    for start in range(0, len(table), _ROWS_A_BLOCK):
        block = table[start : start + _ROWS_A_BLOCK]
        file.write(((row_format * len(block)) % tuple(block.ravel().tolist())).encode())


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _read_bytes(path: Path) -> bytes:
    """Return the content of a CSV file, unpacked if its name ends in .gz."""
    try:
        data = read_file(path, MAX_TABLE_BYTES)
    except OSError as error:
        raise FlightDataError(f"cannot read {path}: {error.strerror or error}", file_remedy(error)) from error
    if not path.name.lower().endswith(".gz"):
        return data
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(data)) as packed:
            data = packed.read(MAX_TABLE_BYTES + 1)  # a byte more shows that there are too many
    except EOFError as error:
        raise FlightDataError(
            f"{path}: the compressed file ends early", "copy or download it again"
        ) from error
    except (OSError, zlib.error) as error:
        raise FlightDataError(
            f"{path}: not a gzip file, or damaged", "copy it again, or name it .csv if it is plain text"
        ) from error
    if len(data) > MAX_TABLE_BYTES:
        raise FlightDataError(
            f"{path} unpacks to more than {MAX_TABLE_BYTES >> 20} MiB", "cut it into pieces"
        )
    return data


def _split_lines(data: bytes, path: Path) -> _Lines:
    """Split a CSV file into notes (lines that begin with #), column names and rows of text."""
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        data = data.decode("utf-16", errors="replace").encode()
    data = data.removeprefix(codecs.BOM_UTF8).replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if not data.strip():
        raise FlightDataError(f"{path}: the file is empty", "record a flight into it first")
    if data.count(b"\n") > MAX_LINES:
        raise FlightDataError(f"{path} has more than {MAX_LINES} lines", "cut it into pieces")
    notes: list[str] = []
    header, position, lines_read = "", 0, 0
    while position < len(data):
        end = data.find(b"\n", position)
        end = len(data) if end < 0 else end
        line = data[position:end].decode("utf-8", errors="replace").strip()
        position, lines_read = end + 1, lines_read + 1
        if line.startswith("#"):
            notes.append(line[1:].removeprefix(" "))
        elif line:
            header = line
            break
    body = data[position:]
    if header.count(",") >= MAX_TABLE_COLUMNS:
        raise FlightDataError(
            f"{path} has more than {MAX_TABLE_COLUMNS} columns", "remove columns that are not needed"
        )
    names = tuple(name.strip().strip('"') for name in header.split(","))
    first_line = lines_read + 1
    # Nearly all tables have rows only, which need not be split here. The search begins at the end of the
    # header, because the first line below it may be blank, too.
    if b"#" not in body and not _BLANK_LINE.search(data, position - 1):
        return _Lines(tuple(notes), names, body, first_line, skipped_lines=())
    row_lines: list[bytes] = []
    skipped_lines: list[int] = []
    for number, line_bytes in enumerate(body.split(b"\n"), first_line):
        stripped = line_bytes.strip()
        if stripped and not stripped.startswith(b"#"):
            row_lines.append(line_bytes)
            continue
        skipped_lines.append(number)
        if stripped:
            notes.append(stripped[1:].decode("utf-8", errors="replace").strip())
    return _Lines(tuple(notes), names, b"\n".join(row_lines), first_line, tuple(skipped_lines))


def _check_names(names: tuple[str, ...], path: Path) -> None:
    """Raise a FlightDataError for a missing or repeated column."""
    missing = [name for name in REQUIRED_COLUMNS if name not in names]
    if missing:
        raise FlightDataError(f"{path}: column {missing[0]} is missing", _missing_remedy(missing[0], names))
    doubled = next((name for name in names if names.count(name) > 1), None)
    if doubled is not None:
        raise FlightDataError(f"{path}: column {doubled!r} exists twice", "rename or remove one of them")


def _missing_remedy(missing: str, names: tuple[str, ...]) -> str:
    """Suggest a fix for a `missing` column by the columns that exist, the most probable mistake first."""
    if len(names) == 1:
        separator = next((mark for mark in ";\t" if mark in names[0]), None)
        if separator is not None:
            return "separate the columns by commas"
    degrees = missing.replace("_rad", "_deg")
    if degrees != missing and degrees in names:
        return f"convert {degrees} to radians and name it {missing}"
    if all(_is_number(name) for name in names):
        return f"put a first line with the column names: {','.join(REQUIRED_COLUMNS)}"
    close = difflib.get_close_matches(missing, names, n=1, cutoff=0.5)
    if close:
        return f"rename {close[0]!r} if that is it, and mind the unit"
    return (
        f"it has {', '.join(names[:8])}; a flight needs {', '.join(REQUIRED_COLUMNS)}; heli-host import "
        "converts logs of other programs"
    )


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _read_numbers(lines: _Lines, path: Path) -> tuple[NDArray[np.float64], tuple[str, ...]]:
    """Parse the rows of a table; return the numbers and the names of their columns. A column that is not one
    of a flight and contains text is left out.
    """
    if not lines.body.strip():
        raise FlightDataError(f"{path}: no rows below the column names", "record a flight into it first")
    numeric_columns = list(range(len(lines.names)))
    # Parsed again without each column that turns out to be text.
    while True:
        names = tuple(lines.names[column] for column in numeric_columns)
        try:
            return _parse_columns(lines.body, len(lines.names), numeric_columns), names
        except ValueError as error:
            bad = _find_bad_cell(lines, numeric_columns)
            if bad is None:
                raise FlightDataError(f"{path}: {error}", "correct the table") from error
            line = lines.where(bad.row)
            if bad.column is None:  # the row has another number of columns
                raise FlightDataError(
                    f"{path}: {line} has {bad.text} columns, the header {len(lines.names)}",
                    "complete or remove that line",
                ) from error
            name = lines.names[bad.column]
            if name not in OWN_COLUMNS:
                numeric_columns.remove(bad.column)
                continue
            if bad.text == name:
                raise FlightDataError(
                    f"{path} holds two tables that were joined: {line} repeats the names of the columns",
                    "give each table as a file of its own",
                ) from error
            raise FlightDataError(
                f"{path}: {name} is {bad.text!r} in {line}, not a number", "correct or remove that line"
            ) from error


def _parse_columns(body: bytes, width: int, keep: list[int]) -> NDArray[np.float64]:
    """Parse the columns `keep` of a table of `width` columns, shape (n, len(keep))."""
    usecols = None if len(keep) == width else keep
    table = np.loadtxt(
        io.BytesIO(body), delimiter=",", comments=None, ndmin=2, usecols=usecols, encoding="latin-1"
    )
    if table.shape[1] != len(keep):
        raise ValueError("the rows have another number of columns than the header")
    return np.asarray(table, np.float64)


class _BadCell(NamedTuple):
    """A cell that is not a number, or a row with a wrong number of cells."""

    row: int
    column: int | None  # None for such a row
    text: str  # Text of the cell, or the number of cells of the row


def _find_bad_cell(lines: _Lines, keep: list[int]) -> _BadCell | None:
    """Find the first bad cell of a table in the columns `keep`."""
    for row, line_bytes in enumerate(lines.body.split(b"\n")):
        if not line_bytes.strip():
            continue
        if line_bytes.count(b",") + 1 != len(lines.names):
            return _BadCell(row, None, str(line_bytes.count(b",") + 1))
        cells = line_bytes.decode("latin-1").split(",")
        for column in keep:
            if not _is_number(cells[column]):
                return _BadCell(row, column, cells[column].strip()[:40])
    return None


def _flight_of_columns(columns: dict[str, NDArray[np.float64]], notes: tuple[str, ...]) -> Flight:
    """Build a flight from columns and notes, which contain parameters, names of states, events and plan."""
    attributes: dict[str, Any] = {
        name: np.ascontiguousarray(columns[name])
        for name in REQUIRED_COLUMNS + SETPOINT_COLUMNS
        if name in columns
    }
    extra: dict[str, NDArray[np.float64]] = {}
    for name, column in columns.items():
        if name in STATUS_COLUMNS and _fits_a_byte(column):
            attributes[name] = column.astype(np.uint8)
        elif name not in attributes:
            extra[name] = np.ascontiguousarray(column)
    return Flight(**attributes, extra=extra, **_attributes_of_notes(notes))


def _attributes_of_notes(notes: tuple[str, ...]) -> dict[str, Any]:
    """Return the attributes of a flight that its notes contain. Notes in no known form are in `meta`."""
    meta: dict[str, str] = {}
    other_notes: list[str] = []
    plan: list[str] = []
    parameters: dict[str, float] = {}
    events: list[FlightEvent] = []
    names: dict[str, dict[int, str]] = {"state": {}, "fault": {}}
    for note in notes:
        if note.startswith(_PLAN_MARK):
            plan.append(note.removeprefix(_PLAN_MARK))
            continue
        match = _NOTE.fullmatch(note)
        if match is None:
            other_notes.append(note)
            continue
        key, value = match.groups()
        prefix, _, name = key.partition(".")
        if prefix == "parameter" and name and _is_number(value):
            parameters[name] = float(value)
        elif prefix in names and name.isascii() and name.isdigit():
            names[prefix][int(name)] = value
        elif prefix == "event" and name and _is_number(value.partition(" ")[0]):
            time_text, _, text = value.partition(" ")
            events.append(FlightEvent(float(time_text), name, text))
        elif key in meta:
            other_notes.append(note)  # the first note of a name gives the value
        else:
            meta[key] = value
    if other_notes:
        meta["notes"] = "\n".join(other_notes)
    return {
        "state_names": names["state"],
        "fault_names": names["fault"],
        "events": tuple(events),
        "parameters": parameters,
        "plan": "\n".join(plan) + "\n" if plan else "",
        "meta": meta,
    }


def _fits_a_byte(column: NDArray[np.float64]) -> bool:
    return bool(np.all((column >= 0) & (column <= 255) & (column == np.floor(column))))


def export_mat(flight: Flight, path: str | Path) -> None:
    """Write a MATLAB file (version 5): a column vector per column, a struct of parameters, plan and notes."""
    from scipy.io import savemat

    content: dict[str, object] = {
        name: column.astype(np.float64) for name, column in flight.columns().items() if len(name) <= _MAT_NAME
    }
    content["parameters"] = {
        name: value for name, value in flight.parameters.items() if len(name) <= _MAT_NAME
    }
    content["plan"] = flight.plan
    content["notes"] = "\n".join(f"{name}: {value}" for name, value in flight.meta.items())
    content["events"] = "\n".join(f"{event.t_s:.3f} s {event.name}: {event.text}" for event in flight.events)
    buffer = io.BytesIO()
    savemat(buffer, content, do_compression=True, oned_as="column")
    # The first 116 bytes contain the date. Without the date, the same flight gives the same bytes.
    data = b"MATLAB 5.0 MAT-file, written by heli_host".ljust(116) + buffer.getvalue()[116:]
    try:
        write_bytes(path, data)
    except OSError as error:
        raise LogWriteError(
            f"cannot write {path}: {error.strerror or error}", "choose another folder"
        ) from error


def export_parquet(flight: Flight, path: str | Path) -> None:
    """Write a Parquet file: one column each, with parameters, plan and notes in its metadata."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise LogWriteError("writing Parquet needs pyarrow", install_remedy("export")) from error
    table = pyarrow.table({name: np.ascontiguousarray(column) for name, column in flight.columns().items()})
    notes = {f"parameter.{name}": repr(value) for name, value in flight.parameters.items()}
    notes |= {"plan": flight.plan, **flight.meta, "writer": WRITER}
    table = table.replace_schema_metadata(notes)
    try:
        with replacing(path) as unfinished:
            pyarrow.parquet.write_table(table, str(unfinished))
    except OSError as error:
        raise LogWriteError(
            f"cannot write {path}: {error.strerror or error}", "choose another folder"
        ) from error


_MAT_NAME = 63
"""Longest name that MATLAB takes."""
