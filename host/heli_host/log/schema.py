"""What a log's messages look like: one fixed layout a tick, JSON for the rare rest.

Ticks are ROS 2 messages (``ros2msg`` schema, ``cdr`` encoding), chosen because Foxglove, PlotJuggler and
Rerun all read it; of ROS 1 encodings Rerun reads none and PlotJuggler's author has dropped support. Fields
are ordered by size, so that CDR's alignment adds no padding and the payload maps onto one numpy record behind
its four-byte header. ROS 2 takes no capitals in field names (Foxglove refuses the whole schema): volts are
spelled ``_volt``.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heli_host.errors import LogError
from heli_host.link.declaration import CHANNELS, Fault, Flags, State

TICK_TOPIC = "/heli/tick"
EVENT_TOPIC = "/heli/event"
LINK_TOPIC = "/heli/link"

TICK_SCHEMA_NAME = "heli_host/msg/Tick"
EVENT_SCHEMA_NAME = "foxglove.Log"
"""Foxglove's name for a log line, so that its Log panel lists the events; more properties are allowed."""
LINK_SCHEMA_NAME = "heli_host.Link"

CDR_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
"""Encapsulation header of every CDR message."""


def _constants(prefix: str, numbers: type[State] | type[Fault] | type[Flags]) -> str:
    return "".join(f"uint8 {prefix}_{item.name}={item.value}\n" for item in numbers)


TICK_SCHEMA = (
    "# One control tick: angles read at its start, voltages that act from it until the next tick.\n"
    "float64 t_s  # seconds of device time since the first tick logged\n"
    "uint32 tick  # the board's tick counter, 1000 a second\n"
    "int32 elevation_count  # encoder counts as read: the exact measurement\n"
    "int32 pitch_count\n"
    "int32 travel_count\n"
    "float32 elevation_rad\n"
    "float32 pitch_rad\n"
    "float32 travel_rad\n"
    "float32 elevation_setpoint_rad  # setpoints that the control law used\n"
    "float32 pitch_setpoint_rad\n"
    "float32 travel_setpoint_rad\n"
    "float32 front_volt  # voltages that acted, after every limit\n"
    "float32 back_volt\n"
    + _constants("STATE", State)
    + "uint8 state  # supervisor state\n"
    + _constants("FAULT", Fault)
    + "uint8 fault  # 0 while none\n"
    + _constants("FLAG", Flags)
    + "uint8 flags  # bits\n"
)

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
    """Where the fields of a fixed-size message are, and the constants that name its values.

    Parameters
    ----------
    dtype : numpy.dtype
        Structured type of one payload behind the CDR header, with CDR's alignment.
    constants : dict of str to int
        Named constants of the schema, such as ``STATE_HOLD``.
    """

    dtype: np.dtype[Any]
    constants: dict[str, int]

    def names(self, prefix: str) -> dict[int, str]:
        """Return lower-case names by value of the constants that start with ``prefix`` and an underscore.

        Parameters
        ----------
        prefix : str
            ``STATE``, ``FAULT`` or ``FLAG``.

        Returns
        -------
        dict of int to str
        """
        mark = prefix + "_"
        return {
            value: name.removeprefix(mark).lower()
            for name, value in self.constants.items()
            if name.startswith(mark)
        }


def parse_layout(text: str) -> MessageLayout:
    """Read a ``ros2msg`` definition that has only numbers in it.

    Parameters
    ----------
    text : str
        The definition, one field or constant a line.

    Returns
    -------
    MessageLayout

    Raises
    ------
    LogError
        If it has a field that is not a plain number: an array, a string or another message.
    """
    names: list[str] = []
    formats: list[str] = []
    offsets: list[int] = []
    constants: dict[str, int] = {}
    end = 0
    for raw in text.splitlines():
        line = raw.partition("#")[0].strip()
        if not line:
            continue
        constant = _CONSTANT.fullmatch(line)
        if constant is not None:
            constants[constant.group(2)] = int(constant.group(3))
            continue
        match = _FIELD.fullmatch(line)
        code = _TYPES.get(match.group(1)) if match is not None else None
        if match is None or code is None or match.group(2) in names:
            raise LogError(f"the log's schema has the line {line[:60]!r}", "it is not a log of this package")
        size = np.dtype(code).itemsize
        offset = -(-end // size) * size
        names.append(match.group(2))
        formats.append(code)
        offsets.append(offset)
        end = offset + size
    layout = {"names": names, "formats": formats, "offsets": offsets, "itemsize": end}
    return MessageLayout(np.dtype(layout), constants)  # type: ignore[call-overload]


def tick_record(layout: MessageLayout) -> np.dtype[Any]:
    """Return the layout of a whole MCAP message record that holds one tick.

    Parameters
    ----------
    layout : MessageLayout
        Layout of the tick itself.

    Returns
    -------
    numpy.dtype
        Structured, with the tick as ``payload``.
    """
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


TICK_LAYOUT = parse_layout(TICK_SCHEMA)
"""Layout that this version writes."""

_COUNT_FIELDS = ("elevation_count", "pitch_count", "travel_count")
_ANGLE_FIELDS = ("elevation_rad", "pitch_rad", "travel_rad")
_SETPOINT_FIELDS = ("elevation_setpoint_rad", "pitch_setpoint_rad", "travel_setpoint_rad")
_VOLTAGE_FIELDS = ("front_volt", "back_volt")
_BYTE_FIELDS = ("state", "fault", "flags")


def fill_ticks(
    into: NDArray[Any],
    t_s: NDArray[np.float64],
    tick: NDArray[np.uint32],
    raw: NDArray[np.int32],
    rad_per_count: NDArray[np.float64],
) -> None:
    """Write ticks into records of `TICK_LAYOUT`.

    Parameters
    ----------
    into : structured ndarray (n,)
        Records to fill.
    t_s : ndarray (n,)
        Time of each tick in seconds.
    tick : ndarray of uint32 (n,)
        The board's tick numbers.
    raw : ndarray of int32 (n, 11)
        Telemetry channels in the declared order.
    rad_per_count : ndarray (3,)
        Size of a count of elevation, pitch and travel.
    """
    into["t_s"] = t_s
    into["tick"] = tick
    for axis in range(3):
        into[_COUNT_FIELDS[axis]] = raw[:, axis]
        into[_ANGLE_FIELDS[axis]] = raw[:, axis] * rad_per_count[axis]
        into[_SETPOINT_FIELDS[axis]] = physical(raw, 3 + axis)
    for motor in range(2):
        into[_VOLTAGE_FIELDS[motor]] = physical(raw, 6 + motor)
    for index in range(3):
        into[_BYTE_FIELDS[index]] = raw[:, 8 + index]


def physical(raw: NDArray[np.int32], channel: int) -> NDArray[np.float64]:
    """Return a telemetry channel in its unit.

    Parameters
    ----------
    raw : ndarray of int32 (n, 11)
        Telemetry channels in the declared order.
    channel : int
        Which one.

    Returns
    -------
    ndarray (n,)
        Its values, in the unit that the declaration gives it.
    """
    return raw[:, channel].astype(np.float64) * CHANNELS[channel].scale


def _unscaled(values: NDArray[Any], channel: int) -> NDArray[np.float64]:
    """Undo `physical`: float32 tells setpoints of 1e-5 rad apart up to 83 rad, travel is bound to 63."""
    return np.rint(values.astype(np.float64) / CHANNELS[channel].scale)


def raw_ticks(records: NDArray[Any]) -> NDArray[np.int32]:
    """Return the telemetry channels of logged ticks, exactly as the board sent them.

    Parameters
    ----------
    records : structured ndarray (n,)
        Logged ticks.

    Returns
    -------
    ndarray of int32 (n, 11)
        Channels in the declared order.
    """
    raw = np.empty((len(records), 11), np.int32)
    for axis in range(3):
        raw[:, axis] = records[_COUNT_FIELDS[axis]]
        raw[:, 3 + axis] = _unscaled(records[_SETPOINT_FIELDS[axis]], 3 + axis)
    for motor in range(2):
        raw[:, 6 + motor] = _unscaled(records[_VOLTAGE_FIELDS[motor]], 6 + motor)
    for index in range(3):
        raw[:, 8 + index] = records[_BYTE_FIELDS[index]]
    return raw
