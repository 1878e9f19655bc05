"""A flight as an MCAP file of ROS 2: profile ``ros2``, every channel ``cdr`` with a ``ros2msg`` schema.

This export is needed because a log stores events and link counters as JSON, which ROS 2 tools cannot read.

ROS 2 permits no capitals in the names of fields: its parser, mcap-ros2-support and Foxglove refuse a schema
with ``front_V``. Therefore volts are spelled ``_volt`` as in a log, and other capitals become small letters.
The metadata record ``names`` gives the column of a table for each field.
"""

from __future__ import annotations

import itertools
import re
import struct
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from heli_host.data.files import replacing
from heli_host.data.flight import Flight, FlightEvent
from heli_host.data.log.schema import EVENT_TOPIC, TICK_TOPIC
from heli_host.declaration import CHANNELS
from heli_host.errors import LogWriteError
from heli_host.link.channels import is_whole

PROFILE: Final = "ros2"
PARAMETER_TOPIC: Final = "/heli/parameter"

_CDR: Final = b"\x00\x01\x00\x00"
_ROS_TYPES: Final = {
    "u1": "uint8", "u2": "uint16", "u4": "uint32", "i1": "int8", "i2": "int16", "i4": "int32", "i8": "int64",
    "f4": "float32", "f8": "float64", "b1": "bool",
}  # fmt: skip
_INTEGER_TYPES: Final = {
    (spec.field if spec.axis is not None else spec.column): np.dtype(spec.code)
    for spec in CHANNELS
    if is_whole(spec) or spec.axis is not None
}
"""Types of the channels that are whole numbers, which a flight holds as floats."""
_EVENT_SCHEMA: Final = """\
# Something that happened, with its reason; rcl_interfaces/Log, as rosout has it.
byte DEBUG=10
byte INFO=20
byte WARN=30
byte ERROR=40
byte FATAL=50
builtin_interfaces/Time stamp
uint8 level
string name
string msg
string file
string function
uint32 line
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
_PARAMETER_SCHEMA: Final = """\
# A parameter of the board, as it was when the flight began.
string name
float64 value
"""
_INFO: Final = 20
_ERROR: Final = 40


def export_ros2(flight: Flight, path: str | Path) -> None:
    """Write a flight as an MCAP file of ROS 2.

    Rows are ``heli_host/msg/Tick`` messages on ``/heli/tick``, with one field per column, including the
    counts of the encoders. Events are ``rcl_interfaces/msg/Log`` on ``/heli/event``. Parameters are
    ``heli_host/msg/Parameter`` on ``/heli/parameter``. Plan and notes are metadata. Times are those of the
    flight, which start at 0. The same flight gives the same bytes.

    Parameters
    ----------
    path : str or Path
        ``.mcap`` file to write.

    Raises
    ------
    LogWriteError
        If it cannot be written.
    """
    from mcap.well_known import MessageEncoding, SchemaEncoding
    from mcap.writer import CompressionType, Writer

    columns_by_size = _columns_by_size(flight)
    fields = _field_names(name for name, _ in columns_by_size)
    columns = {fields[name]: column for name, column in columns_by_size}
    try:
        with replacing(path) as unfinished, unfinished.open("wb") as file:
            writer = Writer(file, compression=CompressionType.ZSTD)
            writer.start(profile=PROFILE, library="heli_host")

            def channel(topic: str, name: str, schema: str) -> int:
                schema_id = writer.register_schema(name, SchemaEncoding.ROS2, schema.encode())
                return int(writer.register_channel(topic, MessageEncoding.CDR, schema_id))

            def add_message(channel_id: int, time_ns: int, data: bytes) -> None:
                writer.add_message(channel_id, log_time=time_ns, data=data, publish_time=time_ns)

            tick_channel = channel(TICK_TOPIC, "heli_host/msg/Tick", _tick_schema(flight, columns))
            event_channel = channel(EVENT_TOPIC, "rcl_interfaces/msg/Log", _EVENT_SCHEMA)
            parameter_channel = channel(PARAMETER_TOPIC, "heli_host/msg/Parameter", _PARAMETER_SCHEMA)
            first_ns = _to_ns(flight.t_s[0]) if len(flight) else 0
            for name, value in flight.parameters.items():
                name_field = _encode_string(name)
                padding = bytes(-len(name_field) % 8)  # CDR aligns a float64 to its size
                add_message(
                    parameter_channel, first_ns, _CDR + name_field + padding + struct.pack("<d", value)
                )
            for message in _messages_in_order(flight, columns):
                channel_id = event_channel if message.is_event else tick_channel
                add_message(channel_id, message.time_ns, message.data)
            notes = {name: str(value) for name, value in flight.meta.items()}
            writer.add_metadata("notes", notes)
            writer.add_metadata("names", {field: name for name, field in fields.items()})
            writer.add_metadata("plan", {"plan": flight.plan})
            writer.finish()  # type: ignore[no-untyped-call]  # mcap has no types here
    except OSError as error:
        raise LogWriteError(
            f"cannot write {path}: {error.strerror or error}", "choose another folder"
        ) from error


def _columns_by_size(flight: Flight) -> list[tuple[str, NDArray[Any]]]:
    """Return the columns of a flight, the largest type first, so that CDR's alignment adds no padding."""
    # A column of whole numbers gets its integer type if no value changes.
    typed_columns = []
    for name, column in flight.columns().items():
        integer_type = _INTEGER_TYPES.get(name)
        is_lossless = integer_type is not None and bool(np.all(column == column.astype(integer_type)))
        typed_columns.append((name, column.astype(integer_type) if is_lossless else column))
    return sorted(typed_columns, key=lambda name_and_column: -name_and_column[1].dtype.itemsize)


def _field_names(columns: Iterable[str]) -> dict[str, str]:
    """Return a unique, valid ROS 2 field name for each column, such as ``front_volt`` for ``front_V``."""
    fields: dict[str, str] = {}
    for name in columns:
        valid_name = re.sub(r"_V$", "_volt", name).lower()
        valid_name = re.sub(r"[^a-z0-9]+", "_", valid_name).strip("_")
        valid_name = valid_name if valid_name[:1].isalpha() else f"column_{valid_name}".rstrip("_")
        candidates = (f"{valid_name}_n{suffix}" if suffix else valid_name for suffix in itertools.count())
        fields[name] = next(field for field in candidates if field not in fields.values())
    return fields


def _tick_schema(flight: Flight, columns: dict[str, NDArray[Any]]) -> str:
    """Return the ROS 2 message definition of a row, with the names of states and faults as constants."""
    lines = ["# One row of a flight: angles read at t_s, voltages that act from it until the next row."]
    for prefix, names in (("STATE", flight.state_names), ("FAULT", flight.fault_names)):
        lines += [
            f"uint8 {prefix}_{re.sub(r'[^A-Z0-9]', '_', name.upper())}={number}"
            for number, name in sorted(names.items())
        ]
    lines += [f"{_ROS_TYPES[column.dtype.str[1:]]} {name}" for name, column in columns.items()]
    return "\n".join(lines) + "\n"


class _Message(NamedTuple):
    """A row or an event, as it stands in the file."""

    time_ns: int
    data: bytes
    is_event: bool


def _messages_in_order(flight: Flight, columns: dict[str, NDArray[Any]]) -> Iterator[_Message]:
    """Yield rows and events in the order of time; an event comes before a row of the same time."""
    dtype = np.dtype([(name, column.dtype.newbyteorder("<")) for name, column in columns.items()])
    records = np.zeros(len(flight), dtype)
    for name, column in columns.items():
        records[name] = column
    data, size = records.tobytes(), dtype.itemsize
    events = sorted(flight.events, key=lambda event: event.t_s)
    events_written = 0
    for row, time_s in enumerate(flight.t_s.tolist()):
        while events_written < len(events) and events[events_written].t_s <= time_s:
            yield _message_of_event(events[events_written])
            events_written += 1
        yield _Message(_to_ns(time_s), _CDR + data[row * size : (row + 1) * size], is_event=False)
    for event in events[events_written:]:
        yield _message_of_event(event)


def _message_of_event(event: FlightEvent) -> _Message:
    return _Message(_to_ns(event.t_s), _encode_event(event), is_event=True)


def _encode_event(event: FlightEvent) -> bytes:
    """Encode an event as a ``rcl_interfaces/msg/Log`` message in CDR."""
    seconds, nanoseconds = divmod(_to_ns(event.t_s), 1_000_000_000)
    body = struct.pack("<iIB", seconds, nanoseconds, _ERROR if event.name == "fault" else _INFO)
    for text in (event.name, event.text, "", ""):
        body += bytes(-len(body) % 4) + _encode_string(text)
    return _CDR + body + bytes(-len(body) % 4) + struct.pack("<I", 0)


def _encode_string(text: str) -> bytes:
    """Encode a string in CDR: its length, then its bytes with a zero at the end."""
    encoded = text.encode() + b"\x00"
    return struct.pack("<I", len(encoded)) + encoded


def _to_ns(t_s: float) -> int:
    return max(0, round(t_s * 1e9))
