"""The declaration as C++: constants, enumerations, tables and messages."""

from __future__ import annotations

from firmware.generator.declared import (
    Table,
    camel,
    full_fields,
    link_hash,
    param_id,
    params_hash,
    rows,
    size_of,
)
from firmware.generator.laws import cpp_laws

CPP_TYPE = {
    "u8": "std::uint8_t",
    "u16": "std::uint16_t",
    "u32": "std::uint32_t",
    "u64": "std::uint64_t",
    "i16": "std::int16_t",
    "i32": "std::int32_t",
    "f32": "float",
}


def cpp_float(value: float) -> str:
    """A literal of single precision."""
    text = repr(float(value))
    return text + "F"


def generate_cpp(d: Table) -> str:
    """Text of core/link/declaration.hpp."""
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
        f"inline constexpr std::uint32_t kParamsHash = 0x{params_hash(d):08x}U;",
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
        values = [f"  {k} = {e['value']},  // {e['meaning']}" for k, e in rows(entries)]
        out += [*values, "};", f"inline constexpr std::size_t k{camel(name)}Count = {len(values)};", ""]
    for name, entries in d["bits"].items():
        out.append(f"// {entries['meaning']}")
        out.append(f"namespace {name} {{")
        for k, e in rows(entries):
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
        "  std::uint16_t id;  // in stored sets",
        "};",
        "inline constexpr ParamInfo kParams[kParamCount] = {",
    ]
    for p in d["param"]:
        flags = [p.get("nonzero", False), p.get("integer", False), p["when"] == "idle"]
        numbers = ", ".join(cpp_float(p[k]) for k in ("min", "max", "default"))
        out.append(
            f"    {{{numbers}, {', '.join(str(f).lower() for f in flags)}, 0x{param_id(p):04x}U}},  // {p['name']}"
        )
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
    out += cpp_laws(d)
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
