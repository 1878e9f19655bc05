"""A table from any file that may hold a flight; reads Parquet, spreadsheets, MCAP files and bags of ROS."""

from __future__ import annotations

import contextlib
import statistics
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from heli_host.data.arrays import Floats
from heli_host.data.files import LOG_WRITER
from heli_host.data.tables.limits import (
    MAX_BYTES,
    MAX_CELLS,
    MAX_NUMBERS,
    MAX_ROWS,
    check_bag,
    check_columns,
    check_numbers,
    check_parquet,
    check_workbook,
    too_large,
    within_memory,
)
from heli_host.data.tables.matlab import is_octave_text, read_mat
from heli_host.data.tables.table import Column, RowChange, Table, seconds_of, unit_of
from heli_host.data.tables.text import Dialect, numbers_of, read_text
from heli_host.errors import FlightDataError, install_remedy

if TYPE_CHECKING:
    import pandas
    import pyarrow
    from rosbags.highlevel import AnyReader


_MIN_SHARE: Final = 0.5
"""Share of numbers among the cells that are not blank, above which a column is read as numbers. A slower
signal leaves most of its cells blank."""


def read_parquet(path: Path) -> Table:
    """Read a Parquet file at `path`; a FlightDataError if it is something else, or unpacks to too much."""
    return _read_translating_errors(path, _parquet_frame, "Parquet")


def read_excel(path: Path) -> Table:
    """Read the longest sheet of a spreadsheet at `path`, with names above its columns.

    A FlightDataError states that there is none, or that it unpacks to too much.
    """
    return _read_translating_errors(path, _longest_sheet, "Excel")


def _parquet_frame(path: Path) -> pandas.DataFrame:
    """Read a Parquet file after its size in memory was checked."""
    import pyarrow.parquet

    with pyarrow.parquet.ParquetFile(path) as file:
        check_parquet(path, file)
        schema = file.schema_arrow
        texts = [field.name for field in schema if _is_text(field.type)]
        flat = [field.name for field in schema if not pyarrow.types.is_nested(field.type)]
    # Texts stay in their dictionary until their lengths are checked, because each row may refer to a long
    # one.
    with pyarrow.parquet.ParquetFile(path, read_dictionary=texts) as file:
        table = file.read(columns=flat, use_threads=False)
    for index, name in enumerate(table.column_names):
        column = table.column(index)
        if pyarrow.types.is_dictionary(column.type):
            longest = max(map(_longest_value_bytes, column.chunks), default=0)
            if longest * len(column) > MAX_BYTES:
                raise too_large(path, f"{MAX_BYTES >> 20} MiB in column '{name}'")
            table = table.set_column(index, name, column.cast(column.type.value_type))
    frame: pandas.DataFrame = table.to_pandas(use_threads=False)
    return frame


def _longest_value_bytes(chunk: pyarrow.DictionaryArray) -> int:
    """Bytes of the longest value that a row may name."""
    import pyarrow.compute

    values = chunk.dictionary
    if not _is_text(values.type):
        return 8
    return int(pyarrow.compute.max(pyarrow.compute.binary_length(values)).as_py() or 0)


def _is_text(kind: pyarrow.DataType) -> bool:
    """Whether a column of Parquet contains text or bytes."""
    import pyarrow

    text: bool = (
        pyarrow.types.is_string(kind)
        or pyarrow.types.is_large_string(kind)
        or pyarrow.types.is_binary(kind)
        or pyarrow.types.is_large_binary(kind)
    )
    return text


def _longest_sheet(path: Path) -> pandas.DataFrame:
    """Read the longest sheet of a workbook after its number of cells was checked."""
    import openpyxl
    import pandas

    check_workbook(path)
    longest: list[tuple[object, ...]] = []
    cell_count = 0
    with contextlib.closing(openpyxl.load_workbook(path, read_only=True, data_only=True)) as book:
        for sheet in book.worksheets:
            # A sheet states its own size, and a row its number: both may be anything.
            sheet.reset_dimensions()
            rows: list[tuple[object, ...]] = []
            for row in sheet.iter_rows(values_only=True):
                cell_count += max(1, len(row))  # an empty row takes time, too
                if cell_count > MAX_CELLS:
                    raise too_large(path, f"{MAX_CELLS // 1_000_000} million cells")
                if any(cell is not None for cell in row):
                    rows.append(row)
            # The flight is the longest table; other sheets hold notes and charts.
            if len(rows) > len(longest):
                longest = rows
    if not longest:
        return pandas.DataFrame()
    width = max(map(len, longest))
    check_columns(path, width)
    check_numbers(path, width * len(longest))
    names, start = _names_and_first_row(longest, width)
    body = (row + (None,) * (width - len(row)) for row in longest[start:])
    return pandas.DataFrame(body, columns=pandas.Index(names)).infer_objects()


def _names_and_first_row(rows: Sequence[tuple[object, ...]], width: int) -> tuple[list[str], int]:
    """Return the names of a sheet's columns, and the first row below them; titles above are skipped.

    The names are in the first row that is as wide as the table, or in the row above it, if that row contains
    no number. Otherwise, the columns have no names.
    """
    cells_per_row = [sum(cell is not None for cell in row) for row in rows]
    usual_width = statistics.mode(cells_per_row)
    first = next(index for index, count in enumerate(cells_per_row) if count >= usual_width)
    # A row of names may lack one or two of them.
    for index in (first, first - 1):
        name_count = sum(isinstance(cell, str) and not _is_number(cell) for cell in rows[index])
        if index >= 0 and name_count == cells_per_row[index] >= max(2, usual_width - 2):
            return _unique_names(rows[index], width), index + 1
    return _unique_names((), width), first


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True


def _unique_names(header_row: tuple[object, ...], width: int) -> list[str]:
    """Return the names of a sheet's columns; a repeated name gets an apostrophe."""
    names: list[str] = []
    for index in range(width):
        cell = header_row[index] if index < len(header_row) else None
        name = f"column {index + 1}" if cell is None else str(cell)
        while name in names:
            name += "'"
        names.append(name)
    return names


def _read_translating_errors(path: Path, reader: Callable[[Path], pandas.DataFrame], kind: str) -> Table:
    """Read a file by `reader`, and translate all errors to FlightDataErrors with a remedy."""
    if not path.is_file():
        raise FlightDataError(f"cannot read {path}: there is no such file", "check the path")
    with within_memory(path):
        try:
            frame = reader(path)
        except (FlightDataError, MemoryError):
            raise
        except ImportError as error:
            name = getattr(error, "name", None) or "pyarrow and openpyxl"
            raise FlightDataError(f"reading {path} needs {name}", install_remedy("import")) from error
        except Exception as error:  # the reader raises whatever a damaged file makes it trip over
            raise FlightDataError(f"{path}: not a {kind} file, or damaged", "save it again") from error
        return _numeric_table(path, frame)


def _numeric_table(path: Path, frame: pandas.DataFrame) -> Table:
    """Convert a data frame to a table of numbers; dates become seconds since the first row, and columns of
    text are left out.
    """
    import pandas

    columns: dict[str, Column] = {}
    unread: dict[str, str] = {}
    if frame.index.name is not None or not isinstance(frame.index, pandas.RangeIndex):
        frame = frame.reset_index()
    for name in frame.columns:
        series = frame[name]
        if pandas.api.types.is_datetime64_any_dtype(series) or pandas.api.types.is_timedelta64_dtype(series):
            column = Column((series - series.iloc[0]).dt.total_seconds().to_numpy(np.float64), "s")
        else:
            column = _column_of_cells(series)
        if _number_share(column.values, series) > _MIN_SHARE:
            columns[str(name)] = column
        elif series.notna().any():
            unread[str(name)] = str(series.dropna().iloc[-1])
    if not columns:
        raise FlightDataError(
            f"{path}: the file has no columns of numbers", "give a table with one row per sample"
        )
    return Table(str(path), columns, unread=unread)


def _column_of_cells(cells: pandas.Series) -> Column:
    """Read cells as numbers, or as times of a clock; most values are nan if they are neither."""
    import pandas

    values: Floats = pandas.to_numeric(cells, errors="coerce").to_numpy(np.float64)
    first, unit = cells.iloc[0] if len(cells) else None, ""
    if isinstance(first, str):
        # Below the names, a row may have the units.
        unit = unit_of(first.strip("[]() "))
        if _number_share(values, cells) <= _MIN_SHARE:
            decimal = "," if "," in first else "."
            values, cell_unit = numbers_of(cells, Dialect(separator=";", decimal=decimal))
            unit = cell_unit or unit
    if _number_share(values, cells) <= _MIN_SHARE and (clock_s := seconds_of(cells)) is not None:
        return Column(clock_s, "s")
    return Column(values, unit)


def _number_share(values: Floats, cells: pandas.Series) -> float:
    """Return the share of numbers among the cells that are not blank; 0 if all are blank."""
    return float(np.isfinite(values).sum() / max(1, int(cells.notna().sum())))


_MAX_VALUES: Final = 64
"""Longest array of a message whose elements become columns; scans and images have more."""
_MAX_DEPTH: Final = 6


def read_bag(path: Path) -> Table:
    """Read the bag at `path`: a `.bag` of ROS 1, a folder or `.db3` of ROS 2, or an MCAP file of either.

    Times are those in the header of the messages, or those of the recorder if a message has no header.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise FlightDataError(f"reading {path} needs rosbags", install_remedy("import")) from error
    if _is_log(path):
        raise FlightDataError(
            f"{path} is a log of heli-host and needs no import", "give the log itself to the other commands"
        )
    folder = path.parent if path.suffix == ".db3" else path
    with within_memory(path):
        try:
            for file in sorted(folder.iterdir()) if folder.is_dir() else [folder]:
                if file.suffix.lower() in (".mcap", ".bag"):
                    check_bag(file)
                elif file.suffix == ".zstd":
                    raise FlightDataError(f"{file} is compressed as a whole", "unpack it with zstd -d")
            with AnyReader([folder], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
                series = _series_of_messages(reader, path)
        except (FlightDataError, MemoryError):
            raise
        except Exception as error:  # a damaged file may cause any error in the reader
            if path.is_dir() and not (path / "metadata.yaml").exists():
                raise FlightDataError(
                    f"{path} is a folder without metadata.yaml, not a ROS 2 bag",
                    "give a file, or the folder of a bag",
                ) from error
            raise FlightDataError(
                f"{path}: not a bag that rosbags reads ({type(error).__name__}: {error})",
                "give a bag or an MCAP file; record the flight again if this one is damaged",
            ) from error
        delays_s, changes = _clock_differences(series.stamps)
        delays_by_name_s = {name: delays_s.get(topic, 0.0) for name, topic in series.topics.items()}
        return _table_of_series(path, series.by_name, delays_by_name_s, changes)


class _BagSeries(NamedTuple):
    """Numbers of a bag's messages, with their times [s]."""

    by_name: dict[str, tuple[array[float], array[float]]]  # Times and values by the name of the number
    topics: dict[str, str]  # Topic of each name
    stamps: dict[str, tuple[array[float], array[float]]]
    """Times of the messages of each topic: in the header, and at the recorder."""


def _series_of_messages(reader: AnyReader, path: Path) -> _BagSeries:
    """Read all numbers in the messages of a bag."""
    series = _BagSeries({}, {}, {})
    number_count = 0
    for message_count, (connection, recorded_ns, payload) in enumerate(reader.messages(), 1):
        message = reader.deserialize(payload, connection.msgtype)
        recorded_s = recorded_ns * 1e-9
        t_s = _stamp_s(message) or recorded_s
        stamped, recorded = series.stamps.setdefault(connection.topic, (array("d"), array("d")))
        stamped.append(t_s)
        recorded.append(recorded_s)
        for name, value in _numbers_in_message(connection.topic.strip("/"), message, depth=0):
            times, values = series.by_name.setdefault(name, (array("d"), array("d")))
            times.append(t_s)
            values.append(value)
            series.topics[name] = connection.topic
            number_count += 2  # the time and the value
        if message_count > MAX_ROWS:
            raise too_large(path, f"{MAX_ROWS // 1_000_000} million messages")
        if number_count > MAX_NUMBERS:
            raise too_large(path, f"{MAX_NUMBERS // 1_000_000} million numbers")
    return series


def _is_log(path: Path) -> bool:
    """Whether the header of an MCAP file says that `heli_host.data.log.writer` wrote it."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return LOG_WRITER.encode() in file.read(64)


_SAME_CLOCK_s: Final = 0.02
"""Largest difference between the delays of topics, from their stamps to the recorder, within which they have
one clock. Messages of one computer arrive within some milliseconds; two computers differ by more."""


def _clock_differences(
    stamps: Mapping[str, tuple[Sequence[float], Sequence[float]]],
) -> tuple[dict[str, float], list[RowChange]]:
    """Compare the stamps of each topic with the clock of the recorder.

    If all topics have stamps of one clock, their stamps are the times. Otherwise the stamps are moved to the
    recorder's clock by the median delay of their topic. Returns this move of each topic [s].
    """
    delays_s = {
        topic: float(np.median(np.subtract(recorded, stamped)))
        for topic, (stamped, recorded) in stamps.items()
    }
    if not delays_s or max(delays_s.values()) - min(delays_s.values()) < _SAME_CLOCK_s:
        return {}, []
    differing = ", ".join(f"{topic} by {delay_s:+.3f} s" for topic, delay_s in delays_s.items() if delay_s)
    rows = max(len(stamped) for stamped, _ in stamps.values())
    reason = f"of topics with different clocks: moved to the recorder's clock ({differing})"
    return delays_s, [RowChange("retimed", rows, reason)]


def _table_of_series(
    path: Path,
    series_by_name: Mapping[str, tuple[Sequence[float], Sequence[float]]],
    delays_s: Mapping[str, float],
    changes: Sequence[RowChange],
) -> Table:
    """Return a table of signals, each with its own times [s] since the first of all."""
    columns = {}
    first_s = min(
        (times[0] + delays_s.get(name, 0.0) for name, (times, _) in series_by_name.items()), default=0.0
    )
    moved = 0
    for name, (times, values) in series_by_name.items():
        t_s = np.asarray(times, np.float64) + delays_s.get(name, 0.0) - first_s
        order = np.argsort(t_s, kind="stable")
        moved = max(moved, int((order != np.arange(t_s.size)).sum()))
        columns[name] = Column(np.asarray(values, np.float64)[order], "", t_s[order])
    if not columns:
        raise FlightDataError(f"{path} contains no numbers", "give a bag with the angles and the voltages")
    if moved:
        changes = [*changes, RowChange("reordered", moved, "of the topic with most disorder: sorted by time")]
    return Table(str(path), columns, changes=tuple(changes))


def _stamp_s(message: Any) -> float:
    """Return the time in the header of a ROS 1 or ROS 2 message; 0 without a header."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    seconds = getattr(stamp, "sec", getattr(stamp, "secs", 0))
    return float(seconds) + 1e-9 * float(getattr(stamp, "nanosec", getattr(stamp, "nsecs", 0)))


def _numbers_in_message(name: str, value: Any, depth: int) -> Iterator[tuple[str, float]]:
    """Yield all numbers of a ROS message with their names, such as ``pose.position.x``; `depth` is the number
    of messages around it.
    """
    if isinstance(value, (bool, int, float, np.number)):
        yield name, float(value)
    elif isinstance(value, (list, tuple, np.ndarray)):
        labels = range(len(value)) if len(value) <= _MAX_VALUES else ()
        for index in labels:
            yield from _numbers_in_message(f"{name}[{index}]", value[index], depth + 1)
    elif depth < _MAX_DEPTH and hasattr(value, "__dataclass_fields__"):
        names = getattr(value, "name", None)
        for key in value.__dataclass_fields__:
            field = getattr(value, key)
            if key in {"header", "__msgtype__"} or isinstance(field, str):
                continue
            # Messages such as joint states contain the names of their elements.
            if isinstance(names, list) and key != "name" and len(field) == len(names):
                for label, element in zip(names, field, strict=True):
                    yield from _numbers_in_message(f"{name}.{label}.{key}", element, depth + 1)
            else:
                yield from _numbers_in_message(f"{name}.{key}", field, depth + 1)


KINDS = (
    ".csv .txt .tsv .dat .lvm .jsonl .json (.gz), .mat, .npy, .npz, .parquet, .mcap, .bag, .db3, .xlsx, "
    "or the folder of a ROS 2 bag"
)
"""Kinds of files that can be read, for messages."""


def read_table(path: Path) -> Table:
    """Read the file at `path`, of any kind of `KINDS`, as its name says."""
    name = path.name.lower().removesuffix(".gz")
    if path.is_dir() or name.endswith((".bag", ".db3", ".mcap")):
        return read_bag(path)
    if name.endswith((".mat", ".npy", ".npz")):
        return read_mat(path)
    if name.endswith((".parquet", ".pq")):
        return read_parquet(path)
    if name.endswith(".xlsx"):
        return read_excel(path)
    if name.endswith((".csv", ".txt", ".tsv", ".dat", ".log", ".asc", ".lvm", ".jsonl", ".json")):
        return read_mat(path) if is_octave_text(path) else read_text(path)
    raise FlightDataError(f"{path}: this kind of file cannot be imported", f"give {KINDS}")
