"""The declaration for MATLAB and Octave: a function that returns all of it as a structure."""

from __future__ import annotations

from firmware.generator import channels
from firmware.generator.declared import Table, full_fields, link_hash, rows


def generate_matlab(declaration: Table) -> str:
    """Return the text of docs/matlab/heli_declaration.m."""
    link = declaration["link"]
    lines = [
        "function d = heli_declaration()",
        "% HELI_DECLARATION  Messages, channels, parameters and faults of the link, as a structure.",
        "%",
        "% Written by firmware/generate.py from firmware/link.toml. Do not edit.",
        "",
        f"d.link_version = {quoted(link['version'])};",
        f"d.link_hash = uint32({link_hash(declaration)});",
    ]
    lines += [
        f"d.{name} = {link[name]};"
        for name in ("protocol", "baud", "tick_us", "max_command_payload", "max_telemetry_payload")
    ]
    lines += ["", "% Messages: id, names and types of their fields, the reply.", "d.messages = struct();"]
    for message in declaration["message"]:
        fields = full_fields(message)
        names = ", ".join(quoted(field["name"]) for field in fields)
        types = ", ".join(quoted(field["type"]) for field in fields)
        lines.append(
            f"d.messages.{message['name']} = struct('id', {message['id']}, 'fields', {{{{{names}}}}}, "
            f"'types', {{{{{types}}}}}, 'reply', {quoted(message.get('reply', ''))});"
        )
    lines += ["", "% Enumerations and sets of bits: numbers by name.", "d.enums = struct();"]
    for name, entries in declaration["enums"].items():
        lines += [f"d.enums.{name}.{key} = {entry['value']};" for key, entry in rows(entries)]
    for name, entries in declaration["bits"].items():
        lines += [f"d.enums.{name}.{key} = {1 << entry['bit']};" for key, entry in rows(entries)]
    lines += [
        "",
        "% Channels in the order of the wire: name, type, scale, column of samples.",
        "d.channels = {",
    ]
    for channel in declaration["channel"]:
        column = channels.column(channel)
        lines.append(
            f"  {quoted(channel['name'])}, {quoted(channel['type'])}, {float(channel['scale']):g}, {quoted(column)}"
        )
    lines += [
        "};",
        "",
        "% Parameters in the order of the table: name, unit, least, most, default.",
        "d.parameters = {",
    ]
    for param in declaration["param"]:
        numbers = ", ".join(f"{float(param[key]):.9g}" for key in ("min", "max", "default"))
        lines.append(f"  {quoted(param['name'])}, {quoted(param['unit'])}, {numbers}")
    lines += ["};", "", "% Faults: code, name, what it means and what to do.", "d.faults = {"]
    for field in declaration["fault"]:
        lines.append(
            f"  {field['code']}, {quoted(field['name'])}, {quoted(field['meaning'])}, {quoted(field['remedy'])}"
        )
    lines += ["};", "end", ""]
    return "\n".join(lines)


def quoted(value: str) -> str:
    """Return a text as a MATLAB string."""
    return "'" + value.replace("'", "''") + "'"
