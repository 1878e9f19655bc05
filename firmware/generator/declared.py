"""Reading the declaration, and refusing what contradicts itself or would not work at one of the ends."""

from __future__ import annotations

import hashlib
import json
import keyword
import math
import re
import struct
import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from firmware.generator import channels

Table = dict[str, Any]

STRUCT_CODE = {"u8": "B", "u16": "H", "u32": "I", "u64": "Q", "i16": "h", "i32": "i", "f32": "f"}
# Differences of samples are 32 bits wide at most, and whole numbers.
CHANNEL_TYPES = ("u8", "u16", "u32", "i16", "i32")
CHANNEL_KEYS = {"name", "type", "unit", "scale", "meaning"}
# Six bytes each in a stored set of 512; see core/params/README.md.
MAX_PARAMS = 82

# What becomes an enumeration without being declared as one.
TABLES = ("channel", "param", "fault", "message_id")

# Beside the channels: columns of samples and logs, and what a MATLAB file holds besides its columns.
TAKEN = ("t_s", "tick", "parameters", "plan", "notes", "events")
# What is declared of laws that come over the link. Five bits of an instruction say which operation it
# is, nine which cell.
LAW_LIMITS = (
    "format", "cells", "words", "signals", "max_ticks", "max_terms", "tick_cost", "fixed_cost", "output_cost",
    "input_cost", "moving_cost", "term_cost", "state_cost", "signal_cost",
)  # fmt: skip
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
    """The declaration contradicts itself; the message says in one line where, and what to do."""


def read_toml(path: Path) -> Table:
    """The tables of a file, not checked."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise DeclarationError(f"cannot be read: {' '.join(str(error).split())}") from error


def read(path: Path) -> Table:
    """The declaration in a file, checked."""
    declaration = read_toml(path)
    try:
        check(declaration)
    except KeyError as error:
        raise DeclarationError(
            f"an entry, or the whole, lacks {error}; compare it with its neighbours"
        ) from error
    return declaration


def size_of(wire_type: str) -> int:
    """Bytes on the wire."""
    return struct.calcsize("<" + STRUCT_CODE[wire_type])


def camel(name: str) -> str:
    """A name as a type's: ``params_read`` to ``ParamsRead``."""
    return "".join(part.capitalize() for part in name.split("_"))


def full_fields(message: Table) -> list[Table]:
    """Fields on the wire: commands and replies carry the request number first."""
    request = {
        "name": "request",
        "type": "u8",
        "unit": "",
        "meaning": "request number; a retry repeats it",
    }
    fields: list[Table] = message["fields"]
    return ([request] if message["kind"] in ("command", "reply") else []) + fields


def rows(entries: Table) -> Iterator[tuple[str, Table]]:
    """The entries of an enumeration or of a set of bits, by name."""
    return ((name, entry) for name, entry in entries.items() if name != "meaning")


def axes(declaration: Table) -> list[str]:
    """Names of the axes, in order."""
    return [name for name, _ in rows(declaration["enums"]["axis"])]


def without_meanings(value: Any) -> Any:
    """A part of the declaration without its prose."""
    if isinstance(value, dict):
        return {k: without_meanings(v) for k, v in value.items() if k not in ("meaning", "remedy")}
    if isinstance(value, list):
        return [without_meanings(v) for v in value]
    return value


def link_hash(declaration: Table) -> int:
    """First four bytes of SHA-256 over the declaration without its prose and firmware version."""
    body = without_meanings(declaration)
    body["link"] = {k: v for k, v in body["link"].items() if k != "firmware"}
    canonical = json.dumps(body, sort_keys=True, separators=(",", ":"))
    return int.from_bytes(hashlib.sha256(canonical.encode()).digest()[:4], "big")


def param_id(param: Table) -> int:
    """Number of a parameter in stored sets, from what its value means: name, unit and kind.

    A parameter that is moved in the table keeps its number. One that gets another unit is another parameter.
    """
    meant = json.dumps([param["name"], param["unit"], param.get("integer", False)])
    return int.from_bytes(hashlib.sha256(meant.encode()).digest()[:2], "big")


def params_hash(declaration: Table) -> int:
    """First four bytes of SHA-256 over what stored values mean and may be, in no order.

    Whatever else the link hash covers may change without a stored set becoming another one's.
    """
    keys = ("name", "unit", "min", "max", "nonzero", "integer")
    body = sorted(json.dumps([p.get(key, False) for key in keys]) for p in declaration["param"])
    return int.from_bytes(hashlib.sha256("\n".join(body).encode()).digest()[:4], "big")


def check(declaration: Table) -> None:
    """Raise DeclarationError for the first thing that is wrong."""
    check_names(declaration)
    check_channels(declaration)
    check_axes(declaration)
    check_laws(declaration)
    params = declaration["param"]
    names = [p["name"] for p in params]
    if len(params) > MAX_PARAMS:
        raise DeclarationError(f"{len(params)} parameters; one stored set holds {MAX_PARAMS}")
    for p in params:
        if not p["min"] <= p["default"] <= p["max"]:
            raise DeclarationError(f"{p['name']}: default outside its range")
        if p["when"] not in ("idle", "always"):
            raise DeclarationError(f"{p['name']}: when must be idle or always")
    ids: dict[int, str] = {}
    for p in params:
        other = ids.setdefault(param_id(p), p["name"])
        if other != p["name"]:
            raise DeclarationError(
                f"{p['name']} and {other} have the same number in flash; rename the new one"
            )
    for fault in declaration["fault"]:
        if "parameter" in fault and fault["parameter"] not in names:
            raise DeclarationError(f"fault {fault['name']} names an unknown parameter")
    by_name = {m["name"]: m for m in declaration["message"]}
    for m in declaration["message"]:
        if m["kind"] == "command" and by_name.get(m["reply"], {}).get("kind") != "reply":
            raise DeclarationError(f"command {m['name']} names no reply")
        for f in m["fields"]:
            if f["type"] not in STRUCT_CODE:
                raise DeclarationError(f"{m['name']}.{f['name']}: no type {f['type']}; {choice(STRUCT_CODE)}")


def choice(words: Iterable[str]) -> str:
    return f"it may be {', '.join(words)}"


def check_names(declaration: Table) -> None:
    """Names are such that C++ and Python take them, and none is there twice."""
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
    """Every channel can be packed, and has a place of its own in samples, tables and logs."""
    owner = dict.fromkeys([*TAKEN, *(f"{axis}_deg" for axis in axes(declaration))], "every log or sample")
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
        claimed = [
            (owner, channels.column(channel)),
            *((in_logs, field) for field in channels.fields(channel)),
        ]
        for place, word in claimed:
            other = place.setdefault(word.lower(), name)
            if other != name:
                raise DeclarationError(f"channel {name}: {other} already has a {word}; rename one")


def check_channel(declaration: Table, channel: Table) -> None:
    where, unit, scale = f"channel {channel['name']}", channel["unit"], channel["scale"]
    if "\n" in channel["meaning"]:
        raise DeclarationError(f"{where}: its meaning is more than one line")
    if channel["type"] not in CHANNEL_TYPES:
        raise DeclarationError(f"{where}: no type {channel['type']}; {choice(CHANNEL_TYPES)}")
    if isinstance(scale, bool) or not isinstance(scale, int | float) or not 0.0 < scale < math.inf:
        raise DeclarationError(f"{where}: scale {scale} is no size; give the unit's share of a count of raw")
    kind, _, which = unit.partition(" ")
    if kind in ("enum", "bits") and which:
        known = {*declaration["enums"], "fault"} if kind == "enum" else {*declaration["bits"]}
        if which not in known:
            raise DeclarationError(f"{where}: there is no {unit}; {choice(sorted(known))}")
        if channel["type"] != "u8":
            raise DeclarationError(f"{where}: {unit} takes type u8")
    elif unit == channels.COUNT and channels.axis_of(channel) not in axes(declaration):
        names = ", ".join(f"{axis}_{unit}" for axis in axes(declaration))
        raise DeclarationError(
            f"{where}: only an encoder counts; call it one of {names}, or leave unit empty"
        )
    elif unit and not channels.suffix(unit):
        raise DeclarationError(f"{where}: unit {unit!r} cannot end a name; write it in letters")
    if scale != 1.0 and (kind in ("enum", "bits") or unit == channels.COUNT):
        raise DeclarationError(f"{where}: {unit} takes scale 1.0")
    column, field = channels.column(channel), channels.field(channel)
    if not LOG_FIELD.fullmatch(field):
        raise DeclarationError(
            f"{where}: a log cannot hold {field!r}; use a letter, then a-z, 0-9 and single _"
        )
    if column in KEYWORDS or len(column) > LONGEST_MATLAB_NAME:
        raise DeclarationError(f"{where}: Python or MATLAB do not take {column!r}; choose another name")


def check_axes(declaration: Table) -> None:
    """Enumeration, mask, encoder channels and encoder parameters name the same axes."""
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


def check_laws(d: Table) -> None:
    """Raise DeclarationError for the first thing that is wrong with what is declared of laws."""
    if set(d["law"]) != set(LAW_LIMITS):
        raise DeclarationError(f"law: needs {', '.join(LAW_LIMITS)}, and nothing else")
    if d["law"]["cells"] > MAX_CELLS:
        raise DeclarationError(f"law: an instruction can name {MAX_CELLS} cells at most")
    if [one["code"] for one in d["operation"]] != [*range(len(d["operation"]))]:
        raise DeclarationError("operation: codes count from 0, in order")
    if len(d["operation"]) > MAX_OPERATIONS:
        raise DeclarationError(f"operation: an instruction can name {MAX_OPERATIONS} at most")
    for one in d["operation"]:
        if one["operands"] not in (0, 1, 2):
            raise DeclarationError(f"operation {one['name']}: 0 (terms follow), 1 or 2 operands")
