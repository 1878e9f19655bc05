"""Files of MATLAB, Octave and NumPy: matrices in rows or columns, structures, Simulink's time series."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from heli_host.data.arrays import Floats
from heli_host.data.tables.limits import check_mat, check_numbers, within_memory
from heli_host.data.tables.table import TIME_UNITS, Column, Table, unit_of
from heli_host.errors import FlightDataError

_DEEPEST: Final = 8
"""Structures within structures that are looked into."""
_MAX_SIGNALS: Final = 64
"""A matrix with more rows and more columns than this is an image or a law, not a recording."""
_MIN_ROWS: Final = 10
_TIMES: Final = ("time", "Time", "t", "tout", "Time_", "RowTimes")
_DATA: Final = ("signals", "Data", "Data_", "data", "values", "Values", "Storage_")
"""Fields with the data. A time series of newer releases has an empty `Data_`, and the data in `Storage_`."""


_OCTAVE: Final = b"# Created by Octave"
"""Beginning of a file that Octave saved as text, which is its default."""
_SCIPY: Final = b"MATLAB 5.0 MAT-file Platform:"
"""Beginning of a file that scipy wrote; MATLAB has a comma before the platform."""


def is_octave_text(path: Path) -> bool:
    """Whether the file at `path` is one that Octave saved as text."""
    try:
        with path.open("rb") as file:
            return file.read(len(_OCTAVE)) == _OCTAVE
    except OSError:
        return False


def read_mat(path: Path) -> Table:
    """Read the file at `path`: of MATLAB, version 4 to 7.3, Octave, or NumPy (`.npy`, `.npz`)."""
    with within_memory(path):
        return _read_signals(path)


def _read_signals(path: Path) -> Table:
    """Read all signals of a file, also those in structures and time series."""
    is_numpy = path.suffix.lower() in (".npy", ".npz")
    try:
        check_mat(path)
        content = _loaded(path)
    except FileNotFoundError as error:
        raise FlightDataError(f"cannot read {path}: there is no such file", "check the path") from error
    except (FlightDataError, MemoryError):
        raise
    except Exception as error:  # the reader raises whatever a damaged file makes it trip over
        program = "NumPy" if is_numpy else "Octave" if is_octave_text(path) else "MATLAB"
        raise FlightDataError(
            f"{path}: not a file of {program}, or damaged ({type(error).__name__})",
            "save arrays of numbers" if is_numpy else f"save it again in {program}",
        ) from error
    columns: dict[str, Column] = {}
    numbers = 0
    for name, value in content.items():
        if name.startswith("__"):
            continue  # scipy's notes on the file
        for signal_name, column in _signals_in(name, value, depth=0):
            # MATLAB stores small whole numbers in a byte; here each takes eight.
            numbers += column.values.size
            check_numbers(path, numbers)
            columns[_free_name(signal_name, columns)] = column
    if not columns:
        raise FlightDataError(
            f"{path}: the file has no signals of at least {_MIN_ROWS} rows", "save the logged signals in it"
        )
    columns = _with_one_time(columns)
    timed = [column for column in columns.values() if column.t_s is not None]
    if timed and len(timed) < len(columns):
        columns = _with_shared_times(columns, timed[0])
    return Table(str(path), columns)


def _with_one_time(columns: dict[str, Column]) -> dict[str, Column]:
    """Keep one of the equal times that QUARC writes into the first column of each matrix, as ``pitch[1]``."""
    times = [name for name in columns if name.endswith("[1]") and np.all(np.diff(columns[name].values) > 0.0)]
    same = [name for name in times if np.array_equal(columns[name].values, columns[times[0]].values)]
    if len(same) < 2:
        return columns
    others = {name: column for name, column in columns.items() if name not in same}
    return {_free_name("time", others): columns[same[0]], **others}


def _loaded(path: Path) -> Mapping[str, Any]:
    """Load all variables; scipy reads what scipy wrote, because mat-io cuts its texts with accents short."""
    if path.suffix.lower() == ".npy":
        return {"data": np.load(path, allow_pickle=False)}
    if path.suffix.lower() == ".npz":
        with np.load(path, allow_pickle=False) as arrays:
            return dict(arrays)
    if is_octave_text(path):
        return _octave_variables(path.read_text(encoding="utf-8", errors="replace"))
    with path.open("rb") as file:
        is_of_scipy = file.read(len(_SCIPY)) == _SCIPY
    content: Mapping[str, Any]
    if is_of_scipy:
        from scipy.io import loadmat

        content = loadmat(path)
    else:
        import matio

        content = matio.load_from_mat(str(path))
    return content


def _octave_variables(text: str) -> dict[str, Floats]:
    """Return the matrices in a text of Octave, by name; variables of other types are left out."""
    variables: dict[str, Floats] = {}
    for block in text.split("# name: ")[1:]:
        lines = block.splitlines()
        header = dict(
            line[2:].split(": ", 1) for line in lines[1:4] if line.startswith("# ") and ": " in line
        )
        if header.get("type") == "matrix" and {"rows", "columns"} <= header.keys():
            shape = int(header["rows"]), int(header["columns"])
            numbers = " ".join(lines[4 : 4 + shape[0]]).replace("NA", "nan").split()
            variables[lines[0].strip()] = np.array(numbers, np.float64).reshape(shape)
    return variables


def _with_shared_times(columns: Mapping[str, Column], timed: Column) -> dict[str, Column]:
    """Give each signal without times the times of `timed`, if it has as many rows; omit the other ones."""
    return {
        name: column if column.t_s is not None else Column(column.values, column.unit, timed.t_s)
        for name, column in columns.items()
        if column.t_s is not None or column.values.size == timed.values.size
    }


def _free_name(name: str, used_names: Mapping[str, Column]) -> str:
    """Return a name that is not used yet, by adding apostrophes."""
    while name in used_names:
        name += "'"
    return name


def _signals_in(name: str, value: Any, depth: int) -> Iterator[tuple[str, Column]]:
    """Yield each signal in a variable with its full name, such as ``logsout.pitch[2]``; `depth` is the number
    of variables around it.
    """
    if depth > _DEEPEST:
        return
    value = _unwrapped(value)
    if _is_frame(value):
        yield from _columns_of_frame(name, value)
        return
    fields = _fields_of(value)
    if fields is not None and np.ndim(value) > 0 and "Name" in fields:
        # Recordings of dSPACE: an array of structures, one per signal.
        for record in value.ravel()[:_MAX_SIGNALS]:
            unit = unit_of(_text_of(record["Unit"])) if "Unit" in fields else ""
            data = next((record[key] for key in _DATA if key in fields), None)
            for signal_name, column in _signals_in(_text_of(record["Name"]), data, depth + 1):
                yield signal_name, replace(column, unit=unit)
    elif fields is not None:
        yield from _signals_of_structure(name, fields, depth)
    elif isinstance(value, np.ndarray) and value.dtype == object:
        for index, element in enumerate(value.ravel()[:_MAX_SIGNALS]):
            yield from _signals_in(f"{name}[{index + 1}]", element, depth + 1)
    elif isinstance(value, (list, tuple)):
        for index, element in enumerate(value[:_MAX_SIGNALS]):
            yield from _signals_in(f"{name}[{index + 1}]", element, depth + 1)
    else:
        for index, signal, count in _columns_of_array(value):
            yield (f"{name}[{index + 1}]" if count > 1 else name), Column(signal)


def _signals_of_structure(name: str, fields: Mapping[str, Any], depth: int) -> Iterator[tuple[str, Column]]:
    """Yield the signals of a structure with their names, and with times if the structure has them.

    Times that repeat or fall are a column like the others, because signals cannot be brought to them.
    """
    t_s = _times_of(fields)
    if t_s is None:
        for key, field_value in fields.items():
            yield from _signals_in(f"{name}.{key}", field_value, depth + 1)
        return
    rising_t_s = t_s if np.all(np.diff(t_s) > 0.0) else None
    if rising_t_s is None:
        yield f"{name}.time", Column(t_s)
    for key in _DATA:
        if key not in fields:
            continue
        signals = [
            (label, signal)
            for label, signal in _signals_with_times(name, _unwrapped(fields[key]), t_s.size)
            if signal.size == t_s.size
        ]
        for label, signal in signals:
            yield label, Column(signal, t_s=rising_t_s)
        if signals:
            return
    # No known field has data for these times, so that any other field may.
    for key, field_value in fields.items():
        if key in _TIMES:
            continue
        # The times of a structure are those of the structures within it, too.
        for full_name, column in _signals_in(f"{name}.{key}", field_value, depth + 1):
            if column.t_s is not None:
                yield full_name, column
            elif column.values.size == t_s.size:
                yield full_name, replace(column, t_s=rising_t_s)


def _signals_with_times(name: str, value: Any, rows: int) -> Iterator[tuple[str, Floats]]:
    """Yield the signals in the data field of a structure with time: an array, or labelled structures. `rows`
    is the number of times.
    """
    if isinstance(value, np.ndarray) and value.dtype == object:
        for index, element in enumerate(value.ravel()[:_MAX_SIGNALS]):
            yield from _signals_with_times(
                f"{name}[{index + 1}]" if value.size > 1 else name, _unwrapped(element), rows
            )
        return
    if isinstance(value, (list, tuple)):
        for index, element in enumerate(value[:_MAX_SIGNALS]):
            yield from _signals_with_times(f"{name}[{index + 1}]", _unwrapped(element), rows)
        return
    if isinstance(value, np.ndarray) and value.dtype.names and value.size > 1:
        for index, record in enumerate(value.ravel()[:_MAX_SIGNALS]):
            record_fields = {key: record[key] for key in value.dtype.names}
            yield from _signals_with_times(f"{name}[{index + 1}]", record_fields, rows)
        return
    fields = _fields_of(value)
    if fields is not None:
        label = _text_of(fields.get("label")) or _text_of(fields.get("blockName")).rpartition("/")[2] or name
        data = next((fields[key] for key in ("values", "Data", "Data_") if key in fields), None)
        yield from _signals_with_times(label, _unwrapped(data), rows)
        return
    # A signal of several lines may list their names.
    labels = [label.strip() for label in name.split(",")]
    for index, signal, count in _columns_of_array(value, rows):
        element_name = labels[index] if len(labels) == count else f"{name}[{index + 1}]"
        yield (element_name if count > 1 else name), signal


def _columns_of_array(value: Any, rows: int | None = None) -> list[tuple[int, Floats, int]]:
    """Return the signals of an array of numbers: index, values, and number of signals.

    Signals may be columns or rows. If the number of rows is known, it decides; otherwise the longer side is
    the time.
    """
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiub" or not value.size:
        return []
    array = np.squeeze(value)
    if array.ndim == 2 and min(array.shape) > _MAX_SIGNALS:
        return []  # before a large matrix is copied
    array = array.astype(np.float64)
    if array.ndim > 2:
        # Simulink logs a signal of one row as 1 x 1 x n.
        array = array.reshape(-1, array.shape[-1])
    if array.ndim == 1:
        array = array[:, None]
    if array.ndim != 2:
        return []
    height, width = array.shape
    has_signals_in_rows = width > height if rows is None else height != rows and width == rows
    if has_signals_in_rows:
        array = array.T
    height, width = array.shape
    if height < _MIN_ROWS or width > _MAX_SIGNALS:
        return []
    return [(index, np.ascontiguousarray(array[:, index]), width) for index in range(width)]


def _times_of(fields: Mapping[str, Any]) -> Floats | None:
    """Return the times of the data in a structure, in the unit of the file; None without times.

    A structure with time has a field with the times. A time series has a field TimeInfo instead, with a list
    of times, or with the start, the step and the number of even times.
    """
    for key in _TIMES:
        if key in fields:
            signals = _columns_of_array(_unwrapped(fields[key]))
            if len(signals) == 1:
                ((_, times, _),) = signals
                return times
    time_info = _fields_of(_unwrapped(fields.get("TimeInfo", fields.get("TimeInfo_"))))
    if time_info is None:
        return None
    unit_s = TIME_UNITS.get(unit_of(_text_of(time_info.get("Units"))), 1.0)
    listed_times = _times_of(time_info)
    if listed_times is not None:
        return listed_times * unit_s
    try:
        start, step, count = (
            float(np.ravel(_unwrapped(time_info[key]))[0]) for key in ("Start", "Increment", "Length")
        )
    except (KeyError, IndexError, TypeError, ValueError):
        return None
    if not np.isfinite([start, step, count]).all() or step <= 0.0 or count < _MIN_ROWS:
        return None
    even_times: Floats = unit_s * (start + step * np.arange(int(count), dtype=np.float64))
    return even_times


def _unwrapped(value: Any) -> Any:
    """Return the element within arrays of one element, in which MATLAB wraps most values."""
    for _ in range(_DEEPEST):
        if isinstance(value, np.ndarray) and value.dtype == object and value.size == 1:
            value = value.ravel()[0]
        elif isinstance(value, np.ndarray) and value.dtype.names and value.size == 1:
            value = {key: value.ravel()[0][key] for key in value.dtype.names}
        else:
            break
    return value


def _fields_of(value: Any) -> Mapping[str, Any] | None:
    """Return the fields of a structure or object; None for another value."""
    if isinstance(value, Mapping):
        return value
    if isinstance(value, np.ndarray) and value.dtype.names:
        return {key: value[key] for key in value.dtype.names}
    properties = getattr(value, "properties", None)
    return properties if isinstance(properties, Mapping) else None


def _is_frame(value: Any) -> bool:
    return hasattr(value, "iloc") and hasattr(value, "columns")


def _columns_of_frame(name: str, frame: Any) -> Iterator[tuple[str, Column]]:
    """Yield the columns of a MATLAB table or timetable."""
    seconds = getattr(frame.index, "total_seconds", None)
    t_s = np.asarray(seconds(), np.float64) if seconds is not None else None
    for key in frame.columns:
        signals = _columns_of_array(np.asarray(frame[key]))
        if len(signals) == 1:
            yield f"{name}.{key}", Column(signals[0][1], "", t_s)


def _text_of(value: Any) -> str:
    """Return a text without the arrays around it; empty for another value."""
    value = _unwrapped(value)
    if isinstance(value, np.ndarray):
        value = "".join(map(str, value.ravel())) if value.dtype.kind in "US" else ""
    return value.strip() if isinstance(value, str) else ""
