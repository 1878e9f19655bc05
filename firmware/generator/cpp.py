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
    """Return a number as a C++ literal of single precision."""
    return repr(float(value)) + "F"


def generate_cpp(declaration: Table) -> str:
    """Return the text of core/link/declaration.hpp."""
    lines = [
        *_head(declaration),
        *_enumerations(declaration),
        *_parameter_table(declaration),
        *_channel_table(declaration),
        *cpp_laws(declaration),
        "enum class MessageId : std::uint8_t {",
        *(f"  {message['name']} = {message['id']}," for message in declaration["message"]),
        "};",
        "",
        "// Floats of a message, which follow each other: byte offset and position of the first, and how many.",
        "struct Floats {",
        "  std::uint8_t offset;",
        "  std::uint8_t field;",
        "  std::uint8_t count;",
        "};",
        "",
        *(line for message in declaration["message"] for line in _message_struct(message)),
        "}  // namespace heli::link",
        "",
    ]
    return "\n".join(lines)


def _head(declaration: Table) -> list[str]:
    """Return the includes and the constants of the link."""
    link = declaration["link"]
    link_major, link_minor = (int(part) for part in link["version"].split("."))
    firmware_major, firmware_minor, firmware_patch = (int(part) for part in link["firmware"].split("."))
    return [
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
        f"inline constexpr std::uint32_t kLinkHash = 0x{link_hash(declaration):08x}U;",
        f"inline constexpr std::uint32_t kParamsHash = 0x{params_hash(declaration):08x}U;",
        f"inline constexpr std::uint8_t kLinkMajor = {link_major};",
        f"inline constexpr std::uint8_t kLinkMinor = {link_minor};",
        f"inline constexpr std::uint8_t kFirmwareMajor = {firmware_major};",
        f"inline constexpr std::uint8_t kFirmwareMinor = {firmware_minor};",
        f"inline constexpr std::uint8_t kFirmwarePatch = {firmware_patch};",
        f"inline constexpr std::uint8_t kProtocol = {link['protocol']};",
        f"inline constexpr std::uint32_t kBaud = {link['baud']};",
        f"inline constexpr std::uint32_t kTick_us = {link['tick_us']};",
        f"inline constexpr std::size_t kMaxCommandPayload = {link['max_command_payload']};",
        f"inline constexpr std::size_t kMaxTelemetryPayload = {link['max_telemetry_payload']};",
        "",
        "// Distances between the accepted setpoints and these parameters, in degrees.",
        *(
            f"inline constexpr float k{camel(name.removesuffix('_deg'))}Margin_deg = {cpp_float(value)};"
            for name, value in declaration["setpoint_margin"].items()
        ),
        "",
    ]


def _enumerations(declaration: Table) -> list[str]:
    """Return the declared enumerations and sets of bits, and the enumeration of the faults."""
    lines: list[str] = []
    for name, entries in declaration["enums"].items():
        values = [f"  {key} = {entry['value']},  // {entry['meaning']}" for key, entry in rows(entries)]
        lines += [f"// {entries['meaning']}", f"enum class {camel(name)} : std::uint8_t {{", *values, "};"]
        lines += [f"inline constexpr std::size_t k{camel(name)}Count = {len(values)};", ""]
    for name, entries in declaration["bits"].items():
        lines += [f"// {entries['meaning']}", f"namespace {name} {{"]
        lines += [
            f"inline constexpr std::uint8_t {key} = 1U << {entry['bit']}U;  // {entry['meaning']}"
            for key, entry in rows(entries)
        ]
        lines += [f"}}  // namespace {name}", ""]
    lines += ["enum class Fault : std::uint8_t {", "  none = 0,"]
    lines += [
        f"  {fault['name']} = {fault['code']},  // {fault['kind']}: {fault['meaning']}"
        for fault in declaration["fault"]
    ]
    return [*lines, "};", ""]


def _parameter_table(declaration: Table) -> list[str]:
    """Return the enumeration and the table of the parameters."""
    lines = ["enum class Param : std::uint8_t {"]
    lines += [
        f"  {param['name']} = {index},  // {param['unit']}: {param['meaning']}"
        for index, param in enumerate(declaration["param"])
    ]
    lines += [
        "};",
        f"inline constexpr std::size_t kParamCount = {len(declaration['param'])};",
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
    for param in declaration["param"]:
        flags = [param.get("nonzero", False), param.get("integer", False), param["when"] == "idle"]
        literals = [cpp_float(param[key]) for key in ("min", "max", "default")]
        literals += [str(flag).lower() for flag in flags]
        literals.append(f"0x{param_id(param):04x}U")
        lines.append(f"    {{{', '.join(literals)}}},  // {param['name']}")
    return [*lines, "};", ""]


def _channel_table(declaration: Table) -> list[str]:
    """Return the enumeration of the telemetry channels, their sizes and their scales."""
    lines = ["enum class Channel : std::uint8_t {"]
    lines += [
        f"  {channel['name']} = {index},  // {channel['unit']}: {channel['meaning']}"
        for index, channel in enumerate(declaration["channel"])
    ]
    sizes = ", ".join(str(size_of(channel["type"])) for channel in declaration["channel"])
    lines += [
        "};",
        f"inline constexpr std::size_t kChannelCount = {len(declaration['channel'])};",
        f"inline constexpr std::uint8_t kChannelBytes[kChannelCount] = {{{sizes}}};",
    ]
    for channel in declaration["channel"]:
        if channel["scale"] != 1.0:
            raw_per_unit = cpp_float(round(1 / channel["scale"], 6))
            lines.append(
                f"inline constexpr float k{camel(channel['name'])}PerUnit = {raw_per_unit};"
                f"  // raw = value in {channel['unit']} * this"
            )
    return [*lines, ""]


def _message_struct(message: Table) -> list[str]:
    """Return the struct of a message, which writes its fields to bytes and reads them."""
    fields = full_fields(message)
    name = f"{camel(message['name'])}Message"
    lines = [f"// {message['meaning']}", f"struct {name} {{"]
    lines.append(f"  static constexpr MessageId kId = MessageId::{message['name']};")
    lines.append(f"  static constexpr std::size_t kSize = {sum(size_of(field['type']) for field in fields)};")
    lines += [
        f"  {CPP_TYPE[field['type']]} {field['name']} = {{}};  // {field['unit'] or '-'}" for field in fields
    ]
    offsets = [sum(size_of(field["type"]) for field in fields[:index]) for index in range(len(fields))]
    if message["kind"] in ("command", "stream"):  # the board's dispatcher uses kFloats
        floats = [index for index, field in enumerate(fields) if field["type"] == "f32"]
        first = floats[0] if floats else 0
        lines.append(f"  static constexpr Floats kFloats = {{{offsets[first]}, {first}, {len(floats)}}};")
    lines.append("  void write([[maybe_unused]] std::uint8_t* to) const {")
    lines += [
        f"    put_{field['type']}(to + {offset}, {field['name']});"
        for field, offset in zip(fields, offsets, strict=True)
    ]
    lines.append("  }")
    lines.append(f"  static {name} read([[maybe_unused]] const std::uint8_t* from) {{")
    lines.append(f"    {name} m;")
    lines += [
        f"    m.{field['name']} = get_{field['type']}(from + {offset});"
        for field, offset in zip(fields, offsets, strict=True)
    ]
    return [*lines, "    return m;", "  }", "};", ""]
