"""The declaration as Python: constants, enumerations, tables, messages and samples."""

from __future__ import annotations

import json

from firmware.generator import channels
from firmware.generator.declared import (
    STRUCT_CODE,
    Table,
    axes,
    camel,
    full_fields,
    link_hash,
    param_id,
    params_hash,
    rows,
)
from firmware.generator.laws import python_laws

PY_TYPE = {"f32": "float"}


def enum_class(name: str, base: str, doc: str, members: list[tuple[str, int, str]]) -> list[str]:
    """Return the class of an enumeration or a set of bits; `members` are name, number and meaning."""
    out = ["", f"class {name}({base}):", f'    """{doc}"""', ""]
    out += [f"    {k.upper()} = {v}  # {meaning}" for k, v, meaning in members]
    return [*out, ""]


def values_of(entries: Table, key: str) -> list[tuple[str, int, str]]:
    """Return the members of an enumeration (key ``value``) or a set of bits (``bit``)."""
    return [(k, 1 << e[key] if key == "bit" else e[key], e["meaning"]) for k, e in rows(entries)]


def positions(entries: list[Table]) -> list[tuple[str, int, str]]:
    """Return the rows of a table as members of an enumeration, numbered from 0."""
    return [(e["name"], number, f"{e['unit']}: {e['meaning']}") for number, e in enumerate(entries)]


def type_of(channel: Table) -> str:
    """Return the Python type of one value of a channel."""
    kind = channels.numbers_of(channel)
    if kind is not None:
        return camel(kind)
    return "int" if is_whole(channel) else "float"


def is_whole(channel: Table) -> bool:
    """Whether the values of a channel are its raw numbers."""
    return channels.axis_of(channel) is None and float(channel["scale"]) == 1.0


def unit_of(channel: Table) -> str:
    """Return the unit of a channel in brackets, for a docstring; empty without a unit."""
    unit = "rad" if channels.axis_of(channel) else channel["unit"]
    return f" [{unit}]" if unit and channels.numbers_of(channel) is None else ""


def values_class(declared: list[Table]) -> list[str]:
    """Return the class with the values of one tick."""
    out = ["", "@dataclass(frozen=True)", "class ChannelValues:"]
    out += ['    """The values of all channels in one tick, each in its unit."""', ""]
    out += ["    tick: int  # Device time [tick], unwrapped beyond 2^32"]
    return [
        *out,
        *(f"    {channels.column(c)}: {type_of(c)}  # {c['meaning']}{unit_of(c)}" for c in declared),
        "",
    ]


def arrays_class(declared: list[Table]) -> list[str]:
    """Return the class with the values of many ticks."""

    def dtype(channel: Table) -> str:
        sign = "uint" if channel["type"].startswith("u") else "int"
        return f"{sign}{channel['type'][1:]}" if is_whole(channel) else "float64"

    out = ["", "@dataclass(frozen=True)", "class ChannelArrays:"]
    out += [
        '    """The values of all channels in many ticks, as in `ChannelValues`: arrays of shape (n,).',
        "",
    ]
    out += ["    A gap in `tick` means that ticks were lost.", '    """', "", "    tick: NDArray[np.int64]"]
    return [*out, *(f"    {channels.column(c)}: NDArray[np.{dtype(c)}]" for c in declared), ""]


def generate_python(declaration: Table) -> str:
    """Return the text of host/heli_host/declaration.py."""
    lines = [
        *_head(declaration),
        *_BASES.split("\n"),
        *_enumerations(declaration),
        *_SPEC_CLASSES.split("\n"),
        *_parameter_table(declaration),
        *_fault_table(declaration),
        *_channel_table(declaration),
        *values_class(declaration["channel"]),
        *arrays_class(declaration["channel"]),
        *python_laws(declaration),
        *(line for message in declaration["message"] for line in _message_class(message)),
    ]
    return "\n".join(lines)


def _head(declaration: Table) -> list[str]:
    """Return the module docstring, the imports and the constants of the link."""
    link = declaration["link"]
    return [
        '"""Messages, channels, parameters and faults of the link.',
        "",
        "Written by firmware/generate.py from firmware/link.toml. Do not edit.",
        '"""',
        "",
        "from __future__ import annotations",
        "",
        "import struct",
        "from dataclasses import dataclass",
        "from enum import IntEnum, IntFlag",
        "from typing import TYPE_CHECKING, ClassVar, Self",
        "",
        "if TYPE_CHECKING:",
        "    import numpy as np",
        "    from numpy.typing import NDArray",
        "",
        f"LINK_HASH = 0x{link_hash(declaration):08X}",
        f"PARAMS_HASH = 0x{params_hash(declaration):08X}",
        f'LINK_VERSION = "{link["version"]}"',
        f'FIRMWARE_VERSION = "{link["firmware"]}"',
        f"PROTOCOL = {link['protocol']}",
        f"BAUD = {link['baud']}",
        f"TICK_US = {link['tick_us']}",
        f"MAX_COMMAND_PAYLOAD = {link['max_command_payload']}",
        f"MAX_TELEMETRY_PAYLOAD = {link['max_telemetry_payload']}",
        "",
        f"SETPOINT_MARGIN_DEG = {json.dumps(declaration['setpoint_margin'])}",
        '"""Distances between the setpoints that the board accepts and these parameters, in degrees."""',
        "",
    ]


def _enumerations(declaration: Table) -> list[str]:
    """Return the declared enumerations, and those of the rows of each table."""
    lines: list[str] = []
    for name, entries in declaration["enums"].items():
        lines += enum_class(camel(name), "Name", entries["meaning"], values_of(entries, "value"))
    for name, entries in declaration["bits"].items():
        lines += enum_class(camel(name), "IntFlag", entries["meaning"], values_of(entries, "bit"))
    faults = [(fault["name"], fault["code"], fault["meaning"]) for fault in declaration["fault"]]
    lines += enum_class("Fault", "Name", "Fault codes.", [("none", 0, "no fault"), *faults])
    lines += enum_class(
        "Param", "Name", "Position of each parameter in the table.", positions(declaration["param"])
    )
    lines += enum_class(
        "Channel", "Name", "Position of each telemetry channel.", positions(declaration["channel"])
    )
    ids = [(message["name"], message["id"], message["meaning"]) for message in declaration["message"]]
    lines += enum_class("MessageId", "Name", "Second byte of a frame.", ids)
    names = ", ".join(json.dumps(axis) for axis in axes(declaration))
    return [
        *lines,
        "",
        f"AXES: tuple[str, ...] = ({names},)",
        '"""Names of the axes in the order of `Axis`."""',
        "",
    ]


_BASES = '''
class Name(IntEnum):
    """A declared number, which prints as its name in link.toml."""

    def __str__(self) -> str:
        return self.name.lower()


class Message:
    """A message of the link: a dataclass whose fields have the layout of `STRUCT`, in order."""

    __slots__: tuple[str, ...] = ()
    ID: ClassVar[IntEnum]
    STRUCT: ClassVar[struct.Struct]

    def pack(self) -> bytes:
        """Return the payload bytes."""
        return self.STRUCT.pack(*(getattr(self, name) for name in self.__slots__))

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        """Read the fixed fields from the start of ``payload``."""
        return cls(*cls.STRUCT.unpack_from(payload))

'''
"""Base classes: names of numbers, and messages as bytes."""

_SPEC_CLASSES = '''
@dataclass(frozen=True, slots=True)
class ParamSpec:
    """One row of the parameter table; ``min``, ``max`` and ``default`` are in ``unit``."""

    index: int
    name: str
    unit: str
    min: float
    max: float
    default: float
    nonzero: bool
    integer: bool
    idle_only: bool
    id: int
    meaning: str


@dataclass(frozen=True, slots=True)
class FaultSpec:
    """One fault: its number, the parameter that set its limit, and what to do."""

    code: int
    name: str
    kind: str
    parameter: str | None
    meaning: str
    remedy: str


@dataclass(frozen=True, slots=True)
class ChannelSpec:
    """One telemetry channel: value = raw * scale, in ``unit``."""

    name: str  # Name in `Channel`, in lower case
    code: str  # Type on the wire, as a format of `struct`
    unit: str
    scale: float  # Value of the raw number 1, in `unit`
    column: str  # Name in samples, flights and tables; for an encoder, that of its angle in rad
    field: str  # Name in a log
    axis: Axis | None  # Axis whose encoder the channel counts; None for other channels
    kind: type[IntEnum] | type[IntFlag] | None  # What its numbers name; None for plain numbers
    meaning: str

'''
"""Classes for the rows of the tables of parameters, faults and channels."""


def _parameter_table(declaration: Table) -> list[str]:
    """Return the table of parameters."""
    lines = ["PARAMS: tuple[ParamSpec, ...] = ("]
    for index, param in enumerate(declaration["param"]):
        values = [index, param["name"], param["unit"]]
        values += [float(param["min"]), float(param["max"]), float(param["default"])]
        values += [param.get("nonzero", False), param.get("integer", False), param["when"] == "idle"]
        values += [param_id(param), param["meaning"]]
        lines.append(f"    ParamSpec({', '.join(json_or_bool(value) for value in values)}),")
    return [*lines, ")", ""]


def _fault_table(declaration: Table) -> list[str]:
    """Return the table of faults."""
    lines = ["FAULTS: tuple[FaultSpec, ...] = ("]
    for fault in declaration["fault"]:
        values = [fault["code"], fault["name"], fault["kind"]]
        values += [fault.get("parameter"), fault["meaning"], fault["remedy"]]
        lines.append(f"    FaultSpec({', '.join(json_or_bool(value) for value in values)}),")
    return [*lines, ")", ""]


def _channel_table(declaration: Table) -> list[str]:
    """Return the table of telemetry channels."""
    lines = ["CHANNELS: tuple[ChannelSpec, ...] = ("]
    for channel in declaration["channel"]:
        axis, kind = channels.axis_of(channel), channels.numbers_of(channel)
        values = [channel["name"], "<" + STRUCT_CODE[channel["type"]], channel["unit"]]
        values += [float(channel["scale"]), channels.column(channel), channels.field(channel)]
        literals = [json_or_bool(value) for value in values]
        literals += [f"Axis.{axis.upper()}" if axis else "None", camel(kind) if kind else "None"]
        literals.append(json_or_bool(channel["meaning"]))
        lines.append(f"    ChannelSpec({', '.join(literals)}),")
    return [*lines, ")", ""]


def _message_class(message: Table) -> list[str]:
    """Return the class of a message: its number, its layout and its fields."""
    fields = full_fields(message)
    struct_format = "<" + "".join(STRUCT_CODE[field["type"]] for field in fields)
    name = camel(message["name"]) + "Message"
    lines = ["", "@dataclass(frozen=True, slots=True)", f"class {name}(Message):"]
    lines += [f'    """{message["meaning"]}"""', ""]
    lines.append(f"    ID: ClassVar[MessageId] = MessageId.{message['name'].upper()}")
    lines.append(f'    STRUCT: ClassVar[struct.Struct] = struct.Struct("{struct_format}")')
    if message["kind"] == "command":
        lines.append(f"    REPLY: ClassVar[MessageId] = MessageId.{message['reply'].upper()}")
    for field in fields:
        unit = f" [{field['unit']}]" if field["unit"] else ""
        lines.append(f"    {field['name']}: {PY_TYPE.get(field['type'], 'int')}  # {field['meaning']}{unit}")
    return [*lines, ""]


def json_or_bool(value: object) -> str:
    """Return a value as a Python literal."""
    if isinstance(value, bool) or value is None:
        return str(value)
    return json.dumps(value, ensure_ascii=False)
