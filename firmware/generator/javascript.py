"""The declaration as JavaScript: the tables of the small host that flies in a browser."""

from __future__ import annotations

import json

from firmware.generator.declared import STRUCT_CODE, Table, full_fields, link_hash, params_hash, rows


def generate_javascript(declaration: Table) -> str:
    """Return the text of sim/web/heli_web/page/declaration.js."""
    link = declaration["link"]
    names = {
        name: {entry: values["value"] for entry, values in rows(entries)}
        for name, entries in declaration["enums"].items()
    }
    names["fault"] = {"none": 0} | {fault["name"]: fault["code"] for fault in declaration["fault"]}
    for bits in ("axes", "flags"):
        names[bits] = {name: 1 << entry["bit"] for name, entry in rows(declaration["bits"][bits])}
    constants = {
        "LINK": {key: link[key] for key in ("version", "firmware", "protocol", "tick_us")}
        | {"hash": link_hash(declaration), "params_hash": params_hash(declaration)}
        | {key: link[key] for key in ("max_command_payload", "max_telemetry_payload")},
        "NAMES": names,
        "MESSAGES": {
            message["name"]: {
                "id": message["id"],
                "reply": message.get("reply", ""),
                "fields": [[field["name"], STRUCT_CODE[field["type"]]] for field in full_fields(message)],
            }
            for message in declaration["message"]
        },
        "CHANNELS": [
            [channel["name"], STRUCT_CODE[channel["type"]], channel["unit"], channel["scale"]]
            for channel in declaration["channel"]
        ],
        "SETPOINT_MARGIN_DEG": declaration["setpoint_margin"],
    }
    lines = ["// Written by firmware/generate.py from firmware/link.toml. Do not edit."]
    lines += [f"export const {name} = {json.dumps(value)};" for name, value in constants.items()]
    return "\n".join(lines) + "\n"
