"""Layout of a log's messages: one fixed layout per tick, JSON for all rarer messages.

Ticks are ROS 2 messages (``ros2msg`` schema, ``cdr`` encoding), because Foxglove, PlotJuggler and Rerun all
read this format. Each telemetry channel of the declaration is a field; the angle of an encoder follows its
count. Fields are ordered by size, so that CDR's alignment adds no padding, and the payload after its header
of four bytes is one numpy record. ROS 2 permits no capitals in field names, so volts are spelled ``_volt``.
"""

from __future__ import annotations

import json
import re
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heli_host.declaration import CHANNELS, Axis, Channel, ChannelSpec
from heli_host.errors import LogError
from heli_host.link.channels import ENCODERS, is_whole, numbers, physical, raw_numbers

TICK_TOPIC = "/heli/tick"
EVENT_TOPIC = "/heli/event"
LINK_TOPIC = "/heli/link"

TICK_SCHEMA_NAME = "heli_host/msg/Tick"
EVENT_SCHEMA_NAME = "foxglove.Log"
"""Foxglove's name for a log line, so that its Log panel lists the events; more properties are allowed."""
LINK_SCHEMA_NAME = "heli_host.Link"

CDR_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
"""Encapsulation header of every CDR message."""
FOOTER_BODY_BYTES = 20
"""Length of the record that ends a file, without its opcode and its length: two offsets and a CRC."""


EVENT_SCHEMA = json.dumps(
    {
        "title": EVENT_SCHEMA_NAME,
        "description": "Something that happened, with its reason",
        "type": "object",
        "properties": {
            "timestamp": {
                "type": "object",
                "title": "time",
                "properties": {
                    "sec": {"type": "integer", "minimum": 0},
                    "nsec": {"type": "integer", "minimum": 0, "maximum": 999999999},
                },
            },
            "level": {"type": "integer"},
            "message": {"type": "string"},
            "name": {"type": "string"},
            "t_s": {"type": "number"},
            "tick": {"type": "integer"},
        },
    },
    sort_keys=True,
)

LINK_SCHEMA = json.dumps(
    {
        "title": LINK_SCHEMA_NAME,
        "description": "Counters of both ends of the link, once a second",
        "type": "object",
        "properties": {"t_s": {"type": "number"}},
        "additionalProperties": {"type": "number"},
    },
    sort_keys=True,
)

LEVEL_INFO, LEVEL_WARNING, LEVEL_ERROR = 2, 3, 4
"""Levels of foxglove.Log."""

_TYPES = {
    "bool": "<u1",
    "byte": "<u1",
    "char": "<u1",
    "int8": "<i1",
    "uint8": "<u1",
    "int16": "<i2",
    "uint16": "<u2",
    "int32": "<i4",
    "uint32": "<u4",
    "int64": "<i8",
    "uint64": "<u8",
    "float32": "<f4",
    "float64": "<f8",
}
_FIELD = re.compile(r"(\w+)\s+(\w+)")
_CONSTANT = re.compile(r"(\w+)\s+([A-Z]\w*)\s*=\s*(-?\d+)")


@dataclass(frozen=True)
class MessageLayout:
    """Positions of the fields in a message of fixed size, and the constants that name its values."""

    dtype: np.dtype[Any]  # Structured type of one payload after the CDR header, with CDR's alignment
    constants: dict[str, int]  # Named constants of the schema, such as ``STATE_HOLD``

    def names(self, prefix: str) -> dict[int, str]:
        """Return lower-case names by value of the constants that start with ``prefix`` and an underscore."""
        constant_prefix = prefix + "_"
        return {
            value: name.removeprefix(constant_prefix).lower()
            for name, value in self.constants.items()
            if name.startswith(constant_prefix)
        }


def parse_layout(text: str) -> MessageLayout:
    """Read a ``ros2msg`` definition that has only numbers in it."""
    names: list[str] = []
    formats: list[str] = []
    offsets: list[int] = []
    constants: dict[str, int] = {}
    end = 0
    for source_line in text.splitlines():
        line = source_line.partition("#")[0].strip()
        if not line:
            continue
        constant = _CONSTANT.fullmatch(line)
        if constant is not None:
            _, name, value = constant.groups()
            constants[name] = int(value)
            continue
        match = _FIELD.fullmatch(line)
        type_name, name = match.groups() if match is not None else ("", "")
        code = _TYPES.get(type_name)
        if code is None or name in names:
            raise LogError(f"the log's schema has the line {line[:60]!r}", "give a log written by heli-host")
        size = np.dtype(code).itemsize
        offset = end + -end % size  # CDR aligns each number to its size
        names.append(name)
        formats.append(code)
        offsets.append(offset)
        end = offset + size
    layout = {"names": names, "formats": formats, "offsets": offsets, "itemsize": end}
    # numpy's types know a layout of literal keys only.
    return MessageLayout(np.dtype(layout), constants)  # type: ignore[call-overload]


def tick_record(layout: MessageLayout) -> np.dtype[Any]:
    """Return the layout of a whole MCAP message record that holds one tick."""
    return np.dtype(
        [
            ("opcode", "<u1"),
            ("length", "<u8"),
            ("channel", "<u2"),
            ("sequence", "<u4"),
            ("log_time_ns", "<u8"),
            ("publish_time_ns", "<u8"),
            ("cdr", "<u4"),
            ("payload", layout.dtype),
        ]
    )


_WORDS = {code: word for word, code in _TYPES.items() if word not in ("bool", "byte", "char")}


@dataclass(frozen=True)
class _Field:
    """One field of a tick: its numpy type, its description, and the constants that name its values."""

    code: str
    name: str
    meaning: str
    constants: str = ""


def _tick_fields() -> Iterator[_Field]:
    """Yield the fields of a tick: the times, each channel, and after each encoder's counts the angle."""
    yield _Field("<f8", "t_s", "seconds of device time since the first tick logged")
    yield _Field("<u4", "tick", "the board's tick counter, 1000 a second")
    declared: set[type] = set()
    for spec in CHANNELS:
        constants = ""
        if spec.kind is not None and spec.kind not in declared:
            declared.add(spec.kind)
            # The unit of such a channel names its enumeration: "enum state" gives STATE_IDLE=0.
            prefix = spec.unit.partition(" ")[2].upper()
            constants = "".join(f"uint8 {prefix}_{member.name}={member.value}\n" for member in spec.kind)
        yield _Field(_type_in_log(spec), spec.field, spec.meaning, constants)
        if spec.axis is not None:
            yield _Field("<f4", spec.column, f"{spec.field} by the parameters of the flight")


def _type_in_log(spec: ChannelSpec) -> str:
    """Return the numpy type of a channel in the log: that of the link for whole numbers, otherwise the
    smallest float from which the raw number can be restored.
    """
    number = np.dtype(spec.code)
    if is_whole(spec):
        return number.str.replace("|", "<")
    return "<f4" if number.itemsize < 4 else "<f8"


def _tick_schema() -> str:
    """Return the ROS 2 message definition of a tick, with the widest fields first: so none needs padding."""
    fields = sorted(_tick_fields(), key=lambda field: -np.dtype(field.code).itemsize)
    return (
        "# One control tick: angles read at its start, voltages that act from it until the next tick.\n"
        + "".join(
            f"{field.constants}{_WORDS[field.code]} {field.name}  # {field.meaning}\n" for field in fields
        )
    )


TICK_SCHEMA = _tick_schema()
TICK_LAYOUT = parse_layout(TICK_SCHEMA)
"""Layout that this version writes."""


def fill_ticks(
    into: NDArray[Any],
    t_s: NDArray[np.float64],
    tick: NDArray[np.uint32],
    raw: NDArray[np.int32],
    rad_per_count: NDArray[np.float64],
) -> None:
    """Write ticks into records of `TICK_LAYOUT`. Shapes: `into` (n,), `t_s` (n,), `tick` (n,), `raw` (n,
    channels), `rad_per_count` (axes,).
    """
    into["t_s"] = t_s
    into["tick"] = tick
    for channel, spec in zip(Channel, CHANNELS, strict=True):
        into[spec.field] = numbers(raw, channel) if is_whole(spec) else physical(raw, channel)
    for axis, channel in zip(Axis, ENCODERS, strict=True):
        into[CHANNELS[channel].column] = numbers(raw, channel) * rad_per_count[axis]


def raw_ticks(records: NDArray[Any]) -> NDArray[np.int32]:
    """Return the telemetry channels of logged ticks, exactly as the board sent them. Shapes: `records` (n,);
    returns (n, channels).
    """
    raw = np.empty((len(records), len(Channel)), np.int32)
    for channel, spec in zip(Channel, CHANNELS, strict=True):
        if spec.field not in (records.dtype.names or ()):
            raise LogError(
                f"the log has no channel {spec.name}", "read it with the heli-host version that wrote it"
            )
        raw[:, channel] = raw_numbers(records[spec.field], channel)
    return raw


HEAD = "head"
"""Name of the metadata record with the CRC of all bytes before it."""
RECORD_CRC = "(crc32)"
"""Key of a metadata record's own CRC; in brackets, because names of plans are keys too."""


def metadata_crc(name: str, values: Mapping[str, str]) -> str:
    """Return the CRC-32 of a metadata record, in hexadecimal digits."""
    # The CRC covers the name, then every key and value, each as a 32-bit length and UTF-8. The keys are
    # sorted, because a tool that copies a log may change their order.
    crc = _crc_after_text(0, name)
    for key in sorted(values):
        if key != RECORD_CRC:
            crc = _crc_after_text(_crc_after_text(crc, key), values[key])
    return f"{crc:08x}"


def head_values(head: bytes) -> dict[str, str]:
    """Return the content of the record `HEAD`."""
    return {"crc32": f"{zlib.crc32(head):08x}", "bytes": str(len(head))}


def _crc_after_text(crc: int, text: str) -> int:
    """Return a CRC after the length and the bytes of a text."""
    encoded = text.encode("utf-8", errors="surrogatepass")
    return zlib.crc32(encoded, zlib.crc32(struct.pack("<I", len(encoded)), crc))
