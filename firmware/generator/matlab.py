"""The declaration as MATLAB and Octave: one function that returns it all as a structure."""

from __future__ import annotations

from firmware.generator import channels
from firmware.generator.declared import Table, full_fields, link_hash, rows


def generate_matlab(d: Table) -> str:
    """Text of docs/matlab/heli_declaration.m."""
    link = d["link"]
    out = [
        "function d = heli_declaration()",
        "% HELI_DECLARATION  Messages, channels, parameters and faults of the link, as a structure.",
        "%",
        "% Written by firmware/generate.py from firmware/link.toml. Do not edit.",
        "",
        f"d.link_version = {text(link['version'])};",
        f"d.link_hash = uint32({link_hash(d)});",
    ]
    out += [
        f"d.{name} = {link[name]};"
        for name in ("protocol", "baud", "tick_us", "max_command_payload", "max_telemetry_payload")
    ]
    out += ["", "% Messages: id, names and types of their fields, the reply.", "d.messages = struct();"]
    for m in d["message"]:
        fields = full_fields(m)
        names = ", ".join(text(f["name"]) for f in fields)
        types = ", ".join(text(f["type"]) for f in fields)
        out.append(
            f"d.messages.{m['name']} = struct('id', {m['id']}, 'fields', {{{{{names}}}}}, "
            f"'types', {{{{{types}}}}}, 'reply', {text(m.get('reply', ''))});"
        )
    out += ["", "% Enumerations and sets of bits: numbers by name.", "d.enums = struct();"]
    for name, entries in d["enums"].items():
        out += [f"d.enums.{name}.{key} = {entry['value']};" for key, entry in rows(entries)]
    for name, entries in d["bits"].items():
        out += [f"d.enums.{name}.{key} = {1 << entry['bit']};" for key, entry in rows(entries)]
    out += [
        "",
        "% Channels in the order of the wire: name, type, scale, column of samples.",
        "d.channels = {",
    ]
    for c in d["channel"]:
        column = channels.column(c)
        out.append(f"  {text(c['name'])}, {text(c['type'])}, {float(c['scale']):g}, {text(column)}")
    out += [
        "};",
        "",
        "% Parameters in the order of the table: name, unit, least, most, default.",
        "d.parameters = {",
    ]
    for p in d["param"]:
        numbers = ", ".join(f"{float(p[key]):.9g}" for key in ("min", "max", "default"))
        out.append(f"  {text(p['name'])}, {text(p['unit'])}, {numbers}")
    out += ["};", "", "% Faults: code, name, what it means and what to do.", "d.faults = {"]
    for f in d["fault"]:
        out.append(f"  {f['code']}, {text(f['name'])}, {text(f['meaning'])}, {text(f['remedy'])}")
    out += ["};", "end", ""]
    return "\n".join(out)


def text(value: str) -> str:
    """A string of MATLAB."""
    return "'" + value.replace("'", "''") + "'"
