"""Write a recording into a file: texts, MATLAB files, spreadsheets, Parquet, and bags of ROS 2."""

from __future__ import annotations

import datetime
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from heli_benchmark.zoo.case import LogCase, LoggedColumn, Recording


def write_log(case: LogCase, folder: Path) -> Path:
    """Write the file of a case into a folder; return its path."""
    folder.mkdir(parents=True, exist_ok=True)
    # Separate draws: the faults of lines do not depend on how many draws the recording took.
    rng = np.random.default_rng([case.seed, case.number, 1])
    return _WRITERS[case.container](case, folder, rng)


def _row_order(case: LogCase, rng: np.random.Generator) -> list[int]:
    """Order in which the rows are in the file: swapped, repeated, or the newest first."""
    count = case.recording.true_s.size
    rows = list(range(count))
    if "swapped rows" in case.row_faults:
        for index in rng.choice(count - 1, max(3, count // 400), replace=False):
            rows[index], rows[index + 1] = rows[index + 1], rows[index]
    if "duplicated rows" in case.row_faults:
        for index in sorted(rng.choice(count, max(3, count // 300), replace=False), reverse=True):
            rows.insert(int(index), rows[int(index)])
    if "reversed" in case.row_faults:
        rows.reverse()
    return rows


def _text_cells(recording: Recording) -> tuple[list[str], list[list[str]]]:
    """Return names, and the cells of each column as texts."""
    names, cells = [], []
    if recording.has_clock:
        names.append(recording.clock_name)
        cells.append(
            list(recording.clock_texts)
            or [_number(value, recording.clock_decimals) for value in recording.clock]
        )
    for column in recording.columns:
        names.append(column.name)
        cells.append([_number(value, column.decimals) for value in column.values])
    return names, cells


def _number(value: float, decimals: int) -> str:
    """Write a number with fixed decimals, or with significant digits if `decimals` is negative."""
    if not math.isfinite(value):
        return ""
    return f"{value:.{decimals}f}" if decimals >= 0 else f"{value:.{-decimals}g}"


def _write_text(case: LogCase, folder: Path, rng: np.random.Generator) -> Path:
    recording = case.recording
    separator, decimal = tuple(case.dialect)
    names, cells = _text_cells(recording)
    if separator == " ":
        # A space in a name or an empty cell would move all further cells.
        names = [name.replace(" ", "_") for name in names]
        cells = [[cell or "nan" for cell in column] for column in cells]
    if decimal == ",":
        # Times that are written as texts stay; they are the first column.
        text_columns = 1 if recording.clock_texts else 0
        numeric = [[cell.replace(".", ",") for cell in column] for column in cells[text_columns:]]
        cells = cells[:text_columns] + numeric
    header = [separator.join(names)] if recording.has_header else []
    if recording.unit_row:
        units = [recording.clock_unit] if recording.has_clock else []
        units += [column.unit for column in recording.columns]
        header.append(separator.join(unit or "-" for unit in units))
    rows = [separator.join(column[row] for column in cells) for row in _row_order(case, rng)]
    lines = header + _damaged(rows, header, separator, case, rng)
    if rng.random() < 0.25:
        # Notes of the logger.
        lines = ["# Helicopter log, firmware 1.4", "# operator: lab 3", *lines]
    path = folder / f"{recording.name}.{case.container}"
    encoding = "latin-1" if rng.random() < 0.15 and _is_latin(lines) else "utf-8"
    bom = "\ufeff" if encoding == "utf-8" and rng.random() < 0.15 else ""
    end = "\r\n" if rng.random() < 0.3 else "\n"
    path.write_bytes((bom + end.join(lines) + end).encode(encoding))
    return path


def _is_latin(lines: list[str]) -> bool:
    """Whether Latin-1 has all characters of the header, the only lines with words."""
    try:
        "".join(lines[:4]).encode("latin-1")
    except UnicodeEncodeError:
        return False
    return True


def _damaged(
    rows: list[str], header: list[str], separator: str, case: LogCase, rng: np.random.Generator
) -> list[str]:
    """Add damaged copies of lines; all lines themselves stay in the file."""
    count = max(2, round(len(rows) * float(rng.uniform(0.002, 0.02))))
    lines = list(rows)

    def insert(texts: list[str]) -> None:
        """Put damaged lines between intact lines."""
        for text in texts:
            # The first and last lines stay intact: the import finds header and format in them.
            lines.insert(int(rng.integers(5, len(lines) - 5)), text)

    def some_rows() -> list[str]:
        return [rows[int(index)] for index in rng.integers(0, len(rows), count)]

    if "truncated lines" in case.row_faults:
        texts = []
        for text in some_rows():
            # At least one cell is lost entirely, so that the line shows its damage.
            width = text.count(separator)
            keep = int(rng.integers(1, max(2, width)))
            cells = text.split(separator)[:keep]
            cells[-1] = cells[-1][: max(1, len(cells[-1]) - 1)]
            texts.append(separator.join(cells))
        insert(texts)
    if "merged lines" in case.row_faults:
        insert([text + rows[int(rng.integers(0, len(rows)))] for text in some_rows()])
    if "garbage" in case.row_faults:
        insert(
            ["\x00\x17" + "".join(chr(int(code)) for code in rng.integers(33, 127, 24)) for _ in range(count)]
        )
    if "repeated header" in case.row_faults:
        insert([header[0]] * min(count, 3))
    if "error cells" in case.row_faults:
        texts = []
        for text in some_rows():
            cells = text.split(separator)
            cells[int(rng.integers(1, len(cells)))] = ("ERR", "---", "#VALUE!")[int(rng.integers(3))]
            texts.append(separator.join(cells))
        insert(texts)
    return lines


def _write_mat(case: LogCase, folder: Path, rng: np.random.Generator) -> Path:
    from scipy.io import savemat

    recording = case.recording
    rows = _row_order(case, rng)
    columns = {column.name: column.values[rows] for column in recording.columns}
    clock = recording.clock[rows] if recording.has_clock else None
    path = folder / f"{recording.name}.mat"
    # Simulink's own structures, the last two, have times in seconds.
    forms = ("vectors", "structure", "timeseries", "scope")
    form = forms[int(rng.integers(4 if recording.clock_unit == "s" else 2))]
    if not recording.has_header:
        # Columns without names share the empty name, so that a mapping by names would lose them.
        cells = [column.values[rows] for column in recording.columns]
        stacked = np.array([*([clock] if clock is not None else []), *cells])
        savemat(path, {"data": stacked if rng.random() < 0.5 else stacked.T})
        return path
    variables = {_matlab_name(name): values for name, values in columns.items()}
    if clock is None or form == "vectors":
        times = {} if clock is None else {_matlab_name(recording.clock_name): clock}
        as_rows = rng.random() < 0.5
        content = {
            name: values[None, :] if as_rows else values[:, None]
            for name, values in {**times, **variables}.items()
        }
        # A workspace also has variables that are not columns: here feedback gains and a sampling time.
        savemat(path, {**content, "K": np.eye(2, 6), "Ts": 1.0 / max(case.rate_Hz, 1.0)})
    elif form == "structure":
        savemat(path, {"log": {_matlab_name(recording.clock_name): clock, **variables}})
    elif form == "timeseries":
        items = {
            name: {"Time": clock[:, None], "Data": values[:, None]} for name, values in variables.items()
        }
        savemat(path, {"logsout": items})
    else:
        signals = [
            {"values": values[:, None], "dimensions": 1.0, "label": name} for name, values in columns.items()
        ]
        savemat(path, {"ScopeData": {"time": clock[:, None], "signals": signals}})
    return path


def _matlab_name(name: str) -> str:
    """Make a name that MATLAB accepts."""
    letters = name.translate(str.maketrans("öäüøå", "oauoa")).replace("°", "deg")
    clean = "".join(char if char.isascii() and char.isalnum() else "_" for char in letters).strip("_")
    while "__" in clean:
        clean = clean.replace("__", "_")
    return clean[:60]


def _write_xlsx(case: LogCase, folder: Path, rng: np.random.Generator) -> Path:
    import openpyxl

    recording = case.recording
    book = openpyxl.Workbook(write_only=True)
    sheet = book.create_sheet("data")
    if rng.random() < 0.3:
        sheet.append(["Helicopter, lab 3"])
        sheet.append([])
    has_clock = recording.has_clock
    sheet.append([*([recording.clock_name] if has_clock else []), *(c.name for c in recording.columns)])
    if recording.unit_row:
        sheet.append([*([recording.clock_unit] if has_clock else []), *(c.unit for c in recording.columns)])
    for row in _row_order(case, rng):
        cells: list[Any] = [_excel_time(recording, row)] if has_clock else []
        cells += [
            None if not math.isfinite(c.values[row]) else round(float(c.values[row]), max(c.decimals, 0))
            for c in recording.columns
        ]
        sheet.append(cells)
    path = folder / f"{recording.name}.xlsx"
    book.save(path)
    return path


def _excel_time(recording: Recording, row: int) -> Any:
    value = float(recording.clock[row])
    if recording.clock_unit == "datetime":
        return datetime.datetime.fromtimestamp(value, datetime.UTC).replace(tzinfo=None)
    return float(_number(value, recording.clock_decimals))


def _write_parquet(case: LogCase, folder: Path, rng: np.random.Generator) -> Path:
    import pandas

    recording = case.recording
    rows = _row_order(case, rng)
    content: dict[str, Any] = {}
    as_index = rng.random() < 0.4
    if recording.has_clock:
        clock = recording.clock[rows]
        content[recording.clock_name] = (
            pandas.to_datetime((clock * 1e6).round().astype("int64"), unit="us")
            if recording.clock_unit == "datetime"
            else clock
        )
    kind = np.float32 if rng.random() < 0.4 else np.float64
    content |= {column.name: column.values[rows].astype(kind) for column in recording.columns}
    frame = pandas.DataFrame(content)
    if as_index and recording.clock_unit == "datetime":
        frame = frame.set_index(recording.clock_name)
    path = folder / f"{recording.name}.parquet"
    frame.to_parquet(path)
    return path


def _write_bag(case: LogCase, folder: Path, rng: np.random.Generator) -> Path:
    """Write topics of angles, voltages and extra columns."""
    # The angles have stamps of their sensor; the voltages have a header, or none. With `two clocks`, the
    # clock of the stamps differs from that of the recorder by a constant.
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    recording = case.recording
    store = get_typestore(Stores.ROS2_HUMBLE)
    path = folder / recording.name
    plugin = StoragePlugin.MCAP if case.container == "mcap" else StoragePlugin.SQLITE3
    start_s = 1.71e9 + float(rng.uniform(0.0, 1e7))
    kind = recording.clock_kind
    clock_offset_s = float(rng.uniform(-0.6, 0.6)) if kind == "two clocks" else 0.0
    count = recording.true_s.size
    # Messages reach the recorder some milliseconds after they were stamped.
    transport_s = 0.0008 + rng.exponential(0.0006, count)
    if kind == "recorder":
        transport_s = 0.001 + 0.0002 * rng.random(count)
    groups: dict[str, list[LoggedColumn]] = {}
    for column in recording.columns:
        group = "angles" if column.group in ("elevation", "pitch", "travel") else "motors"
        groups.setdefault("extra" if column.group == "extra" else group, []).append(column)
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        senders: list[Callable[[int, float, float], None]] = []
        for group, columns in groups.items():
            is_stamped = kind == "stamps" or (kind == "two clocks" and group == "angles")
            senders.append(_sender(writer, store, group, columns, is_stamped))
        for row in range(count):
            true_s = start_s + float(recording.true_s[row])
            for send in senders:
                send(row, true_s + float(transport_s[row]), true_s + clock_offset_s)
    if case.container == "mcap":
        return next(path.glob("*.mcap"))
    return path


def _sender(
    writer: Any, store: Any, group: str, columns: list[LoggedColumn], is_stamped: bool
) -> Callable[[int, float, float], None]:
    """Return a function that writes the message of a row: row, time of the recorder, time of the stamp."""
    types = store.types
    if is_stamped:
        kind = "sensor_msgs/msg/JointState"
        connection = writer.add_connection(f"/heli/{group}", kind, typestore=store)
        names = [column.name for column in columns]

        def send(row: int, recorded_s: float, stamp_s: float) -> None:
            seconds = int(stamp_s)
            stamp = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=int((stamp_s - seconds) * 1e9))
            header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="heli")
            values = np.array([column.values[row] for column in columns], np.float64)
            empty = np.zeros(0)
            message = types[kind](header=header, name=names, position=values, velocity=empty, effort=empty)
            writer.write(connection, int(recorded_s * 1e9), store.serialize_cdr(message, kind))

        return send
    kind = "std_msgs/msg/Float64"
    connections = [
        writer.add_connection(f"/heli/{_matlab_name(column.name).lower()}", kind, typestore=store)
        for column in columns
    ]

    def send_single(row: int, recorded_s: float, stamp_s: float) -> None:
        del stamp_s  # this message has no field for it
        for column, connection in zip(columns, connections, strict=True):
            message = types[kind](data=float(column.values[row]))
            writer.write(connection, int(recorded_s * 1e9), store.serialize_cdr(message, kind))

    return send_single


_WRITERS: Final[Mapping[str, Callable[[LogCase, Path, np.random.Generator], Path]]] = {
    "csv": _write_text,
    "txt": _write_text,
    "mat": _write_mat,
    "xlsx": _write_xlsx,
    "parquet": _write_parquet,
    "mcap": _write_bag,
    "ros2": _write_bag,
}
