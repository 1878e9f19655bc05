"""Reads logs, complete or cut short, into arrays.

The file is walked record by record; a record counts only when it is there to its last byte, and a chunk only
when its CRC fits, so a log that ends anywhere gives every tick up to its last whole chunk and never a wrong
one.
"""

from __future__ import annotations

import io
import json
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Metadata, Schema
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from heli_host.declaration import CHANNELS, ChannelSpec
from heli_host.errors import LogError, TruncatedLog
from heli_host.flight import OWN_COLUMNS, Flight, FlightEvent
from heli_host.link.channels import is_whole, rad_per_count
from heli_host.log.schema import (
    CDR_LITTLE_ENDIAN,
    EVENT_TOPIC,
    LINK_TOPIC,
    TICK_SCHEMA_NAME,
    TICK_TOPIC,
    MessageLayout,
    parse_layout,
    raw_ticks,
    tick_record,
)

_RECORD_HEADER = struct.Struct("<BQ")
_MESSAGE_HEADER = struct.Struct("<HIQQ")
_MAX_CHUNK_BYTES = 1 << 30
_SINGLE = 2.0**-23
"""What single precision rounds at most, as a share of the value."""
_BY_FIELD = {spec.field: spec for spec in CHANNELS}
_ANGLES = tuple(spec.column for spec in CHANNELS if spec.axis is not None)
_NEEDED_FIELDS = (
    "t_s",
    "tick",
    *_ANGLES,
    *(spec.field for spec in CHANNELS if spec.column in OWN_COLUMNS),
)
"""Fields that every version writes: a flight has columns of its own for them."""


@dataclass(frozen=True)
class Log:
    """What a log holds.

    Parameters
    ----------
    path : Path
        Where it was read from.
    ticks : structured ndarray (n,)
        One record a tick, with the fields of the log's own schema.
    events : tuple of dict
        Event messages in order of time: ``t_s``, ``tick``, ``name``, ``message``, ``level``.
    link : tuple of dict
        Link counters, about once a second.
    metadata : dict of dict
        Named records: ``session``, ``parameters``, ``plan``, ``result`` ...; the later of two values wins.
    notes : tuple of str
        What is wrong with the file, if anything: cut short, damaged chunks.
    complete : bool
        Whether the log was closed.
    """

    path: Path
    ticks: NDArray[Any]
    layout: MessageLayout
    events: tuple[dict[str, Any], ...]
    link: tuple[dict[str, Any], ...]
    metadata: Mapping[str, Mapping[str, str]]
    notes: tuple[str, ...]
    complete: bool

    @property
    def parameters(self) -> dict[str, float]:
        """The board's parameters by name; a damaged value raises `LogError`."""
        try:
            return {name: float(value) for name, value in self.metadata.get("parameters", {}).items()}
        except ValueError as error:
            raise LogError(f"{self.path} holds a parameter that is no number", "copy it again") from error

    @property
    def raw(self) -> NDArray[np.int32]:
        """Telemetry channels exactly as the board sent them, shape (n, channels)."""
        return raw_ticks(self.ticks)

    @property
    def ticks_lost(self) -> int:
        """Ticks missing between the first and the last; a restart of the board does not count."""
        step = np.diff(self.ticks["tick"]).view(np.int32).astype(np.int64)
        return int(np.sum(step[step > 0] - 1))

    def flight(self) -> Flight:
        """Return the log as a flight.

        Returns
        -------
        Flight
            Angles computed from the exact counts, setpoints and voltages in the board's own resolution. Other
            channels are in ``extra``, also those of a log by a version that has more of them.

        Raises
        ------
        LogError
            If the encoder parameters in the log are not numbers, or no tick was logged.
        """
        ticks = self.ticks
        if len(ticks) == 0:
            raise TruncatedLog(
                f"{self.path} holds no ticks", "the board was not heard, or the host died at once"
            )
        columns = self._columns()
        session = self.metadata.get("session", {})
        meta = {**session, **{f"result.{k}": v for k, v in self.metadata.get("result", {}).items()}}
        if self.notes:
            meta["notes"] = "\n".join(self.notes)
        return Flight(
            t_s=np.ascontiguousarray(ticks["t_s"]),
            **{name: column for name, column in columns.items() if name in OWN_COLUMNS},
            extra={
                name: column.astype(np.float64) for name, column in columns.items() if name not in OWN_COLUMNS
            },
            state_names=self.layout.names("STATE"),
            fault_names=self.layout.names("FAULT"),
            events=tuple(
                FlightEvent(float(event["t_s"]), str(event["name"]), str(event["message"]))
                for event in self.events
            ),
            parameters=self.parameters,
            plan="\n".join(self.metadata.get("plan", {}).values()),
            meta=meta,
        )

    def _columns(self) -> dict[str, NDArray[Any]]:
        """Every field but the time, in its unit, by the name that tables give it."""
        count_rad = rad_per_count(self.parameters)
        columns: dict[str, NDArray[Any]] = {}
        for field_name in self.ticks.dtype.names or ():
            spec = _BY_FIELD.get(field_name)
            if spec is not None:
                columns[spec.column] = self._column(spec, count_rad)
            elif field_name not in ("t_s", "tick", *_ANGLES):
                columns[field_name] = np.ascontiguousarray(self.ticks[field_name])
        return columns

    def _column(self, spec: ChannelSpec, count_rad: NDArray[np.float64]) -> NDArray[Any]:
        logged: NDArray[Any] = self.ticks[spec.field]
        if spec.axis is None and is_whole(spec):
            return np.ascontiguousarray(logged)
        if spec.axis is None:
            values = logged.astype(np.float64)
            exact = np.rint(values / spec.scale) * spec.scale
            # Of a log by a version with a finer scale nothing is rounded away.
            return np.where(np.abs(exact - values) <= _SINGLE * np.abs(values), exact, values)
        if np.isnan(count_rad[spec.axis]):
            return np.asarray(self.ticks[spec.column], np.float64)
        return np.asarray(logged * count_rad[spec.axis])


@dataclass
class _Parts:
    """A log while it is being walked."""

    path: Path
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    tick_channel: int = -1
    layout: MessageLayout | None = None
    record: np.dtype[Any] | None = None
    ticks: list[NDArray[Any]] = field(default_factory=list)
    events: list[dict[str, Any]] = field(default_factory=list)
    link: list[dict[str, Any]] = field(default_factory=list)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    damaged: int = 0


def read_log(path: str | Path) -> Log:
    """Read a log.

    Parameters
    ----------
    path : str or Path
        An MCAP file of this package, complete or cut short at any byte.

    Raises
    ------
    LogError
        If it cannot be read, is no MCAP file, or has no ticks of a helicopter in it.
    TruncatedLog
        If it ends before the first record that says what it is.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise LogError(f"cannot read {path}: {error.strerror or error}", "check the path") from error
    magic = bytes(MCAP0_MAGIC)
    if data[: len(magic)] != magic[: len(data)]:
        raise LogError(f"{path} is not an MCAP file", "give a log written by heli-host")
    parts = _Parts(path)
    end = _walk(memoryview(data), len(magic), parts)
    if parts.layout is None:
        if end is None:
            raise LogError(f"{path} has no topic {TICK_TOPIC}", "it is an MCAP file of another program")
        raise TruncatedLog(f"{path} ends within its first {len(data)} bytes", "nothing was recorded in it")
    ticks = np.concatenate(parts.ticks) if parts.ticks else np.zeros(0, parts.layout.dtype)
    notes = []
    if end is not None:
        notes.append(
            f"the log was not closed (it ends {len(data) - end} bytes into a record): "
            f"{len(ticks)} ticks were readable"
        )
    if parts.damaged:
        notes.append(f"{parts.damaged} chunks are damaged and were left out")
    return Log(
        path=path,
        ticks=ticks,
        layout=parts.layout,
        events=tuple(sorted(parts.events, key=lambda event: float(event["t_s"]))),
        link=tuple(parts.link),
        metadata=parts.metadata,
        notes=tuple(notes),
        complete=end is None,
    )


def _walk(data: memoryview, position: int, parts: _Parts) -> int | None:
    """Visit every whole record; return where the file breaks off, None when its footer was reached."""
    while position + _RECORD_HEADER.size <= len(data):
        opcode, length = _RECORD_HEADER.unpack_from(data, position)
        start = position + _RECORD_HEADER.size
        if length > len(data) - start:
            return position
        if opcode == Opcode.FOOTER:
            return None
        try:
            _visit(opcode, data[start : start + length], parts)
        except (McapError, zstandard.ZstdError, zlib.error, ValueError, struct.error, KeyError) as error:
            if opcode != Opcode.CHUNK:
                raise LogError(
                    f"{parts.path} is damaged at byte {position}: {error}", "copy it again"
                ) from error
            parts.damaged += 1
        position = start + length
    return position


def _visit(opcode: int, body: memoryview, parts: _Parts) -> None:
    if opcode == Opcode.CHUNK:
        _read_chunk(_parse(Chunk, body), parts)
    elif opcode == Opcode.SCHEMA:
        schema = _parse(Schema, body)
        parts.schemas[schema.id] = schema
    elif opcode == Opcode.CHANNEL:
        _add_channel(_parse(Channel, body), parts)
    elif opcode == Opcode.METADATA:
        metadata = _parse(Metadata, body)
        parts.metadata.setdefault(metadata.name, {}).update(metadata.metadata)


def _parse(kind: Any, body: memoryview) -> Any:
    return kind.read(ReadDataStream(io.BytesIO(body)))


def _add_channel(channel: Channel, parts: _Parts) -> None:
    parts.channels[channel.id] = channel
    if channel.topic != TICK_TOPIC or channel.id == parts.tick_channel:
        return
    schema = parts.schemas.get(channel.schema_id)
    if schema is None or schema.name != TICK_SCHEMA_NAME or schema.encoding != "ros2msg":
        raise LogError(
            f"{parts.path}: {TICK_TOPIC} is not written by heli-host", "give a log written by heli-host"
        )
    layout = parse_layout(schema.data.decode("utf-8", errors="replace"))
    missing = [name for name in _NEEDED_FIELDS if name not in (layout.dtype.names or ())]
    if missing:
        raise LogError(
            f"{parts.path} has no field {missing[0]} in its ticks", "read it with the version that wrote it"
        )
    parts.layout, parts.tick_channel = layout, channel.id
    parts.record = tick_record(layout)


def _read_chunk(chunk: Chunk, parts: _Parts) -> None:
    if chunk.uncompressed_size > _MAX_CHUNK_BYTES:
        raise ValueError("the chunk claims more than a gigabyte")
    if chunk.compression == "zstd":
        body = zstandard.ZstdDecompressor().decompress(chunk.data, max_output_size=chunk.uncompressed_size)
    elif chunk.compression == "":
        body = chunk.data
    else:
        raise LogError(f"{parts.path} is compressed by {chunk.compression}", "convert it to zstd")
    if len(body) != chunk.uncompressed_size or (
        chunk.uncompressed_crc and zlib.crc32(body) != chunk.uncompressed_crc
    ):
        raise ValueError("the chunk's CRC does not fit")
    ticks: list[NDArray[Any]] = []
    for item in _records(body, parts):
        if isinstance(item, np.ndarray):
            ticks.append(item)
            continue
        opcode, record = item
        if opcode == Opcode.MESSAGE:
            _add_json(record, parts)
        else:
            _visit(opcode, record, parts)
    parts.ticks += ticks


def _records(body: bytes, parts: _Parts) -> Iterator[NDArray[Any] | tuple[int, memoryview]]:
    """Yield runs of ticks as arrays and every other record with its opcode."""
    view = memoryview(body)
    position = 0
    while position < len(body):
        run = _tick_run(body, position, parts)
        if run is not None:
            yield run["payload"]
            position += run.nbytes
            continue
        opcode, length = _RECORD_HEADER.unpack_from(body, position)
        start = position + _RECORD_HEADER.size
        if length > len(body) - start:
            raise ValueError("a record reaches beyond its chunk")
        yield opcode, view[start : start + length]
        position = start + length


def _tick_run(body: bytes, position: int, parts: _Parts) -> NDArray[Any] | None:
    """Map the ticks that follow each other from ``position`` on; None when there is none."""
    record = parts.record
    if record is None:
        return None
    most = (len(body) - position) // record.itemsize
    if most == 0:
        return None
    rows = np.frombuffer(body, record, count=most, offset=position)
    ours = (
        (rows["opcode"] == int(Opcode.MESSAGE))
        & (rows["length"] == record.itemsize - _RECORD_HEADER.size)
        & (rows["channel"] == parts.tick_channel)
        & (rows["cdr"] == int.from_bytes(CDR_LITTLE_ENDIAN, "little"))
    )
    count = most if ours.all() else int(np.argmin(ours))
    return rows[:count] if count else None


def _add_json(record: memoryview, parts: _Parts) -> None:
    channel_id, *_ = _MESSAGE_HEADER.unpack_from(record)
    topic = parts.channels[channel_id].topic if channel_id in parts.channels else ""
    if topic not in (EVENT_TOPIC, LINK_TOPIC):
        return
    message = json.loads(bytes(record[_MESSAGE_HEADER.size :]))
    if not isinstance(message, dict) or not isinstance(message.get("t_s"), int | float):
        raise ValueError("a message without a time")
    if topic == LINK_TOPIC:
        parts.link.append(message)
    elif isinstance(message.get("name"), str) and isinstance(message.get("message"), str):
        parts.events.append(message)
