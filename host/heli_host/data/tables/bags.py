"""MCAP files of other programs and bags of ROS 1 and 2, every number of every message a column."""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from heli_host.data.tables.limits import MAX_NUMBERS, MAX_ROWS, too_large, within_memory
from heli_host.data.tables.sizes import check_bag
from heli_host.data.tables.table import Column, Table
from heli_host.errors import FlightDataError, install_remedy
from heli_host.files import LOG_WRITER

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
    series_by_name: dict[str, tuple[array[float], array[float]]] = {}
    folder = path.parent if path.suffix == ".db3" else path
    with within_memory(path):
        try:
            for file in sorted(folder.iterdir()) if folder.is_dir() else [folder]:
                if file.suffix.lower() in (".mcap", ".bag"):
                    check_bag(file)
                elif file.suffix == ".zstd":
                    raise FlightDataError(f"{file} is compressed as a whole", "unpack it with zstd -d")
            with AnyReader([folder], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
                number_count = 0
                for count, (connection, recorded_ns, payload) in enumerate(reader.messages(), 1):
                    message = reader.deserialize(payload, connection.msgtype)
                    t_s = _stamp_s(message) or recorded_ns * 1e-9
                    for name, value in _numbers_in_message(connection.topic.strip("/"), message, 0):
                        times, values = series_by_name.setdefault(name, (array("d"), array("d")))
                        times.append(t_s)
                        values.append(value)
                        number_count += 2
                    if count > MAX_ROWS:
                        raise too_large(path, f"{MAX_ROWS // 1_000_000} million messages")
                    if number_count > MAX_NUMBERS:
                        raise too_large(path, f"{MAX_NUMBERS // 1_000_000} million numbers")
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
        return _table_of_series(path, series_by_name)


def _is_log(path: Path) -> bool:
    """Whether the header of an MCAP file says that `heli_host.data.log.writer` wrote it."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return LOG_WRITER.encode() in file.read(64)


def _table_of_series(
    path: Path, series_by_name: Mapping[str, tuple[Sequence[float], Sequence[float]]]
) -> Table:
    """Return a table of signals, each with its own times [s] since the first of all."""
    columns = {}
    first_s = min((times[0] for times, _ in series_by_name.values()), default=0.0)
    for name, (times, values) in series_by_name.items():
        t_s, indices = np.unique(np.asarray(times, np.float64) - first_s, return_index=True)
        columns[name] = Column(np.asarray(values, np.float64)[indices], "", t_s)
    if not columns:
        raise FlightDataError(f"{path} contains no numbers", "give a bag with the angles and the voltages")
    return Table(str(path), columns)


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
