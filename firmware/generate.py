"""Write the C++ tables, the Python tables and docs/link.md from firmware/link.toml.

Run ``python firmware/generate.py`` after every change of link.toml; ``--check`` writes nothing and
fails when a generated file is stale. Needs nothing but the standard library, so that a firmware
build can run it before any package is installed.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import struct
import sys
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
SOURCE = ROOT / "firmware" / "link.toml"
CPP = ROOT / "firmware" / "core" / "link" / "declaration.hpp"
PYTHON = ROOT / "host" / "heli_host" / "link" / "declaration.py"
DOC = ROOT / "docs" / "link.md"

STRUCT_CODE = {"u8": "B", "u16": "H", "u32": "I", "u64": "Q", "i16": "h", "i32": "i", "f32": "f"}
CPP_TYPE = {
    "u8": "std::uint8_t",
    "u16": "std::uint16_t",
    "u32": "std::uint32_t",
    "u64": "std::uint64_t",
    "i16": "std::int16_t",
    "i32": "std::int32_t",
    "f32": "float",
}
MAX_PARAMS = 60

Table = dict[str, Any]


class DeclarationError(Exception):
    """link.toml contradicts itself."""


def size_of(wire_type: str) -> int:
    return struct.calcsize("<" + STRUCT_CODE[wire_type])


def camel(name: str) -> str:
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


def without_meanings(value: Any) -> Any:
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


def check(declaration: Table) -> None:
    params = declaration["param"]
    names = [p["name"] for p in params]
    if len(params) > MAX_PARAMS:
        raise DeclarationError(f"{len(params)} parameters; one flash page holds {MAX_PARAMS}")
    for group, key in (("param", "name"), ("channel", "name"), ("message", "id"), ("fault", "code")):
        keys = [entry[key] for entry in declaration[group]]
        if len(set(keys)) != len(keys):
            raise DeclarationError(f"two entries of [[{group}]] share a {key}")
    for p in params:
        if not p["min"] <= p["default"] <= p["max"]:
            raise DeclarationError(f"{p['name']}: default outside its range")
        if p["when"] not in ("idle", "always"):
            raise DeclarationError(f"{p['name']}: when must be idle or always")
    for fault in declaration["fault"]:
        if "parameter" in fault and fault["parameter"] not in names:
            raise DeclarationError(f"fault {fault['name']} names an unknown parameter")
    by_name = {m["name"]: m for m in declaration["message"]}
    for m in declaration["message"]:
        if m["kind"] == "command" and by_name.get(m["reply"], {}).get("kind") != "reply":
            raise DeclarationError(f"command {m['name']} names no reply")


# --------------------------------------------------------------------------- C++


def cpp_float(value: float) -> str:
    text = repr(float(value))
    return text + "F"


def generate_cpp(d: Table) -> str:
    link = d["link"]
    major, minor = (int(x) for x in link["version"].split("."))
    firmware = [int(x) for x in link["firmware"].split(".")]
    out = [
        "// Written by firmware/generate.py from firmware/link.toml. Do not edit.",
        "// clang-format off",
        "#pragma once",
        "",
        "#include <cstddef>",
        "#include <cstdint>",
        "",
        '#include "bytes.hpp"',
        "",
        "namespace heli::link {",
        "",
        f"inline constexpr std::uint32_t kLinkHash = 0x{link_hash(d):08x}U;",
        f"inline constexpr std::uint8_t kLinkMajor = {major};",
        f"inline constexpr std::uint8_t kLinkMinor = {minor};",
        f"inline constexpr std::uint8_t kFirmwareMajor = {firmware[0]};",
        f"inline constexpr std::uint8_t kFirmwareMinor = {firmware[1]};",
        f"inline constexpr std::uint8_t kFirmwarePatch = {firmware[2]};",
        f"inline constexpr std::uint8_t kProtocol = {link['protocol']};",
        f"inline constexpr std::uint32_t kBaud = {link['baud']};",
        f"inline constexpr std::uint32_t kTick_us = {link['tick_us']};",
        f"inline constexpr std::size_t kMaxCommandPayload = {link['max_command_payload']};",
        f"inline constexpr std::size_t kMaxTelemetryPayload = {link['max_telemetry_payload']};",
        "",
    ]
    for name, entries in d["enums"].items():
        out.append(f"// {entries['meaning']}")
        out.append(f"enum class {camel(name)} : std::uint8_t {{")
        rows = [(k, e) for k, e in entries.items() if k != "meaning"]
        out += [f"  {k} = {e['value']},  // {e['meaning']}" for k, e in rows]
        out += ["};", f"inline constexpr std::size_t k{camel(name)}Count = {len(rows)};", ""]
    for name, entries in d["bits"].items():
        out.append(f"// {entries['meaning']}")
        out.append(f"namespace {name} {{")
        for k, e in entries.items():
            if k != "meaning":
                out.append(f"inline constexpr std::uint8_t {k} = 1U << {e['bit']}U;  // {e['meaning']}")
        out += [f"}}  // namespace {name}", ""]
    out += ["enum class Fault : std::uint8_t {", "  none = 0,"]
    out += [f"  {f['name']} = {f['code']},  // {f['kind']}: {f['meaning']}" for f in d["fault"]]
    out += ["};", ""]
    out.append("enum class Param : std::uint8_t {")
    out += [f"  {p['name']} = {i},  // {p['unit']}: {p['meaning']}" for i, p in enumerate(d["param"])]
    out += [
        "};",
        f"inline constexpr std::size_t kParamCount = {len(d['param'])};",
        "",
        "struct ParamInfo {",
        "  float min;",
        "  float max;",
        "  float initial;",
        "  bool nonzero;",
        "  bool integer;",
        "  bool idle_only;",
        "};",
        "inline constexpr ParamInfo kParams[kParamCount] = {",
    ]
    for p in d["param"]:
        flags = [p.get("nonzero", False), p.get("integer", False), p["when"] == "idle"]
        numbers = ", ".join(cpp_float(p[k]) for k in ("min", "max", "default"))
        out.append(f"    {{{numbers}, {', '.join(str(f).lower() for f in flags)}}},  // {p['name']}")
    out += ["};", ""]
    out.append("enum class Channel : std::uint8_t {")
    out += [f"  {c['name']} = {i},  // {c['unit']}: {c['meaning']}" for i, c in enumerate(d["channel"])]
    sizes = ", ".join(str(size_of(c["type"])) for c in d["channel"])
    out += [
        "};",
        f"inline constexpr std::size_t kChannelCount = {len(d['channel'])};",
        f"inline constexpr std::uint8_t kChannelBytes[kChannelCount] = {{{sizes}}};",
    ]
    for c in d["channel"]:
        if c["scale"] != 1.0:
            out.append(
                f"inline constexpr float k{camel(c['name'])}PerUnit = {cpp_float(round(1 / c['scale'], 6))};"
                f"  // raw = value in {c['unit']} * this"
            )
    out.append("")
    out.append("enum class MessageId : std::uint8_t {")
    out += [f"  {m['name']} = {m['id']}," for m in d["message"]]
    out += ["};", ""]
    for m in d["message"]:
        fields = full_fields(m)
        size = sum(size_of(f["type"]) for f in fields)
        out.append(f"// {m['meaning']}")
        out.append(f"struct {camel(m['name'])}Message {{")
        out.append(f"  static constexpr MessageId kId = MessageId::{m['name']};")
        out.append(f"  static constexpr std::size_t kSize = {size};")
        out += [f"  {CPP_TYPE[f['type']]} {f['name']} = {{}};  // {f['unit'] or '-'}" for f in fields]
        out.append("  void write([[maybe_unused]] std::uint8_t* to) const {")
        offset = 0
        for f in fields:
            out.append(f"    put_{f['type']}(to + {offset}, {f['name']});")
            offset += size_of(f["type"])
        out.append("  }")
        out.append(f"  static {camel(m['name'])}Message read([[maybe_unused]] const std::uint8_t* from) {{")
        out.append(f"    {camel(m['name'])}Message m;")
        offset = 0
        for f in fields:
            out.append(f"    m.{f['name']} = get_{f['type']}(from + {offset});")
            offset += size_of(f["type"])
        out += ["    return m;", "  }", "};", ""]
    out += ["}  // namespace heli::link", ""]
    return "\n".join(out)


# --------------------------------------------------------------------------- Python

PY_TYPE = {"f32": "float"}


def generate_python(d: Table) -> str:
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
        "from typing import ClassVar",
        "",
        f"LINK_HASH = 0x{link_hash(d):08X}",
        f'LINK_VERSION = "{link["version"]}"',
        f'FIRMWARE_VERSION = "{link["firmware"]}"',
        f"PROTOCOL = {link['protocol']}",
        f"BAUD = {link['baud']}",
        f"TICK_US = {link['tick_us']}",
        f"MAX_COMMAND_PAYLOAD = {link['max_command_payload']}",
        f"MAX_TELEMETRY_PAYLOAD = {link['max_telemetry_payload']}",
        "",
    ]

    def enum_class(name: str, base: str, doc: str, rows: list[tuple[str, int, str]]) -> None:
        out.extend(["", f"class {name}({base}):", f'    """{doc}"""', ""])
        out.extend(f"    {k.upper()} = {v}  # {meaning}" for k, v, meaning in rows)
        out.append("")
        if base == "IntEnum":
            out.extend(["    def __str__(self) -> str:", "        return self.name.lower()", ""])

    for name, entries in d["enums"].items():
        rows = [(k, e["value"], e["meaning"]) for k, e in entries.items() if k != "meaning"]
        enum_class(camel(name), "IntEnum", entries["meaning"], rows)
    for name, entries in d["bits"].items():
        rows = [(k, 1 << e["bit"], e["meaning"]) for k, e in entries.items() if k != "meaning"]
        enum_class(camel(name), "IntFlag", entries["meaning"], rows)
    faults = [(f["name"], f["code"], f["meaning"]) for f in d["fault"]]
    enum_class("Fault", "IntEnum", "Fault codes.", [("none", 0, "no fault"), *faults])
    enum_class(
        "Param",
        "IntEnum",
        "Position of each parameter in the table.",
        [(p["name"], i, f"{p['unit']}: {p['meaning']}") for i, p in enumerate(d["param"])],
    )
    ids = [(m["name"], m["id"], m["meaning"]) for m in d["message"]]
    enum_class("MessageId", "IntEnum", "Second byte of a frame.", ids)

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
        '    """One telemetry channel: value = raw * scale, in ``unit``."""',
        "",
        "    name: str",
        "    code: str",
        "    unit: str",
        "    scale: float",
        "    meaning: str",
        "",
        "",
        "PARAMS: tuple[ParamSpec, ...] = (",
    ]
    for i, p in enumerate(d["param"]):
        values = [i, p["name"], p["unit"], float(p["min"]), float(p["max"]), float(p["default"])]
        values += [p.get("nonzero", False), p.get("integer", False), p["when"] == "idle", p["meaning"]]
        out.append(f"    ParamSpec({', '.join(json_or_bool(v) for v in values)}),")
    out += [")", "", "FAULTS: tuple[FaultSpec, ...] = ("]
    for f in d["fault"]:
        values = [f["code"], f["name"], f["kind"], f.get("parameter"), f["meaning"], f["remedy"]]
        out.append(f"    FaultSpec({', '.join(json_or_bool(v) for v in values)}),")
    out += [")", "", "CHANNELS: tuple[ChannelSpec, ...] = ("]
    for c in d["channel"]:
        values = [c["name"], "<" + STRUCT_CODE[c["type"]], c["unit"], c["scale"], c["meaning"]]
        out.append(f"    ChannelSpec({', '.join(json_or_bool(v) for v in values)}),")
    out += [")", ""]
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
    if isinstance(value, bool) or value is None:
        return str(value)
    return json.dumps(value, ensure_ascii=False)


# --------------------------------------------------------------------------- docs/link.md

FRAMING = """\
# The link, byte by byte

Written by `firmware/generate.py` from `firmware/link.toml`; a test fails when it is stale.
Link version {version}, hash `{hash:08x}`, {baud} baud, 8N1. All numbers are little-endian; `f32` is IEEE 754 single precision.

## Frame

```
COBS( protocol u8 = {protocol} | message id u8 | sequence u8 | payload | crc u32 ) 0x00
```

- **COBS** (consistent overhead byte stuffing) removes every zero from the frame, so that the one zero behind it marks its end.
  A receiver that joins in the middle, or loses bytes, is in step again at the next zero.
- **sequence** counts the frames of one direction, modulo 256. A gap is a loss: both ends count it.
- **crc** is CRC-32 (IEEE 802.3, reflected, as zlib's `crc32`) over everything before it. Frames of more than 48 bytes are common, and a single
  flipped bit in a COBS code byte moves several bytes at once; 16 bits would let one such frame in 65,536 pass.
- Payloads are at most {max_command_payload} bytes towards the board and {max_telemetry_payload} bytes from it.

## Commands

A command is answered by exactly one reply that repeats its `request` number. The host sends one command at a time and repeats it, with the same
number, until the reply comes. The board remembers the number and the ack of the last command it executed: a retry of it is answered from memory and
not executed again. So a command takes effect exactly once, however often it or its ack is lost. `hello` with a new session number clears that memory.
Streams (`setpoint`, `voltages`) are not answered: the latest wins.

## Telemetry batch

```
first_tick u32 | count u8 | widths {nibble_bytes} bytes | bases {base_bytes} bytes | deltas
```

- Sample `k` of a batch was taken at tick `first_tick + k`; a tick is {tick_us} us, counted by the board's timer.
- **widths**: one nibble a channel, low nibble first: 0, 1, 2, 3, 4, 5 for deltas of 0, 2, 4, 8, 16, 32 bits.
- **bases**: the first sample of every channel in its own type, in the order of the table below.
- **deltas**: for every channel whose width is not 0, in order: `count - 1` differences to the sample before (modulo 2^32, two's complement in the given
  width), packed from the least significant bit on; each channel starts on a new byte.
"""


def markdown_table(header: list[str], rows: list[list[str]]) -> list[str]:
    return [
        "| " + " | ".join(header) + " |",
        "|" + "---|" * len(header),
        *("| " + " | ".join(row) + " |" for row in rows),
        "",
    ]


def generate_doc(d: Table) -> str:
    channels = d["channel"]
    text = FRAMING.format(
        hash=link_hash(d),
        nibble_bytes=(len(channels) + 1) // 2,
        base_bytes=sum(size_of(c["type"]) for c in channels),
        **d["link"],
    )
    out = [
        text,
        *markdown_table(
            ["channel", "base", "unit", "scale", "meaning"],
            [[f"`{c['name']}`", c["type"], c["unit"], f"{c['scale']:g}", c["meaning"]] for c in channels],
        ),
    ]
    out.append("## Messages\n")
    for m in d["message"]:
        reply = f", answered by `{m['reply']}`" if m["kind"] == "command" else ""
        frozen = ", layout frozen for ever" if m.get("frozen") else ""
        out.append(f"### {m['id']} `{m['name']}` ({m['kind']}{reply}{frozen})\n\n{m['meaning']}\n")
        rows = []
        offset = 0
        for f in full_fields(m):
            rows.append([str(offset), f"`{f['name']}`", f["type"], f["unit"], f["meaning"]])
            offset += size_of(f["type"])
        if m.get("array"):
            rows.append([str(offset), "values", m["array"] + "[]", "", "the array"])
        if rows:
            out += markdown_table(["offset", "field", "type", "unit", "meaning"], rows)
    for name, entries in d["enums"].items():
        out.append(f"## {name}\n\n{entries['meaning']}\n")
        rows = [[str(e["value"]), f"`{k}`", e["meaning"]] for k, e in entries.items() if k != "meaning"]
        out += markdown_table(["value", "name", "meaning"], rows)
    for name, entries in d["bits"].items():
        out.append(f"## {name} (bits)\n\n{entries['meaning']}\n")
        rows = [[str(e["bit"]), f"`{k}`", e["meaning"]] for k, e in entries.items() if k != "meaning"]
        out += markdown_table(["bit", "name", "meaning"], rows)
    out.append("## Faults\n\n`trip`: motors off, latched. `check`: arming refused. `boot`: found at start.\n")
    out += markdown_table(
        ["code", "name", "kind", "limit", "meaning", "remedy"],
        [
            [
                str(f["code"]),
                f"`{f['name']}`",
                f["kind"],
                f"`{f['parameter']}`" if "parameter" in f else "",
                f["meaning"],
                f["remedy"],
            ]
            for f in d["fault"]
        ],
    )
    out.append("## Parameters\n\n`idle`: may only be set while idle.\n")
    out += markdown_table(
        ["#", "name", "unit", "least", "most", "default", "set", "meaning"],
        [
            [
                str(i),
                f"`{p['name']}`",
                p["unit"],
                f"{p['min']:g}",
                f"{p['max']:g}",
                f"{p['default']:g}",
                p["when"],
                p["meaning"],
            ]
            for i, p in enumerate(d["param"])
        ],
    )
    return "\n".join(out).rstrip("\n") + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing; fail when a file is stale")
    arguments = parser.parse_args()
    declaration = tomllib.loads(SOURCE.read_text(encoding="utf-8"))
    try:
        check(declaration)
    except DeclarationError as error:
        print(f"{SOURCE.name}: {error}", file=sys.stderr)
        return 2
    stale = []
    for path, text in (
        (CPP, generate_cpp(declaration)),
        (PYTHON, generate_python(declaration)),
        (DOC, generate_doc(declaration)),
    ):
        if path.exists() and path.read_text(encoding="utf-8") == text:
            continue
        stale.append(path)
        if not arguments.check:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
    for path in stale:
        print(
            f"{path.relative_to(ROOT)}: {'stale, run firmware/generate.py' if arguments.check else 'written'}"
        )
    return 1 if stale and arguments.check else 0


if __name__ == "__main__":
    sys.exit(main())
