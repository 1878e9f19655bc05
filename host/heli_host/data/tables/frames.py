"""Parquet and spreadsheets, by pandas."""

from __future__ import annotations

import contextlib
import statistics
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from heli_host.data.tables.clocks import seconds_of
from heli_host.data.tables.limits import MAX_BYTES, check_columns, check_numbers, too_large, within_memory
from heli_host.data.tables.sizes import MAX_CELLS, check_parquet, check_workbook
from heli_host.data.tables.table import Column, Table
from heli_host.data.tables.units import unit_of
from heli_host.errors import FlightDataError, install_remedy

if TYPE_CHECKING:
    import pandas
    import pyarrow

_MIN_SHARE = 0.5
"""Smallest share of numbers in a column from which it is read as numbers."""


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
    cells = 0
    with contextlib.closing(openpyxl.load_workbook(path, read_only=True, data_only=True)) as book:
        for sheet in book.worksheets:
            # A sheet states its own size, and a row its number: both may be anything.
            sheet.reset_dimensions()
            rows: list[tuple[object, ...]] = []
            for row in sheet.iter_rows(values_only=True):
                cells += max(1, len(row))
                if cells > MAX_CELLS:
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
    if frame.index.name is not None or isinstance(frame.index, pandas.DatetimeIndex | pandas.TimedeltaIndex):
        frame = frame.reset_index()
    for name in frame.columns:
        series, unit = frame[name], ""
        if pandas.api.types.is_datetime64_any_dtype(series) or pandas.api.types.is_timedelta64_dtype(series):
            values = (series - series.iloc[0]).dt.total_seconds().to_numpy(np.float64)
            unit = "s"
        else:
            first = series.iloc[0] if len(series) else None
            if isinstance(first, str):
                unit = unit_of(first.strip("[]() "))
            values = pandas.to_numeric(series, errors="coerce").to_numpy(np.float64)
            at_s = None if np.isfinite(values).mean() > _MIN_SHARE else seconds_of(series)
            if at_s is not None:
                values, unit = at_s, "s"
        if np.isfinite(values).mean() > _MIN_SHARE:
            columns[str(name)] = Column(values, unit)
    if not columns:
        raise FlightDataError(
            f"{path}: the file has no columns of numbers", "give a table with one row per sample"
        )
    return Table(str(path), columns)
