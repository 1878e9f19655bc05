"""Tables of text, in the dialects that programs and countries write them."""

from __future__ import annotations

import ast
import contextlib
import csv
import gzip
import io
import itertools
import json
import re
import statistics
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from heli_host.data.arrays import Floats, Integers
from heli_host.data.files import read_file
from heli_host.data.tables.limits import MAX_BYTES, MAX_ROWS, check_columns, too_large
from heli_host.data.tables.table import (
    TIME_UNITS,
    Column,
    RowChange,
    Table,
    seconds_of,
    unit_of,
    with_padded_fractions,
)
from heli_host.errors import FlightDataError, file_remedy

if TYPE_CHECKING:
    import pandas

_MAX_LINE_CHARACTERS: Final = 1 << 16
"""Longest line: a thousand columns have 20 thousand characters."""
_LINE_ENDS: Final = tuple(bytes([code]) for code in b"\n\x0b\x0c\x1c\x1d\x1e\x85\xa8\xa9")
"""Last bytes of all line ends, including those of Unicode; carriage returns are counted separately."""
_COMMENTS: Final = ("#", "%", "//", '"#')
_MINUS: Final = re.compile(r"[\u2212\u2013\ufe63\uff0d](?=[\d.,])")
"""Other characters for the minus of a number: documents and spreadsheets write them."""
_WORD_FIRST: Final = re.compile(r'\s*"?[^\W\d]')
_RULE: Final = re.compile(r"^[|+:=\s-]*-{3}[|+:=\s-]*$")
"""Line of dashes below the header of a table in a document."""
_SEPARATORS: Final = (";", "\t", ",", "|", " ")
_LOOKED_AT: Final = 60
"""Number of lines from which the dialect is determined."""
_EMPTY: Final = frozenset({"", "nan", "na", "n/a", "null", "none", "-nan", "inf", "-inf", "#n/a"})
_HIGH_BYTES: Final = re.compile(rb"[\x80-\xff]+")
_ENCODING_BYTES: Final = 1 << 16
"""Number of bytes, such as a header, from which the encoding is determined."""
_MIN_LETTERS: Final = 4
"""Letters of a word in a row from which on they are Russian: accents are single letters."""
_JAPANESE: Final = re.compile("[\u3041-\u30fe\u4e00-\u9fff]{2}")
_SHORT_SHARE: Final = 0.2
"""Share of rows with equally few cells from which they are complete; damage does not repeat like this."""
_FULL_SHARE: Final = 0.03
"""Share of rows with equally many more cells from which the others lack their blank cells: one in 25 has the
values of a slower signal. Two lines in one have twice the cells, or one cell less."""
_LABEL_SHARE: Final = 0.9
"""Share of the cells with the same label, or with separators of thousands; other cells may be damaged."""
_MIN_DISTINCT: Final = 10
"""Smallest number of different numbers with a label; names such as `motor2` have few."""
_DAMAGED_SHARE: Final = 0.05
"""Largest share of the cells of a column that are no numbers because of damage."""
_THOUSANDS: Final = {
    ".": r"^[-+]?\d{1,3}(?:[,'\u2019\s\u202f\u00a0]\d{3})+(?:\.\d*)?$",
    ",": r"^[-+]?\d{1,3}(?:[.'\u2019\s\u202f\u00a0]\d{3})+(?:,\d*)?$",
}
"""Numbers with separators of thousands, by decimal mark."""
_GROUPED: Final = r"^[-+]?\d{1,3}(?:([,.])\d{3})(?:\1\d{3})+$"
"""Numbers with the same mark twice or more, as in `1,204,500`: it separates thousands in any dialect."""
_COMMA_NUMBER: Final = r"^[-+]?(?:\d+,?\d*|,\d+)(?:[eE][-+]?\d+)?$"
_ACCOUNTED: Final = (r"^(?:\((\d[\d.,]*)\)|(\d[\d.,]*)-)$", r"-\1\2")
"""Negative numbers as accountants write them, in brackets or with the minus behind."""
_FORTRAN_EXPONENT: Final = (r"(?<=\d)[dD](?=[-+]?\d+$)", "e")
_LABELLED: Final = r"^([^\d+\-.]*)([-+]?\d[\d,.']*(?:[eE][-+]?\d+)?)([^\d]*)$"
_NAMED_VALUE: Final = re.compile(
    r"(?<![\w=])\"?(?P<name>[^\W\d][\w°./()\[\] -]*?)\"?\s*[:=]\s*"
    r"(?P<value>(?:\d{4}-\d{2}-\d{2}[T ])?\d{1,3}(?::\d{2}){1,2}(?:\.\d+)?"
    r"|(?:\d+h)?\d+m[\d.]+s|[-+]?(?:\d+(?:[.,]\d+)?|\.\d+)(?:[eE][-+]?\d+)?|nan)"
    r"(?:\s?(?!i,)(?P<unit>[A-Za-z°%µ/]{1,8})(?=\s*(?:[,;|\t]|$)))?"
)
"""Value with its name before it, as in `pitch:1.25`, `Front = 3.1 V` or `time=10:02:03.5`. InfluxDB marks
whole numbers by an i."""
_MIN_NAMED: Final = 3
_MIN_NAMED_SHARE: Final = 0.5
"""Fewest values with names in a line, and smallest share of the lines with the same names."""
_MIN_NAMES_SHARE: Final = 0.05
"""Share of the lines with the same names from which they are complete: signals have several rates, or come in
lines of their own. Damage changes the names of a line at random."""
_MIN_REORDERED: Final = 4
"""Fewest cells of a row that count as another header. A row of fewer may repeat the names by chance."""
_MIN_NAMES: Final = 5
"""Fewest names of a header with any other number of columns; a title may have a few commas."""
_MIN_SIGNAL_ROWS: Final = 10
_MAX_SIGNALS: Final = 64
"""Fewest values of a signal, and most signals, in a table with one value per row."""
_CLOCK_TIME: Final = r"\d{1,2}:\d{2}:\d{2}(?:[.,]\d+)?"
_DATE_TIME: Final = rf"(?:\d{{4}}-\d{{2}}-\d{{2}}[T ])?{_CLOCK_TIME}"
_RECEIVED: Final = re.compile(
    rf"^\s*(?:(?P<arrow>{_DATE_TIME})\s*->"
    rf"|\[(?:\w{{3}} \w{{3}} +\d+ )?(?P<bracket>{_DATE_TIME})(?: \d{{4}})?\](?!\s*[,;])"
    rf"|(?P<bare>{_DATE_TIME}) +(?![AaPp]\.?[Mm])(?=[^ ,;\t]+[,;\t]))\s*(?P<rest>.*)$"
)
"""Line of a serial monitor, with the time at which it was received: before an arrow, in brackets, or before
the first cell of a row with another separator."""
_CHECKSUM: Final = re.compile(r"\*[0-9A-Fa-f]{2}\s*$")
"""End of a sentence as GPS receivers send it, such as `$HELI,1.2,3.4*5A`."""
_KIND: Final = re.compile(r"^\s*([$!@>]?[A-Za-z_]\w*)\s*[,;:\t ]\s*(.+)$")
"""Line that begins with the kind of its message, such as `$ATT,0.01,1.2,3.4` or `MOT 0.01 5.1 4.9`."""
_MIN_CHANGES: Final = 0.2
"""Share of the lines from which on the kind changes. The state of a controller, in a table's first column,
changes seldom."""
_STAMP: Final = re.compile(rf"{_CLOCK_TIME}|(?<=[\[(])\d+(?:\.\d+)?(?=[\])])|^\s*\d+(?:\.\d+)?(?=\s*[;,|\t])")
"""Time in front of the values with names, as a clock, in brackets, or as the first cell."""
_ESCAPED: Final = re.compile(r"\\[ ,]")
"""Space or comma within a name, as InfluxDB writes them."""
_LAST_STAMP: Final = re.compile(r"(?<= )\d{10,19}$")
"""Time behind the values with names, as in the line protocol of InfluxDB: whole units since 1970."""
_CLOCK_COMMA: Final = re.compile(r"(?<=:\d{2}:\d{2}),(?=\d{3})")
_TIME_CELL: Final = re.compile(r"^\s*\d+[-/.:]\d+[-/.:][-\d/.:,TZ+ ]*(?:[AaPp][Mm])?\s*$")
"""Time or date in a cell, which a row above a header may have."""
_STAMP_NAME: Final = "timestamp"
_UNIT_BEHIND: Final = re.compile(r"(.*\d\.?)\s*([A-Za-z°%µ/]{1,8})$")
_NUMPY_NUMBER: Final = re.compile(r"np\.\w+\(([^()]*)\)")
"""As in `np.float64(1.5)`, which NumPy prints within a dictionary."""
_NUMBER: Final = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eEdD][-+]?\d+)?$")


@dataclass(frozen=True)
class Dialect:
    """How a table of text is written: the `separator` of columns, and the `decimal` mark of numbers."""

    separator: str
    decimal: str


def read_text(path: Path) -> Table:
    """Read a text table at `path`, which may be compressed by gzip.

    Separator and decimal mark are recognised. Names, units and comments are optional.
    """
    lines = _read_lines(path)
    notes = "\n".join(line.strip().lstrip("#%/ ") for line in lines if line.strip().startswith(_COMMENTS))
    body = [
        line
        for line in lines
        if line.strip() and not line.strip().startswith(_COMMENTS) and not _RULE.match(line)
    ]
    # A name may begin like a comment, as that of a counter in `#:12, pitch:1.5`.
    body = body or [line for line in lines if any(char.isdigit() for char in line)]
    if not body:
        raise FlightDataError(f"{path}: the file is empty", "record a flight into it first")
    body = _without_names_in_rows(_without_kinds(path, _without_checksums(body), notes.splitlines()))
    body, stamps = _without_reception_times(body)
    # At the beginning the rig is at rest, and whole numbers do not show the decimal mark. Therefore lines of
    # the whole file are examined.
    sampled_lines = body[:: max(1, len(body) // _LOOKED_AT)]
    dialect = find_dialect([*body[:_LOOKED_AT], *sampled_lines])
    if dialect is None:
        raise FlightDataError(
            f"{path}: the file has no columns of numbers",
            "give a table with one row per sample, separated by , ; or tabs",
        )
    if stamps:
        # The times of reception become the last column.
        body = [line + dialect.separator + stamp for line, stamp in zip(body, stamps, strict=True)]
        sampled_lines = body[:: max(1, len(body) // _LOOKED_AT)]
    start = _first_row(body[:_LOOKED_AT], dialect, sampled_lines)
    # A capture may begin between two headers: rows above a header are rows, too.
    is_early = [_is_row(line, dialect, sampled_lines) for line in body[:start]]
    header = [line for line, early in zip(body[:start], is_early, strict=True) if not early]
    rows = [*itertools.compress(body, is_early), *body[start:]]
    if not rows:
        raise FlightDataError(
            f"{path}: the file has no row of numbers",
            "give a table with one row per sample, separated by , ; or tabs",
        )
    header = header or _commented_header(lines, rows, dialect)
    if dialect.separator == ",":
        name_count = len(_split_cells(header[-1], dialect)) if header else 0
        rows = _with_points_in_clocks(rows, name_count)
    _refuse_other_header(path, header, rows, dialect)
    rows, width, places, changes = _whole_rows(rows, header, dialect)
    check_columns(path, width)
    names, units = _names_and_units(_with_row_name(path, header, rows, dialect, width), dialect, width)
    if stamps:
        names[-1] = _STAMP_NAME
    frame = _frame_of_rows(path, rows, dialect, width)
    if len(frame) < len(rows):
        places = None
        changes.append(RowChange("left out", len(rows) - len(frame), "with unbalanced quotes"))
    columns, unread, time_changes = _columns_of_frame(frame, rows, names, units, dialect)
    changes += time_changes
    if not columns:
        raise FlightDataError(
            f"{path}: the file has no columns of numbers", "give a table with one row per sample"
        )
    labels = [
        frame[index] for index, name in enumerate(names) if name in unread and frame[index].nunique() > 1
    ]
    if len(labels) == 1:
        columns = _signals_of_labels(labels[0], columns) or columns
    return Table(str(path), columns, notes, bool(header), tuple(changes), unread, places)


def _frame_of_rows(path: Path, rows: list[str], dialect: Dialect, width: int) -> pandas.DataFrame:
    """Parse rows with `width` cells each; rows with unbalanced quotes are left out."""
    import pandas

    try:
        return pandas.read_csv(
            io.StringIO("\n".join(rows)),
            sep=r"\s+" if dialect.separator == " " else dialect.separator,
            decimal=dialect.decimal,
            header=None,
            names=range(width),
            usecols=range(width),
            on_bad_lines="skip",
            low_memory=False,
            skipinitialspace=True,
            skip_blank_lines=False,
        )
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise FlightDataError(f"{path}: not a table ({reason})", "check its quotes and separators") from error


def _columns_of_frame(
    frame: pandas.DataFrame, rows: list[str], names: list[str], units: list[str], dialect: Dialect
) -> tuple[dict[str, Column], dict[str, str], list[RowChange]]:
    """Return the columns of numbers and times, a cell of each other column, and the changes of times."""
    columns: dict[str, Column] = {}
    unread: dict[str, str] = {}
    changes: list[RowChange] = []
    for index, name in enumerate(names):
        cells = frame[index]
        values, unit = numbers_of(cells, dialect)
        padded = None
        if len(frame) == len(rows) and _falls_within_seconds(values):
            padded = _padded_times(rows, index, dialect)
        if padded is not None:
            changes += _padded_change(name, padded.texts)
            values = padded.times
        has_numbers = bool(np.isfinite(values).any())
        is_mostly_numbers = np.isfinite(values).mean() > 0.5
        clock_s = None if is_mostly_numbers else seconds_of(cells)
        if clock_s is not None:
            changes += _padded_change(name, cells)
            columns[name] = Column(clock_s, "s")
            continue
        other_cell = _other_notation(cells, values) if has_numbers else ""
        if has_numbers and not other_cell:
            columns[name] = Column(values, units[index] or unit)
        elif cells.notna().any():
            unread[name] = other_cell or str(cells.dropna().iloc[0]).strip()
    return columns, unread, changes


class _PaddedTimes(NamedTuple):
    """Times whose fractions of seconds were written without zeros."""

    texts: pandas.Series  # As in the file
    times: Floats


def _padded_times(rows: list[str], column: int, dialect: Dialect) -> _PaddedTimes | None:
    """Read a column as times whose fractions lack zeros; None if the times then fall."""
    import pandas

    cells = [_split_cells(row, dialect)[column : column + 1] for row in rows]
    texts = pandas.Series(cells).str[0].str.replace(dialect.decimal, ".")
    times: Floats = pandas.to_numeric(with_padded_fractions(texts), errors="coerce").to_numpy(np.float64)
    return _PaddedTimes(texts, times) if (np.diff(times) >= 0.0).all() else None


def _signals_of_labels(labels: pandas.Series, columns: dict[str, Column]) -> dict[str, Column]:
    """Divide a table with one value per row by its `labels`; empty if it is another table."""
    import pandas

    # A database exports the number of a signal and the limits of its request, too.
    varying = {
        name: column
        for name, column in columns.items()
        if pandas.Series(column.values).groupby(labels).nunique().max() > 1
    }
    return _signals_by_name(labels, varying) if len(varying) == 2 else {}


def _falls_within_seconds(values: Floats) -> bool:
    """Whether the whole numbers of a column rise and never fall, but its fractions do, as after `7.9` in
    `7.10`.
    """
    whole = np.floor(values)
    return bool(np.ptp(whole) > 1.0 and (np.diff(whole) >= 0.0).all() and (np.diff(values) < 0.0).any())


def _padded_change(name: str, cells: pandas.Series) -> list[RowChange]:
    """Report times whose fractions of seconds are whole numbers without zeros; empty if they are not."""
    texts = cells.dropna().astype(str).str.strip()
    padded = with_padded_fractions(texts)
    count = int((padded != texts).sum())
    change = RowChange("retimed", count, f"whose fractions of seconds in '{name}' lack their zeros")
    return [change] if count else []


def _other_notation(cells: pandas.Series, values: Floats) -> str:
    """Return the first cell with digits that is no number, if such cells are too many for damaged lines.

    The numbers of this column then have another notation in some rows, such as hexadecimal digits.
    """
    is_text = ~np.isfinite(values) & cells.notna().to_numpy()
    if is_text.mean() <= _DAMAGED_SHARE:
        return ""
    texts = cells[is_text].astype(str)
    texts = texts[texts.str.contains(r"\d")]
    # A program that has no value writes one text for it.
    if texts.size <= _DAMAGED_SHARE * cells.size or texts.nunique() < _MIN_DISTINCT:
        return ""
    return str(texts.iloc[0]).strip()


def _without_checksums(lines: list[str]) -> list[str]:
    """Return lines without the checksum at their end, if most have one."""
    if np.mean([bool(_CHECKSUM.search(line)) for line in lines]) < _LABEL_SHARE:
        return lines
    return [_CHECKSUM.sub("", line) for line in lines]


def _without_reception_times(lines: list[str]) -> tuple[list[str], list[str]]:
    """Return the lines of a serial monitor without the times before them, and these times; empty if none."""
    sampled = [_RECEIVED.match(line) for line in lines[:: max(1, len(lines) // _LOOKED_AT)]]
    if sum(match is not None for match in sampled) < _LABEL_SHARE * len(sampled):
        return lines, []
    matches = [_RECEIVED.match(line) for line in lines]
    rests = [match["rest"] if match else line for line, match in zip(lines, matches, strict=True)]
    return rests, [
        # The program that adds the times may have written the header before.
        (match["arrow"] or match["bracket"] or match["bare"]) if match else _STAMP_NAME
        for match in matches
    ]


def _without_names_in_rows(lines: list[str]) -> list[str]:
    """Turn lines that name each value, such as `pitch:1.2,travel:0.5` or JSON, into a header and rows with
    tabs.

    Lines may name different signals, and have blank cells for the others. A line with names that few lines
    have is damaged, and becomes a row with one cell.
    """
    sampled = [_names_in_row(line) for line in lines[:: max(1, len(lines) // _LOOKED_AT)]]
    most_names = max(map(len, sampled), default=0)
    if most_names < _MIN_NAMED or sum(map(bool, sampled)) < _MIN_NAMED_SHARE * len(sampled):
        return lines
    named = [_named_values(line) for line in lines]
    names_of_lines = [tuple(name for name, _, _ in values) for _, values in named]
    counts = Counter(names_of_lines)
    complete = [names for names in counts if names and counts[names] >= _MIN_NAMES_SHARE * len(lines)]
    if sum(counts[names] for names in complete) < _MIN_NAMED_SHARE * len(lines):
        return lines
    # The longest list of names shows the order of the columns best.
    order = list(dict.fromkeys(itertools.chain(*sorted(complete, key=len, reverse=True))))
    units = {name: unit for _, values in named for name, _, unit in values if unit}
    # The time of a line is in front of its values, or behind them.
    stamps = [
        _STAMP.search(line[:values_at]) or _LAST_STAMP.search(line)
        for line, (values_at, _) in zip(lines, named, strict=True)
    ]
    has_stamps = sum(stamp is not None for stamp in stamps) > _LABEL_SHARE * len(lines)
    header = [f"{name} [{units[name]}]" if name in units else name for name in order]
    # What a board prints at its start is above the header.
    first = next(index for index, names in enumerate(names_of_lines) if names in complete)
    rows = [*lines[:first], "\t".join([*header, _STAMP_NAME] if has_stamps else header)]
    lines_with_names = list(zip(lines, named, names_of_lines, stamps, strict=True))
    for line, (_, values), names, stamp in lines_with_names[first:]:
        if names not in complete:
            rows.append(line.replace("\t", " "))
            continue
        cells = {name: value for name, value, _ in values}
        # A blank cell at the end would count as the separator of a line end.
        row = [cells.get(name, "") or "nan" for name in order]
        if has_stamps:
            row.append(stamp.group().replace(",", ".") if stamp else "")
        rows.append("\t".join(row))
    return rows


def _named_values(line: str) -> tuple[int, list[tuple[str, str, str]]]:
    """Return where the values with names begin in a line, and name, value and unit of each."""
    if (record := _record_in(line)) is not None:
        return line.find("{"), [(name, " ".join(value.split()), "") for name, value in _flat(record)]
    values: list[tuple[str, str, str]] = []
    start = len(line)
    for match in _NAMED_VALUE.finditer(_ESCAPED.sub(" ", line)):
        start = min(start, match.start())
        name = match["name"].strip()
        while any(name == other for other, _, _ in values):
            name += "'"
        values.append((name, match["value"].replace(",", "."), match["unit"] or ""))
    return start, values


def _json_lines(text: str) -> list[str]:
    """Return one line per record of a JSON file: a list of objects, or an object with a list per column;
    empty if it is another file, such as JSON lines.
    """
    try:
        content = json.loads(text)
    except (ValueError, RecursionError):
        return []
    if isinstance(content, dict):
        # pandas writes each column as an object with a value per row.
        columns = {
            key: list(value.values()) if isinstance(value, dict) else value for key, value in content.items()
        }
        lists = {key: value for key, value in columns.items() if isinstance(value, list)}
        longest = max(lists.values(), key=len, default=[])
        if longest and not isinstance(longest[0], dict):
            names = [key for key, value in lists.items() if len(value) == len(longest)]
            longest = [
                dict(zip(names, row, strict=True)) for row in zip(*map(lists.__getitem__, names), strict=True)
            ]
        content = longest
    return [json.dumps(record) for record in content] if isinstance(content, list) else []


def _record_in(line: str) -> dict[str, Any] | None:
    """Return the JSON object that ends a line, maybe behind a time; None if there is none.

    Python prints dictionaries with other quotes and names of constants.
    """
    brace, end = line.find("{"), line.rfind("}") + 1
    # In a list that was cut off, a line may end with a comma.
    if brace < 0 or line[end:].strip() not in ("", ",", "]"):
        return None
    try:
        record = json.loads(line[brace:end])
    except (ValueError, RecursionError):
        try:
            record = ast.literal_eval(_NUMPY_NUMBER.sub(r"\1", line[brace:end]))
        except (ValueError, SyntaxError, MemoryError, RecursionError):
            return None
    return record if isinstance(record, dict) else None


def _flat(record: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield the values of a JSON object as text, with names such as ``pose.x`` and ``angles[0]``."""
    for key, value in record.items():
        name = f"{prefix}{key}"
        if isinstance(value, dict):
            yield from _flat(value, f"{name}.")
        elif isinstance(value, list):
            yield from _flat({f"{name}[{index}]": element for index, element in enumerate(value)})
        else:
            yield name, "" if value is None else str(float(value) if isinstance(value, bool) else value)


def _without_kinds(path: Path, lines: list[str], notes: list[str]) -> list[str]:
    """Turn lines of several kinds, such as `$ATT,0.01,1.2,3.4` and `$MOT,0.01,5.1,4.9`, into a header and
    rows with tabs; each row has blank cells for the values of the other kinds.

    The first value of each line is the time. Names may be in a line with words behind the kind.
    """
    matches = [_KIND.match(line) for line in lines]
    if sum(match is not None for match in matches) < _LABEL_SHARE * len(lines):
        return lines
    dialect = find_dialect([match[2] for match in matches[:: max(1, len(lines) // _LOOKED_AT)] if match])
    if dialect is None:
        return lines
    parts = [_KindOfLine(match[1], _split_cells(match[2], dialect)) for match in matches if match]
    messages, widths = _messages_of_kinds(parts, len(lines), dialect)
    if not messages:
        return lines
    if not _have_common_time([message.cells[0].replace(dialect.decimal, ".") for message in messages]):
        raise FlightDataError(
            f"{path}: its lines are of several kinds ({', '.join(widths)}), whose first values are no time "
            "that all share",
            "log all values in one line, or begin each line with its kind and the time",
        )
    in_notes = [match for match in map(_KIND.match, notes) if match]
    headers = [_KindOfLine(match[1], _split_cells(match[2], dialect)) for match in in_notes] + parts
    names = _names_by_kind(headers, widths, dialect)
    time_names = {time_name for time_name, *_ in names.values()}
    name_counts = Counter(itertools.chain(*(value_names for _, *value_names in names.values())))
    # A column for each value of each kind; names that several kinds have get the kind in front.
    columns = {
        (kind, place): name if name_counts[name] == 1 else f"{kind} {name}"
        for kind, (_, *value_names) in names.items()
        for place, name in enumerate(value_names, 1)
    }
    rows = ["\t".join([time_names.pop() if len(time_names) == 1 else _STAMP_NAME, *columns.values()])]
    for kind, cells in messages:
        plain = [cell.replace(dialect.decimal, ".") for cell in cells]
        row = [(plain[place] or "nan") if kind == column_kind else "nan" for column_kind, place in columns]
        rows.append("\t".join([plain[0], *row]))
    return rows


def _messages_of_kinds(
    parts: Sequence[_KindOfLine], line_count: int, dialect: Dialect
) -> tuple[list[_KindOfLine], dict[str, int]]:
    """Return the lines that are messages of several kinds, and the number of values of each kind; nothing if
    the words in front of the lines are not kinds of messages.
    """
    messages = [
        part
        for part in parts
        if _is_value(part.cells[0], dialect)
        and all(_is_number(cell, dialect) or not cell for cell in part.cells[1:])
    ]
    counts = Counter((message.kind, len(message.cells)) for message in messages)
    widths = {
        kind: width for (kind, width), count in counts.items() if count >= _MIN_NAMES_SHARE * line_count
    }
    messages = [message for message in messages if widths.get(message.kind) == len(message.cells)]
    if not 1 < len(widths) <= _MAX_SIGNALS or max(widths.values()) < _MIN_NAMED:
        return [], {}
    changes = sum(message.kind != other.kind for message, other in itertools.pairwise(messages))
    if len(messages) < _LABEL_SHARE * line_count or changes < _MIN_CHANGES * len(messages):
        return [], {}
    # A name above the kinds: they are a column of a table.
    first_line = parts[0]
    is_header = first_line.kind not in widths and {len(first_line.cells)} == set(widths.values())
    return ([], {}) if is_header else (messages, widths)


def _have_common_time(first_cells: Sequence[str]) -> bool:
    """Whether the first cells of messages are a time: it rises, except in damaged lines."""
    import pandas

    cells = pandas.Series(first_cells)
    numbers: Floats = pandas.to_numeric(cells, errors="coerce").to_numpy(np.float64)
    times = numbers if np.isfinite(numbers).any() else seconds_of(cells)
    if times is None or np.nanmax(times) == np.nanmin(times):
        return False
    return bool(np.nanmean(np.diff(times) < 0.0) <= 1.0 - _LABEL_SHARE)


class _KindOfLine(NamedTuple):
    """A line that begins with the kind of its message, and its further cells."""

    kind: str
    cells: list[str]


def _names_by_kind(
    headers: Sequence[_KindOfLine], widths: Mapping[str, int], dialect: Dialect
) -> dict[str, list[str]]:
    """Return the names of the values of each kind, from its first line if that has words; otherwise numbers.

    `widths` is the number of values of each kind.
    """
    first_cells = {header.kind: header.cells for header in reversed(headers)}
    names: dict[str, list[str]] = {}
    for kind, width in widths.items():
        words = first_cells.get(kind, [])
        has_names = len(words) == width and not any(_is_number(word, dialect) for word in words)
        names[kind] = words if has_names else [f"{kind} {number}" for number in range(1, width + 1)]
    return names


def _names_in_row(line: str) -> tuple[str, ...]:
    """Return the names in front of the values of a line."""
    return tuple(name for name, _, _ in _named_values(line)[1])


def _whole_rows(
    rows: list[str], header: list[str], dialect: Dialect
) -> tuple[list[str], int, Integers | None, list[RowChange]]:
    """Leave out the rows that are damaged: return the others, the number of columns, the places of the rows
    in the file, if some were left out, and the changes.

    A row with another number of cells than the table has lost or gained a separator, so its cells are not in
    their columns. Rows of which many are short by the same number lack only blank cells at their end.
    """
    cell_counts = np.array([_cell_count(row, dialect) for row in rows])
    width = int(statistics.mode(cell_counts.tolist()))
    has_separator_last = np.array([row.rstrip(" \r\n").endswith(dialect.separator) for row in rows])
    if has_separator_last[cell_counts == width].all() and not _has_blank_last_column(header, width, dialect):
        cell_counts, width = cell_counts - has_separator_last, width - 1
    # Two rates in one table: the rows of one of them may lack their blank cells at the end.
    sizes, row_counts = np.unique(cell_counts, return_counts=True)
    is_full = (sizes > width) & (sizes < 2 * width - 1) & (row_counts > _FULL_SHARE * len(rows))
    width = int(sizes[is_full].max()) if is_full.any() else width
    frequent_sizes = sizes[(sizes <= width) & (row_counts > _SHORT_SHARE * len(rows))]
    is_whole = np.isin(cell_counts, [width, *frequent_sizes.tolist()])
    is_whole |= (cell_counts == width + 1) & has_separator_last
    whole_rows = list(itertools.compress(rows, is_whole.tolist()))
    if is_whole.all():
        return whole_rows, width, None, []
    bad = np.flatnonzero(~is_whole)
    bad_cells = int(cell_counts[bad[0]])
    change = RowChange(
        "left out",
        bad.size,
        f"whose line is damaged: not {width} cells (first: row {int(bad[0]) + 1} of numbers, "
        f"{bad_cells} {'cell' if bad_cells == 1 else 'cells'})",
    )
    # Two lines in one are two rows; a line of text, such as an error, is none.
    rows_in_line = np.maximum(np.round(cell_counts / width), 1).astype(int)
    text_lines = [row for row in bad if cell_counts[row] == 1 and not _is_value(rows[row].strip(), dialect)]
    rows_in_line[text_lines] = 0
    places = (np.cumsum(np.where(is_whole, 1, rows_in_line)) - 1)[is_whole]
    return whole_rows, width, places, [change]


def _has_blank_last_column(header: list[str], width: int, dialect: Dialect) -> bool:
    """Whether rows that end with a separator have a blank cell behind it; otherwise it makes no column."""
    cell_counts = [_cell_count(line, dialect) for line in header]
    # Tabs at the end of lines are separators of blank cells, unless the header has one name less.
    if dialect.separator in " \t" and width - 1 not in cell_counts:
        return True
    return any(
        count == width and not line.rstrip().endswith(dialect.separator)
        for line, count in zip(header, cell_counts, strict=True)
    )


def _commented_header(lines: list[str], rows: list[str], dialect: Dialect) -> list[str]:
    """Return the names that a comment above the rows states, as numpy's savetxt and rostopic write them.

    Such a comment has one name for each cell of the rows. The last one is the nearest to the rows.
    """
    width = statistics.mode(_cell_count(row, dialect) for row in rows[:_LOOKED_AT])
    comments = itertools.takewhile(lambda line: line != rows[0], lines)
    for line in reversed([line for line in comments if line.strip().startswith(_COMMENTS)]):
        text = line.strip().strip('"').lstrip("#%/ ")
        cells = _split_cells(text, dialect)
        is_header = all(cell.strip() and not _is_value(cell, dialect) for cell in cells)
        if len(cells) == width and is_header and width > 2:
            return [text]
    return []


def _with_points_in_clocks(rows: list[str], width: int) -> list[str]:
    """Write a point into times with a decimal comma, such as `14:05:09,250`, in a table with commas.

    This comma makes one more cell than the header has names: `width`, or 0 without a header.
    """
    if width and statistics.mode(row.count(",") + 1 for row in rows) != width + 1:
        return rows
    pointed = [_CLOCK_COMMA.sub(".", row, count=1) for row in rows]
    is_changed = sum(row != before for row, before in zip(pointed, rows, strict=True))
    return pointed if is_changed > _LABEL_SHARE * len(rows) else rows


def _cell_count(line: str, dialect: Dialect) -> int:
    """Count the cells of a line, with a blank one at its end."""
    if dialect.separator == " ":
        return len(line.split())
    if '"' in line:
        return len(
            next(csv.reader([line.strip(" \r\n")], delimiter=dialect.separator, skipinitialspace=True), [])
        )
    return line.count(dialect.separator) + 1


def _signals_by_name(labels: pandas.Series, columns: dict[str, Column]) -> dict[str, Column]:
    """Divide a table with one value per row into signals with separate times; empty if it is none.

    Such a table has three columns: a time, the name of a signal, and its value.
    """

    def clock_rank(column: Column) -> tuple[bool, float]:
        """Rank columns: first those with a unit of time, then those that turn back least often."""
        falling_share = float(np.mean(np.diff(column.values) < 0.0))
        # The newest row may come first: then the times fall.
        return column.unit not in TIME_UNITS, min(falling_share, 1.0 - falling_share)

    clock, value = sorted(columns.values(), key=clock_rank)
    counts = labels.value_counts()
    counts = counts[counts > _MIN_SIGNAL_ROWS]
    if not _MIN_NAMED <= counts.size <= _MAX_SIGNALS:
        return {}
    t_s = clock.values * TIME_UNITS.get(clock.unit, 1.0)
    signals = {}
    for name in counts.index:
        rows = (labels == name).to_numpy() & np.isfinite(t_s) & np.isfinite(value.values)
        order = np.argsort(t_s[rows], kind="stable")
        signals[str(name)] = Column(value.values[rows][order], "", t_s[rows][order])
    return signals


def numbers_of(cells: pandas.Series, dialect: Dialect) -> tuple[Floats, str]:
    """Return the numbers of a column, and a unit that its cells state.

    Cells may have separators of thousands, as in `1,204.5`, or all the same label and unit, as in `t=1.5 ms`.
    """
    import pandas

    values = pandas.to_numeric(cells, errors="coerce").to_numpy(np.float64, copy=True)
    unread = ~np.isfinite(values) & cells.notna().to_numpy()
    if unread.any():
        # Other notations of numbers first, for each cell alone.
        plain = cells[unread].astype(str).str.strip().str.replace(*_FORTRAN_EXPONENT, regex=True)
        plain = plain.str.replace(*_ACCOUNTED, regex=True)
        # One cell of text, as in a repeated header, keeps pandas from reading the decimal commas of a column.
        if dialect.decimal == ",":
            plain = plain.where(plain.str.match(_COMMA_NUMBER)).str.replace(",", ".")
        values[unread] = pandas.to_numeric(plain, errors="coerce").to_numpy(np.float64)
        unread = ~np.isfinite(values) & cells.notna().to_numpy()
    if not unread.any():
        return values, ""
    text = cells[unread].astype(str).str.strip()
    if (grouped := _grouped_numbers(cells, text)) is not None:
        return grouped, ""
    thousands = text.str.match(_THOUSANDS[dialect.decimal])
    if thousands.mean() > _LABEL_SHARE:
        values[unread] = _without_thousands(text.where(thousands), dialect)
        return values, ""
    parts = text.str.extract(_LABELLED)
    before, number, behind = parts[0].fillna("").str.strip(), parts[1], parts[2].fillna("").str.strip()
    is_labelled = number.notna()
    labels = (before + "|" + behind).where(is_labelled)
    has_bare_numbers = (labels == "|").mean() > 1.0 - _LABEL_SHARE
    # Few different numbers, as in `motor2`, are part of a name.
    if has_bare_numbers or number.nunique() < _MIN_DISTINCT:
        return values, ""
    if unread.mean() < _LABEL_SHARE or is_labelled.mean() < _LABEL_SHARE:
        return values, ""
    label = labels.mode().iloc[0]
    is_same = labels == label
    if is_same.mean() < _LABEL_SHARE:
        return values, ""
    values[unread] = _without_thousands(number.where(is_same), dialect)
    _, _, unit_text = label.partition("|")
    return values, unit_of(unit_text)


def _grouped_numbers(cells: pandas.Series, unread: pandas.Series) -> Floats | None:
    """Read a column whose unread cells are numbers such as `1,204,500`; None if they are other texts.

    The mark then separates the thousands of the column's smaller numbers, too: `999,500` is 999500.
    """
    import pandas

    marks = unread.str.extract(_GROUPED)[0]
    if marks.notna().mean() <= _LABEL_SHARE or marks.dropna().nunique() != 1:
        return None
    bare = cells.astype(str).str.strip().str.replace(str(marks.dropna().iloc[0]), "", regex=False)
    values: Floats = pandas.to_numeric(bare, errors="coerce").to_numpy(np.float64)
    return values


def _without_thousands(text: pandas.Series, dialect: Dialect) -> Floats:
    """Read numbers that may have separators of thousands; nan for a cell that is no number."""
    import pandas

    separator = "," if dialect.decimal == "." else "."
    bare = text.str.replace(rf"(?<=\d)[{separator}'\u2019\s\u202f\u00a0](?=\d{{3}})", "", regex=True)
    values: Floats = pandas.to_numeric(bare.str.replace(",", "."), errors="coerce").to_numpy(np.float64)
    return values


def find_dialect(lines: list[str]) -> Dialect | None:
    """Find the dialect in which most cells of `lines` are numbers; None if lines have less than two cells."""
    best_dialect, best_rank = None, (0.0, 0)
    for separator, decimal in itertools.product(_SEPARATORS, ".,"):
        if separator == decimal and not all('"' in line for line in lines[-_LOOKED_AT // 2 :]):
            continue
        dialect = Dialect(separator, decimal)
        cells = [_split_cells(line, dialect) for line in lines]
        width = statistics.mode(map(len, cells))
        if width < 2:
            continue
        number_shares = [_number_share(row, dialect) for row in cells if len(row) == width]
        number_share = sum(number_shares) / len(cells)
        if (number_share, width) > best_rank:
            best_dialect, best_rank = dialect, (number_share, width)
    return best_dialect


def _number_share(row: list[str], dialect: Dialect) -> float:
    """Share of numbers in a row. Blank cells count too among numbers, because signals have several rates."""
    numbers = sum(_is_number(cell, dialect) for cell in row)
    blanks = sum(not cell.strip() for cell in row)
    return (numbers + blanks * (2 * numbers > len(row) - blanks)) / len(row)


def _read_lines(path: Path) -> list[str]:
    """Return the lines of a file, one per record for JSON; a FlightDataError if one is too long."""
    text = _MINUS.sub("-", _decode_file(path))
    is_json = path.name.lower().removesuffix(".gz").endswith(".json")
    lines = (_json_lines(text) if is_json else None) or text.splitlines()
    if max(map(len, lines), default=0) > _MAX_LINE_CHARACTERS:
        raise FlightDataError(
            f"{path}: a line has more than {_MAX_LINE_CHARACTERS} characters", "give one row per line"
        )
    return lines


def _decode_file(path: Path) -> str:
    """Return the text of a file, unpacked if its name ends in .gz, by the encoding that its bytes suggest."""
    try:
        content = read_file(path, MAX_BYTES)
        if path.name.lower().endswith(".gz"):
            with gzip.GzipFile(fileobj=io.BytesIO(content)) as compressed:
                content = compressed.read(MAX_BYTES + 1)
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise FlightDataError(f"{path}: not a gzip file, or damaged", "copy it again") from error
    except OSError as error:
        raise FlightDataError(f"cannot read {path}: {error.strerror or error}", file_remedy(error)) from error
    if len(content) > MAX_BYTES:
        raise too_large(path, f"{MAX_BYTES >> 20} MiB")
    if max(content.count(b"\r"), sum(content.count(line_end) for line_end in _LINE_ENDS)) > MAX_ROWS:
        raise too_large(path, f"{MAX_ROWS // 1_000_000} million lines")
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        return content.decode("utf-16", errors="replace")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode(_encoding_of(content[:_ENCODING_BYTES]), errors="replace")


def _encoding_of(content: bytes) -> str:
    """Guess the encoding of the beginning of a file that is not in UTF-8, by its bytes of 128 and more."""
    runs = _HIGH_BYTES.findall(content)
    # In the Russian code page of Windows all letters are such bytes, of 192 and more.
    if max(map(len, runs)) >= _MIN_LETTERS and all(min(run) >= 0xC0 for run in runs):
        return "cp1251"
    # In Shift JIS, the first byte of a character is one that no other of these encodings has for letters.
    if any(0x81 <= run[0] <= 0x9F for run in runs):
        with contextlib.suppress(UnicodeDecodeError):
            text = content[: content.rfind(b"\n")].decode("shift_jis")
            if _JAPANESE.search(text):
                return "shift_jis"
    # In GB 18030, Chinese characters are pairs of high bytes; in Latin-1, an accented letter is one.
    return "gb18030" if all(len(run) % 2 == 0 for run in runs) else "latin-1"


def _split_cells(line: str, dialect: Dialect) -> list[str]:
    """Split a line into cells."""
    if dialect.separator == " ":
        return line.split()
    cells = next(csv.reader([line.strip(" \r\n")], delimiter=dialect.separator, skipinitialspace=True), [])
    # A separator at the end of each line makes no column.
    return cells[:-1] if cells and not cells[-1].strip() else cells


def _first_row(lines: list[str], dialect: Dialect, sampled_lines: list[str]) -> int:
    """Return the index of the first row of numbers.

    It is as wide as most rows, and at least half of its cells that are not blank are numbers. No row of names
    may follow, because headers of LabVIEW contain numbers, too.
    """
    width = statistics.mode(len(_split_cells(line, dialect)) for line in sampled_lines)
    cells = [_split_cells(line, dialect) for line in lines]
    number_counts = [sum(_is_value(cell, dialect) for cell in row) for row in cells]
    name_rows = [
        index
        for index, row in enumerate(cells)
        if len(row) >= width and not number_counts[index] and all(cell.strip() for cell in row[:width])
    ]
    if not name_rows:
        # Rows may get more cells in the middle of a file than the names and the first rows have.
        for index, (names, next_row) in enumerate(itertools.pairwise(cells)):
            is_header = not number_counts[index] and all(cell.strip() for cell in names)
            has_number_per_name = len(names) == len(next_row) == number_counts[index + 1]
            if is_header and has_number_per_name and _MIN_NAMED <= len(names) < width:
                return index + 1
    start = max(name_rows, default=-1) + 1
    for index, row in enumerate(cells[start:], start):
        filled_count = sum(bool(cell.strip()) for cell in row)
        if len(row) >= width and filled_count and 2 * number_counts[index] >= filled_count:
            return index
    return len(lines)


def _is_row(line: str, dialect: Dialect, sampled_lines: list[str]) -> bool:
    """Whether a line above a header is as wide as most lines, and contains only numbers, times and dates."""
    cells = _split_cells(line, dialect)
    width = statistics.mode(len(_split_cells(each, dialect)) for each in sampled_lines)
    return len(cells) == width and all(_is_value(cell, dialect) for cell in cells)


def _is_value(cell: str, dialect: Dialect) -> bool:
    """Whether a cell is a number, a time or a date, as cells of rows are and names are not."""
    return _is_number(cell, dialect) or bool(_TIME_CELL.match(cell))


def _is_number(cell: str, dialect: Dialect) -> bool:
    """Whether a cell is a number with the decimal mark of the dialect, or means "missing"."""
    text = cell.strip()
    if dialect.decimal != ".":
        if "." in text:
            return False
        text = text.replace(dialect.decimal, ".")
    if not _NUMBER.match(text):
        # A cell may contain its unit, as in `12.5 deg`.
        bare = _UNIT_BEHIND.match(text)
        text = bare.group(1) if bare and unit_of(bare.group(2)) else text
    return bool(_NUMBER.match(text)) or text.lower() in _EMPTY - {""}


def _names_and_units(header: list[str], dialect: Dialect, width: int) -> tuple[list[str], list[str]]:
    """Return names and units of the columns; a repeated name gets an apostrophe.

    Units come from a separate row, if the header has one.
    """
    rows = [_split_cells(line, dialect) for line in header]
    # A row of units may end with a blank one.
    rows = [[*row, ""] if len(row) == width - 1 > 1 else row for row in rows]
    # A header that is repeated below the first rows would hide the units.
    rows = [list(row) for row in dict.fromkeys(map(tuple, rows))]
    # The header of LabVIEW has one more name, for a column of comments that the rows lack.
    rows = [row[:width] for row in rows if len(row) in {width, width + 1}]
    units = [""] * width
    unit_texts = [""] * width
    if len(rows) > 1 and _are_units(cells=rows[-1], names=rows[-2]):
        units = [_unit_in_cell(cell) for cell in rows[-1]]
        unit_texts = [_without_brackets(cell) for cell in rows[-1]]
        rows = rows[:-1]
    column_names = [cell.strip(' "') for cell in rows[-1]] if rows else [""] * width
    # A unit that is not known stays with the name, so that it can be asked about.
    column_names = [
        f"{name} [{text}]" if text and not unit else name
        for name, text, unit in zip(column_names, unit_texts, units, strict=True)
    ]
    names: list[str] = []
    for index, name in enumerate(column_names):
        unique_name = name or f"column {index + 1}"
        while unique_name in names:
            unique_name += "'"
        names.append(unique_name)
    return names, units


def _are_units(cells: list[str], names: list[str]) -> bool:
    """Whether the cells of a header's last row are units: many are, or, unlike `names`, they repeat."""
    texts = [_without_brackets(cell) for cell in cells if cell.strip(' "')]
    known = sum(bool(unit_of(text)) for text in texts)
    if known >= max(1, len(cells) // 2):
        return True
    name_texts = [name for name in names if name.strip(' "')]
    return known > 0 and len(set(texts)) < len(texts) and len(name_texts) > len(texts) // 2


def _with_row_name(path: Path, header: list[str], rows: list[str], dialect: Dialect, width: int) -> list[str]:
    """Return the header with a name for a first column of row numbers, which R writes without one.

    A header that names fewer columns than the rows have does not state which one lacks its name.
    """
    if not header:
        return header
    names = _split_cells(header[-1], dialect)
    are_names = len(names) > 1 and all(name.strip() and not _is_number(name, dialect) for name in names)
    # A title may have a comma or two; a line with many names, or nearly as many as the rows, is a header.
    lacks_names = len(names) in (width - 1, width - 2) or _MIN_NAMES <= len(names) < width
    if not are_names or not lacks_names:
        return header
    first_column = [_split_cells(row, dialect)[0].strip(' "') for row in rows[:_LOOKED_AT]]
    row_numbers = [str(number) for number in range(1, 1 + len(first_column))]
    if len(names) == width - 1 and first_column == row_numbers:
        return [*header[:-1], f"row{dialect.separator}{header[-1]}"]
    number, row = next(
        (number, row) for number, row in enumerate(rows, 1) if _cell_count(row, dialect) == width
    )
    cause = f"{path}: the header names {len(names)} columns ({', '.join(names[:3])} ...)"
    # Every second cell would be the digits behind a decimal comma.
    fractions = {cell for each in rows[:_LOOKED_AT] for cell in _split_cells(each, dialect)[1::2]}
    if width == 2 * len(names) and all(cell.isdigit() for cell in fractions):
        raise FlightDataError(
            f"{cause}, and the rows have two cells for each: commas separate the columns, and are decimal "
            f"marks, too (row {number}: {row[:60]})",
            "write the numbers with points, or separate the columns with semicolons",
        )
    raise FlightDataError(
        f"{cause}, but the rows have {width} cells (first: row {number}: {row[:60]})",
        "give each column one name, and quote cells that contain the separator",
    )


def _refuse_other_header(path: Path, header: list[str], rows: list[str], dialect: Dialect) -> None:
    """Refuse a table with a second header among its `rows` that has the names of the first in another order.

    The columns below it have another meaning.
    """
    # The last line of the header has the names.
    names = [cell.strip(' "') for cell in _split_cells(header[-1], dialect)] if header else []
    for number, row in enumerate(rows, 1):  # counted below the header
        if not _WORD_FIRST.match(row):
            continue
        cells = [cell.strip(' "') for cell in _split_cells(row, dialect)]
        if cells != names and len(cells) >= _MIN_REORDERED and sorted(cells) == sorted(names):
            raise FlightDataError(
                f"{path}: the columns change their order at row {number}, where another header is "
                f"({row[:60]})",
                "cut the file there, and import both parts",
            )


def _unit_in_cell(cell: str) -> str:
    return unit_of(_without_brackets(cell))


def _without_brackets(cell: str) -> str:
    return cell.strip(' "[]()')
