"""Read the declaration link.toml, and check that it is consistent and works on both ends of the link."""

from __future__ import annotations

import hashlib
import json
import keyword
import math
import re
import struct
import tomllib
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from firmware.generator import channels

Table = dict[str, Any]

STRUCT_CODE = {"u8": "B", "u16": "H", "u32": "I", "u64": "Q", "i16": "h", "i32": "i", "f32": "f"}
# Telemetry sends differences of whole numbers with at most 32 bits.
CHANNEL_TYPES = ("u8", "u16", "u32", "i16", "i32")
CHANNEL_KEYS = {"name", "type", "unit", "scale", "meaning"}
# A stored set has 512 bytes, six for each parameter; see core/params/README.md.
MAX_PARAMS = 82

# Tables whose rows become enumerations, in addition to the declared ones.
TABLES = ("channel", "param", "fault", "message_id")

# Names that no channel may have: further columns of samples and logs, and further variables of MATLAB files.
RESERVED_NAMES = ("t_s", "tick", "parameters", "plan", "notes", "events")
# Limits of uploaded laws that must be declared. An instruction has five bits for the operation and nine for
# each cell.
LAW_LIMITS = (
    "format", "cells", "words", "signals", "max_ticks", "max_terms", "tick_cost", "fixed_cost", "output_cost",
    "input_cost", "moving_cost", "term_cost", "state_cost", "signal_cost",
)  # fmt: skip
# Parameters to which the accepted setpoints keep a distance.
SETPOINT_MARGINS = ("elevation_max_deg", "travel_max_deg", "elevation_rest_deg")
MAX_OPERATIONS = 32
MAX_CELLS = 512
LONGEST_MATLAB_NAME = 63
LOG_FIELD = re.compile(r"[a-z](_?[a-z0-9]+)*")
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
CPP_KEYWORDS = """
    alignas alignof and asm auto bool break case catch char class const constexpr continue decltype default
    delete do double else enum explicit export extern false float for friend goto if inline int long mutable
    namespace new noexcept not nullptr operator or private protected public register return short signed
    sizeof static struct switch template this throw true try typedef typeid typename union unsigned using
    virtual void volatile while xor
"""
KEYWORDS = {*keyword.kwlist, *CPP_KEYWORDS.split()}


class DeclarationError(Exception):
    """The declaration is invalid; the message states in one line what is wrong, and what to do."""


def read_toml(path: Path) -> Table:
    """Return the tables of a TOML file without a check."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise DeclarationError(f"cannot be read: {' '.join(str(error).split())}") from error


def read(path: Path) -> Table:
    """Return the declaration in a file, after it was checked."""
    declaration = read_toml(path)
    try:
        check(declaration)
    except KeyError as error:
        raise DeclarationError(
            f"an entry, or the whole, lacks {error}; compare it with its neighbours"
        ) from error
    return declaration


def size_of(wire_type: str) -> int:
    """Return the number of bytes that a type takes on the wire."""
    return struct.calcsize("<" + STRUCT_CODE[wire_type])


def camel(name: str) -> str:
    """Convert a name to that of a type: ``params_read`` to ``ParamsRead``."""
    return "".join(part.capitalize() for part in name.split("_"))


def full_fields(message: Table) -> list[Table]:
    """Return the fields on the wire; in commands and replies, the request number comes first."""
    request = {"name": "request", "type": "u8", "unit": "", "meaning": "request number; a retry repeats it"}
    fields: list[Table] = message["fields"]
    return ([request] if message["kind"] in ("command", "reply") else []) + fields


def rows(entries: Table) -> Iterator[tuple[str, Table]]:
    """Return names and entries of an enumeration or a set of bits, without its own meaning."""
    return ((name, entry) for name, entry in entries.items() if name != "meaning")


def axes(declaration: Table) -> list[str]:
    """Return the names of the axes, in the order of the declaration."""
    return [name for name, _ in rows(declaration["enums"]["axis"])]


def without_meanings(value: Any) -> Any:
    """Return a part of the declaration without the texts for people."""
    if isinstance(value, dict):
        return {
            key: without_meanings(entry) for key, entry in value.items() if key not in ("meaning", "remedy")
        }
    if isinstance(value, list):
        return [without_meanings(entry) for entry in value]
    return value


def link_hash(declaration: Table) -> int:
    """Return the first four bytes of SHA-256 over the declaration, by which both ends compare it.

    Texts for people and the version of the firmware are not covered.
    """
    covered = without_meanings(declaration)
    covered["link"] = {key: entry for key, entry in covered["link"].items() if key != "firmware"}
    canonical = json.dumps(covered, sort_keys=True, separators=(",", ":"))
    return int.from_bytes(hashlib.sha256(canonical.encode()).digest()[:4], "big")


def param_id(param: Table) -> int:
    """Return the number of a parameter in stored sets: a hash of its name, its unit and whether it is whole.

    If a parameter is moved in the table, it keeps its number. With another unit, it is another parameter.
    """
    identity = json.dumps([param["name"], param["unit"], param.get("integer", False)])
    return int.from_bytes(hashlib.sha256(identity.encode()).digest()[:2], "big")


def params_hash(declaration: Table) -> int:
    """Return the first four bytes of SHA-256 over meaning and range of all parameters, in any order.

    The board compares this hash with that of a stored set. Unlike `link_hash`, it does not change if other
    parts of the declaration change, so that the stored set stays valid.
    """
    keys = ("name", "unit", "min", "max", "nonzero", "integer")
    covered = sorted(json.dumps([p.get(key, False) for key in keys]) for p in declaration["param"])
    return int.from_bytes(hashlib.sha256("\n".join(covered).encode()).digest()[:4], "big")


def check(declaration: Table) -> None:
    """Raise DeclarationError for the first problem of a declaration."""
    check_names(declaration)
    check_channels(declaration)
    check_axes(declaration)
    check_laws(declaration)
    if set(declaration["setpoint_margin"]) != set(SETPOINT_MARGINS):
        raise DeclarationError(f"setpoint_margin: needs {', '.join(SETPOINT_MARGINS)}, and nothing else")
    check_params(declaration["param"])
    names = [param["name"] for param in declaration["param"]]
    for fault in declaration["fault"]:
        if "parameter" in fault and fault["parameter"] not in names:
            raise DeclarationError(f"fault {fault['name']} names an unknown parameter")
    check_messages(declaration["message"])


def check_params(params: Sequence[Table]) -> None:
    """Raise DeclarationError if the parameters are too many, or one is invalid or has the number of another."""
    if len(params) > MAX_PARAMS:
        raise DeclarationError(f"{len(params)} parameters; one stored set holds {MAX_PARAMS}")
    for param in params:
        if not param["min"] <= param["default"] <= param["max"]:
            raise DeclarationError(f"{param['name']}: default outside its range")
        if param["when"] not in ("idle", "always"):
            raise DeclarationError(f"{param['name']}: when must be idle or always")
    names_by_id: dict[int, str] = {}
    for param in params:
        earlier = names_by_id.setdefault(param_id(param), param["name"])
        if earlier != param["name"]:
            raise DeclarationError(
                f"{param['name']} and {earlier} have the same number in flash; rename the new one"
            )


def check_messages(messages: Sequence[Table]) -> None:
    """Raise DeclarationError if a command has no reply, or the fields of a message are invalid."""
    by_name = {message["name"]: message for message in messages}
    for message in messages:
        name, kind, fields = message["name"], message["kind"], message["fields"]
        if kind == "command" and by_name.get(message["reply"], {}).get("kind") != "reply":
            raise DeclarationError(f"command {name} names no reply")
        floats = [number for number, field in enumerate(fields) if field["type"] == "f32"]
        if kind in ("command", "stream") and floats and floats[-1] - floats[0] >= len(floats):
            raise DeclarationError(f"{name}: its fields of type f32 must follow each other")
        for field in fields:
            if field["type"] not in STRUCT_CODE:
                raise DeclarationError(
                    f"{name}.{field['name']}: no type {field['type']}; {choice(STRUCT_CODE)}"
                )


def choice(words: Iterable[str]) -> str:
    """Return the end of an error message that lists the permitted words."""
    return f"it may be {', '.join(words)}"


def check_names(declaration: Table) -> None:
    """Raise DeclarationError if a name is invalid in C++ or Python, or occurs twice in its group."""
    groups = {f"enum {name}": [row for row, _ in rows(e)] for name, e in declaration["enums"].items()}
    groups |= {f"bits {name}": [row for row, _ in rows(e)] for name, e in declaration["bits"].items()}
    groups |= {m["name"]: [f["name"] for f in full_fields(m)] for m in declaration["message"]}
    groups |= {kind: [e["name"] for e in declaration[kind]] for kind in ("param", "message", "fault")}
    groups["enumerations and bits"] = [*declaration["enums"], *declaration["bits"], *TABLES]
    groups["channel"] = [str(e.get("name", "")) for e in declaration["channel"]]
    for group, names in groups.items():
        for name in names:
            if not NAME.fullmatch(name) or name in KEYWORDS:
                raise DeclarationError(f"{group}: {name!r} is no name in C++ and Python; choose another")
            if sum(name.upper() == other.upper() for other in names) > 1:
                raise DeclarationError(f"{group}: two are called {name}; rename one")
    for kind, key in (("message", "id"), ("fault", "code")):
        keys = [entry[key] for entry in declaration[kind]]
        if len(set(keys)) != len(keys):
            raise DeclarationError(f"two entries of [[{kind}]] share a {key}")


def check_channels(declaration: Table) -> None:
    """Raise DeclarationError if a channel is invalid, or if two have the same name in samples, tables or logs."""
    owner = dict.fromkeys(
        [*RESERVED_NAMES, *(f"{axis}_deg" for axis in axes(declaration))], "every log or sample"
    )
    in_logs = dict(owner)
    for channel in declaration["channel"]:
        name = channel["name"]
        if channel.keys() != CHANNEL_KEYS:
            wrong = sorted(channel.keys() ^ CHANNEL_KEYS)
            raise DeclarationError(f"channel {name}: {wrong[0]} is missing, or not known")
        for key in sorted(CHANNEL_KEYS - {"scale"}):
            if not isinstance(channel[key], str):
                raise DeclarationError(f"channel {name}: {key} {channel[key]} is no text; put it in quotes")
        check_channel(declaration, channel)
        claims = [
            (owner, channels.column(channel)),
            *((in_logs, field) for field in channels.fields(channel)),
        ]
        for owners, claimed in claims:
            earlier = owners.setdefault(claimed.lower(), name)
            if earlier != name:
                raise DeclarationError(f"channel {name}: {earlier} already has a {claimed}; rename one")


def check_channel(declaration: Table, channel: Table) -> None:
    """Raise DeclarationError if type, scale, unit or name of a channel is invalid."""
    location, unit, scale = f"channel {channel['name']}", channel["unit"], channel["scale"]
    if "\n" in channel["meaning"]:
        raise DeclarationError(f"{location}: its meaning is more than one line")
    if channel["type"] not in CHANNEL_TYPES:
        raise DeclarationError(f"{location}: no type {channel['type']}; {choice(CHANNEL_TYPES)}")
    if isinstance(scale, bool) or not isinstance(scale, int | float) or not 0.0 < scale < math.inf:
        raise DeclarationError(
            f"{location}: scale {scale} is no size; give the unit's share of a count of raw"
        )
    kind, _, which = unit.partition(" ")
    if kind in ("enum", "bits") and which:
        known = {*declaration["enums"], "fault"} if kind == "enum" else {*declaration["bits"]}
        if which not in known:
            raise DeclarationError(f"{location}: there is no {unit}; {choice(sorted(known))}")
        if channel["type"] != "u8":
            raise DeclarationError(f"{location}: {unit} takes type u8")
    elif unit == channels.COUNT and channels.axis_of(channel) not in axes(declaration):
        names = ", ".join(f"{axis}_{unit}" for axis in axes(declaration))
        raise DeclarationError(
            f"{location}: only an encoder counts; call it one of {names}, or leave unit empty"
        )
    elif unit and not channels.suffix(unit):
        raise DeclarationError(f"{location}: unit {unit!r} cannot end a name; write it in letters")
    if scale != 1.0 and (kind in ("enum", "bits") or unit == channels.COUNT):
        raise DeclarationError(f"{location}: {unit} takes scale 1.0")
    column, field = channels.column(channel), channels.field(channel)
    if not LOG_FIELD.fullmatch(field):
        raise DeclarationError(
            f"{location}: a log cannot hold {field!r}; use a letter, then a-z, 0-9 and single _"
        )
    if column in KEYWORDS or len(column) > LONGEST_MATLAB_NAME:
        raise DeclarationError(f"{location}: Python or MATLAB do not take {column!r}; choose another name")


def check_axes(declaration: Table) -> None:
    """Raise DeclarationError unless enumeration, mask, encoder channels and parameters have the same axes."""
    names = axes(declaration)
    if [entry["value"] for _, entry in rows(declaration["enums"]["axis"])] != [*range(len(names))]:
        raise DeclarationError("enum axis: its values count from 0, in order")
    bits = {name: entry["bit"] for name, entry in rows(declaration["bits"]["axes"])}
    if bits != {name: number for number, name in enumerate(names)}:
        raise DeclarationError("bits axes: its bits are those of enum axis, in the same order")
    counted = {channels.axis_of(channel) for channel in declaration["channel"]}
    params = {p["name"] for p in declaration["param"]}
    for name in names:
        if name not in counted:
            raise DeclarationError(f"enum axis: {name} has no channel; add {name}_{channels.COUNT}")
        if f"{name}_counts_per_rev" not in params:
            raise DeclarationError(f"enum axis: {name} has no parameter {name}_counts_per_rev; add it")


def check_laws(declaration: Table) -> None:
    """Raise DeclarationError for the first problem in the declaration of uploaded laws."""
    if set(declaration["law"]) != set(LAW_LIMITS):
        raise DeclarationError(f"law: needs {', '.join(LAW_LIMITS)}, and nothing else")
    if declaration["law"]["cells"] > MAX_CELLS:
        raise DeclarationError(f"law: an instruction can name {MAX_CELLS} cells at most")
    if [entry["code"] for entry in declaration["operation"]] != [*range(len(declaration["operation"]))]:
        raise DeclarationError("operation: codes count from 0, in order")
    if len(declaration["operation"]) > MAX_OPERATIONS:
        raise DeclarationError(f"operation: an instruction can name {MAX_OPERATIONS} at most")
    for entry in declaration["operation"]:
        if entry["operands"] not in (0, 1, 2):
            raise DeclarationError(f"operation {entry['name']}: 0 (terms follow), 1 or 2 operands")
