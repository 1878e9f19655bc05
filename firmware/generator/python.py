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
    """The lines of an enumeration or of a set of bits."""
    out = ["", f"class {name}({base}):", f'    """{doc}"""', ""]
    out += [f"    {k.upper()} = {v}  # {meaning}" for k, v, meaning in members]
    out.append("")
    if base == "IntEnum":
        out += ["    def __str__(self) -> str:", "        return self.name.lower()", ""]
    return out


def values_of(entries: Table, key: str) -> list[tuple[str, int, str]]:
    """Members of an enumeration (key ``value``) or of a set of bits (``bit``)."""
    return [(k, 1 << e[key] if key == "bit" else e[key], e["meaning"]) for k, e in rows(entries)]


def positions(entries: list[Table]) -> list[tuple[str, int, str]]:
    """Members of an enumeration of a table's rows."""
    return [(e["name"], number, f"{e['unit']}: {e['meaning']}") for number, e in enumerate(entries)]


def type_of(channel: Table) -> str:
    """Python's type of one value of a channel."""
    kind = channels.numbers_of(channel)
    if kind is not None:
        return camel(kind)
    return "int" if is_whole(channel) else "float"


def is_whole(channel: Table) -> bool:
    """Whether its values are the raw numbers themselves."""
    return channels.axis_of(channel) is None and float(channel["scale"]) == 1.0


def unit_of(channel: Table) -> str:
    """The unit of its column, for a docstring."""
    unit = "rad" if channels.axis_of(channel) else channel["unit"]
    return f" [{unit}]" if unit and channels.numbers_of(channel) is None else ""


def values_class(declared: list[Table]) -> list[str]:
    """The lines of the class that holds one tick."""
    out = [
        "",
        "@dataclass(frozen=True)",
        "class ChannelValues:",
        '    """Every channel of one tick, in its unit.',
    ]
    out += ["", "    Parameters", "    ----------", "    tick : int"]
    out.append("        Device time [tick], counted on over 2^32.")
    for c in declared:
        out += [f"    {channels.column(c)} : {type_of(c)}", f"        {c['meaning']}{unit_of(c)}"]
    out += ['    """', "", "    tick: int"]
    return [*out, *(f"    {channels.column(c)}: {type_of(c)}" for c in declared), ""]


def arrays_class(declared: list[Table]) -> list[str]:
    """The lines of the class that holds many ticks."""

    def dtype(channel: Table) -> str:
        sign = "uint" if channel["type"].startswith("u") else "int"
        return f"{sign}{channel['type'][1:]}" if is_whole(channel) else "float64"

    out = ["", "@dataclass(frozen=True)", "class ChannelArrays:"]
    out += ['    """Every channel of many ticks, in its unit: one array a channel, one entry a tick.', ""]
    out += ["    Parameters", "    ----------", "    tick : ndarray of int64, shape (n,)"]
    out.append("        Device time [tick], counted on over 2^32; a gap is a loss.")
    for c in declared:
        out.append(f"    {channels.column(c)} : ndarray of {dtype(c)}, shape (n,)")
        out.append(f"        {c['meaning']}{unit_of(c)}")
    out += ['    """', "", "    tick: NDArray[np.int64]"]
    return [*out, *(f"    {channels.column(c)}: NDArray[np.{dtype(c)}]" for c in declared), ""]


def generate_python(d: Table) -> str:
    """Text of host/heli_host/declaration.py."""
    link = d["link"]
    out = [
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
        "from typing import TYPE_CHECKING, ClassVar",
        "",
        "if TYPE_CHECKING:",
        "    import numpy as np",
        "    from numpy.typing import NDArray",
        "",
        f"LINK_HASH = 0x{link_hash(d):08X}",
        f"PARAMS_HASH = 0x{params_hash(d):08X}",
        f'LINK_VERSION = "{link["version"]}"',
        f'FIRMWARE_VERSION = "{link["firmware"]}"',
        f"PROTOCOL = {link['protocol']}",
        f"BAUD = {link['baud']}",
        f"TICK_US = {link['tick_us']}",
        f"MAX_COMMAND_PAYLOAD = {link['max_command_payload']}",
        f"MAX_TELEMETRY_PAYLOAD = {link['max_telemetry_payload']}",
        "",
    ]

    for name, entries in d["enums"].items():
        out += enum_class(camel(name), "IntEnum", entries["meaning"], values_of(entries, "value"))
    for name, entries in d["bits"].items():
        out += enum_class(camel(name), "IntFlag", entries["meaning"], values_of(entries, "bit"))
    faults = [(f["name"], f["code"], f["meaning"]) for f in d["fault"]]
    out += enum_class("Fault", "IntEnum", "Fault codes.", [("none", 0, "no fault"), *faults])
    out += enum_class("Param", "IntEnum", "Position of each parameter in the table.", positions(d["param"]))
    out += enum_class("Channel", "IntEnum", "Position of each telemetry channel.", positions(d["channel"]))
    ids = [(m["name"], m["id"], m["meaning"]) for m in d["message"]]
    out += enum_class("MessageId", "IntEnum", "Second byte of a frame.", ids)
    names = ", ".join(json.dumps(axis) for axis in axes(d))
    out += ["", f"AXES: tuple[str, ...] = ({names},)", '"""Names of the axes in the order of `Axis`."""', ""]

    out += [
        "",
        "@dataclass(frozen=True, slots=True)",
        "class ParamSpec:",
        '    """One row of the parameter table; ``min``, ``max`` and ``default`` are in ``unit``."""',
        "",
        "    index: int",
        "    name: str",
        "    unit: str",
        "    min: float",
        "    max: float",
        "    default: float",
        "    nonzero: bool",
        "    integer: bool",
        "    idle_only: bool",
        "    id: int",
        "    meaning: str",
        "",
        "",
        "@dataclass(frozen=True, slots=True)",
        "class FaultSpec:",
        '    """One fault: its number, the parameter that set its limit, and what to do."""',
        "",
        "    code: int",
        "    name: str",
        "    kind: str",
        "    parameter: str | None",
        "    meaning: str",
        "    remedy: str",
        "",
        "",
        "@dataclass(frozen=True, slots=True)",
        "class ChannelSpec:",
        '    """One telemetry channel: value = raw * scale, in ``unit``.',
        "",
        "    Parameters",
        "    ----------",
        "    name : str",
        "        As in `Channel`, in small letters.",
        "    code : str",
        "        Its type on the wire, as `struct` spells it.",
        "    unit : str",
        "        Unit of its values.",
        "    scale : float",
        "        Value of a raw 1 [unit].",
        "    column : str",
        "        Its name in samples, flights and tables; an encoder's is its axis' angle in rad.",
        "    field : str",
        "        Its name in a log.",
        "    axis : Axis or None",
        "        Axis whose encoder it counts.",
        "    kind : type or None",
        "        Enumeration or set of bits that its numbers are of.",
        "    meaning : str",
        "        What it is.",
        '    """',
        "",
        "    name: str",
        "    code: str",
        "    unit: str",
        "    scale: float",
        "    column: str",
        "    field: str",
        "    axis: Axis | None",
        "    kind: type[IntEnum] | type[IntFlag] | None",
        "    meaning: str",
        "",
        "",
        "PARAMS: tuple[ParamSpec, ...] = (",
    ]
    for i, p in enumerate(d["param"]):
        values = [i, p["name"], p["unit"], float(p["min"]), float(p["max"]), float(p["default"])]
        values += [p.get("nonzero", False), p.get("integer", False), p["when"] == "idle"]
        values += [param_id(p), p["meaning"]]
        out.append(f"    ParamSpec({', '.join(json_or_bool(v) for v in values)}),")
    out += [")", "", "FAULTS: tuple[FaultSpec, ...] = ("]
    for f in d["fault"]:
        values = [f["code"], f["name"], f["kind"], f.get("parameter"), f["meaning"], f["remedy"]]
        out.append(f"    FaultSpec({', '.join(json_or_bool(v) for v in values)}),")
    out += [")", "", "CHANNELS: tuple[ChannelSpec, ...] = ("]
    for c in d["channel"]:
        axis, kind = channels.axis_of(c), channels.numbers_of(c)
        values = [c["name"], "<" + STRUCT_CODE[c["type"]], c["unit"], float(c["scale"])]
        values += [channels.column(c), channels.field(c)]
        words = [json_or_bool(value) for value in values]
        words += [f"Axis.{axis.upper()}" if axis else "None", camel(kind) if kind else "None"]
        out.append(f"    ChannelSpec({', '.join(words)}, {json_or_bool(c['meaning'])}),")
    out += [")", ""]
    out += values_class(d["channel"]) + arrays_class(d["channel"])
    out += python_laws(d)
    for m in d["message"]:
        fields = full_fields(m)
        fmt = "<" + "".join(STRUCT_CODE[f["type"]] for f in fields)
        name = camel(m["name"]) + "Message"
        out += ["", "@dataclass(frozen=True, slots=True)", f"class {name}:"]
        out.append(f'    """{m["meaning"]}')
        if fields:
            out += ["", "    Parameters", "    ----------"]
            for f in fields:
                unit = f" [{f['unit']}]" if f["unit"] else ""
                out += [f"    {f['name']} : {PY_TYPE.get(f['type'], 'int')}", f"        {f['meaning']}{unit}"]
        out += ['    """', ""]
        out.append(f"    ID: ClassVar[MessageId] = MessageId.{m['name'].upper()}")
        out.append(f'    STRUCT: ClassVar[struct.Struct] = struct.Struct("{fmt}")')
        if m["kind"] == "command":
            reply = next(r for r in d["message"] if r["name"] == m["reply"])
            out.append(f"    REPLY: ClassVar[MessageId] = MessageId.{reply['name'].upper()}")
        out += [f"    {f['name']}: {PY_TYPE.get(f['type'], 'int')}" for f in fields]
        attributes = ", ".join("self." + f["name"] for f in fields)
        out += [
            "",
            "    def pack(self) -> bytes:",
            '        """Return the payload bytes."""',
            f"        return self.STRUCT.pack({attributes})",
            "",
            "    @classmethod",
            f"    def unpack(cls, payload: bytes) -> {name}:",
            '        """Read the fixed fields from the start of ``payload``."""',
            "        return cls(*cls.STRUCT.unpack_from(payload))",
            "",
        ]
    return "\n".join(out)


def json_or_bool(value: object) -> str:
    """A literal of Python."""
    if isinstance(value, bool) or value is None:
        return str(value)
    return json.dumps(value, ensure_ascii=False)
