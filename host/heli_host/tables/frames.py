"""Parquet and spreadsheets, by pandas."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from heli_host.errors import FlightDataError
from heli_host.tables.clocks import seconds_of
from heli_host.tables.table import Column, Table
from heli_host.tables.units import unit_of

if TYPE_CHECKING:
    import pandas

_LEAST_SHARE = 0.5
"""Share of a column's cells that must be numbers for it to be one of numbers."""


def read_parquet(path: Path) -> Table:
    """Read a Parquet file at `path`; a FlightDataError where it is none."""
    import pandas

    return _table(path, _read(path, pandas.read_parquet, "Parquet"))


def read_excel(path: Path) -> Table:
    """Read the first sheet of a spreadsheet at `path`, names in its first row; a FlightDataError where there
    is none.
    """
    import pandas

    return _table(path, _read(path, pandas.read_excel, "Excel"))


def _read(path: Path, reader: Callable[[Path], pandas.DataFrame], kind: str) -> pandas.DataFrame:
    if not path.is_file():
        raise FlightDataError(f"cannot read {path}: there is no such file", "check the path")
    try:
        return reader(path)
    except ImportError as error:
        name = getattr(error, "name", None) or "pyarrow and openpyxl"
        raise FlightDataError(f"reading {path} needs {name}", "pip install 'heli-host[import]'") from error
    except Exception as error:  # the reader raises whatever a damaged file makes it trip over
        raise FlightDataError(f"{path}: not a file of {kind}, or a damaged one", "save it again") from error


def _table(path: Path, frame: pandas.DataFrame) -> Table:
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
            at_s = None if np.isfinite(values).mean() > _LEAST_SHARE else seconds_of(series)
            if at_s is not None:
                values, unit = at_s, "s"
        if np.isfinite(values).mean() > _LEAST_SHARE:
            columns[str(name)] = Column(values, unit)
    if not columns:
        raise FlightDataError(f"{path}: no columns of numbers in it", "give a table: one row a sample")
    return Table(str(path), columns)
