"""The declaration as documents: the pages link, parameters and faults in docs/reference."""

from __future__ import annotations

from firmware.generator import channels
from firmware.generator.declared import Table, full_fields, link_hash, rows, size_of
from firmware.generator.laws import document_laws

FRAMING = """\
# The link, byte by byte

The link is the protocol between host and board. You need this page only to write a host of your own; `heli-host` and its
[Python package](python-api.md) do all of this for you. `firmware/generate.py` writes the page from `firmware/link.toml`.

| property | value |
|---|---|
| link version | {version} |
| hash of the declaration | `{hash:08x}` |
| serial port | {baud} baud, 8N1 |
| byte order | little-endian |
| `f32` | IEEE 754 single precision |

## Frame

```
COBS( protocol u8 = {protocol} | message id u8 | sequence u8 | payload | crc u32 ) 0x00
```

- **COBS** (consistent overhead byte stuffing) removes every zero from the frame, so a zero always marks its end. A receiver that joins in the
  middle, or loses bytes, is synchronised again at the next zero.
- **sequence** counts the frames of one direction, modulo 256. A gap means that frames were lost; host and board count these losses.
- **crc** is a cyclic redundancy check over everything before it: CRC-32 (IEEE 802.3, reflected, as zlib's `crc32`). A single flipped bit can
  move several bytes of a frame, which a 16-bit check would miss too often.
- **payload** has at most {max_command_payload} bytes towards the board, and {max_telemetry_payload} bytes from it.

## Commands

The board answers each command with exactly one reply, which repeats the `request` number of the command. The host sends one command at a time. It
repeats the command, with the same number, until the reply comes.

The board remembers the number and the reply of the last command. It answers a repeated command from memory, and does not execute it again. A
command therefore takes effect exactly once, even if the command or its reply is lost. `hello` with a new session number clears this memory.

Streams (`setpoint`, `voltages`) have no reply; the latest value counts.

## Telemetry batch

```
first_tick u32 | count u8 | widths {nibble_bytes} bytes | bases {base_bytes} bytes | deltas
```

- Sample `k` of a batch belongs to tick `first_tick + k`. The board's timer counts a tick every {tick_us} us.
- **widths**: one nibble per channel, low nibble first (table below).
- **bases**: the first sample of every channel, in its own type, in the order of the channels below.
- **deltas**: for every channel with a width above 0, in the same order, `count - 1` differences to the sample before. They are modulo 2^32, in two's
  complement of the given width, and packed from the least significant bit. Each channel starts on a new byte.

| nibble | 0 | 1 | 2 | 3 | 4 | 5 |
|---|---|---|---|---|---|---|
| bits of a delta | 0 | 2 | 4 | 8 | 16 | 32 |

A value is its raw number times the scale, in the given unit. One count of an encoder is an angle of 2 pi / |`*_counts_per_rev`| rad,
with the parameter of its axis. Samples, tables and logs contain every channel, with these names:
"""

FAULTS = """\
# Faults

The board reports a fault by number and name. This table states the meaning of each fault and how to fix it. To check an encoder or a sign,
run `heli-host watch` and move the arm by hand. To zero an axis, click *zero* on the dashboard. The column *limit* names the
[parameter](parameters.md) that sets the threshold. For other symptoms, see [troubleshooting](../how-to/troubleshooting.md).

A latched fault stays until you clear it with `heli-host fly ... --clear-fault`, or on the dashboard. The column *kind* states what the board does:
"""
FAULT_KINDS = {
    "trip": "the board cuts the motors and latches the fault.",
    "land": "the board lands, then cuts the motors and latches the fault.",
    "check": "the board refuses to arm.",
    "boot": "the board reports the fault when it starts.",
}
PARAMETERS = """\
# Parameters

The board stores these parameters: encoders, motors, limits and gains. `heli-host params list --long` prints them, and
`heli-host params set NAME VALUE --save` changes one. `heli-host tune` designs the gains for your rig.

- *range*: the board refuses every other value.
- *set*: when the parameter may change; `idle` means only while the motors are off.
"""


def markdown_table(header: list[str], body: list[list[str]]) -> list[str]:
    """Return the lines of a Markdown table."""
    return [
        "| " + " | ".join(header) + " |",
        "|" + "---|" * len(header),
        *("| " + " | ".join(row) + " |" for row in body),
        "",
    ]


def generate_doc(declaration: Table) -> str:
    """Return the text of docs/reference/link.md."""
    all_channels = declaration["channel"]
    text = FRAMING.format(
        hash=link_hash(declaration),
        nibble_bytes=(len(all_channels) + 1) // 2,  # two channels per byte
        base_bytes=sum(size_of(channel["type"]) for channel in all_channels),
        **declaration["link"],
    )
    out = [
        text,
        *markdown_table(
            ["channel", "base", "unit", "scale", "in samples and tables", "in logs", "meaning"],
            [
                [
                    f"`{channel['name']}`",
                    channel["type"],
                    channel["unit"],
                    f"{channel['scale']:g}",
                    f"`{channels.column(channel)}`",
                    ", ".join(f"`{name}`" for name in channels.fields(channel)),
                    channel["meaning"],
                ]
                for channel in all_channels
            ],
        ),
    ]
    out += document_laws(declaration)
    out.append("## Messages\n")
    for message in declaration["message"]:
        out += _message_section(message)
    for name, entries in declaration["enums"].items():
        out.append(f"## {name}\n\n{entries['meaning']}\n")
        table = [[str(entry["value"]), f"`{key}`", entry["meaning"]] for key, entry in rows(entries)]
        out += markdown_table(["value", "name", "meaning"], table)
    for name, entries in declaration["bits"].items():
        out.append(f"## {name} (bits)\n\n{entries['meaning']}\n")
        table = [[str(entry["bit"]), f"`{key}`", entry["meaning"]] for key, entry in rows(entries)]
        out += markdown_table(["bit", "name", "meaning"], table)
    out.append("See also [Faults](faults.md) and [Parameters](parameters.md).")
    return "\n".join(out).rstrip("\n") + "\n"


def _message_section(message: Table) -> list[str]:
    """Return the head of a message and the table of its fields, if it has any."""
    reply = f", answered by `{message['reply']}`" if message["kind"] == "command" else ""
    frozen = ", layout frozen for ever" if message.get("frozen") else ""
    kind = f"{message['kind']}{reply}{frozen}"
    section = [f"### {message['id']} `{message['name']}` ({kind})\n\n{message['meaning']}\n"]
    table = []
    offset = 0
    for field in full_fields(message):
        table.append([str(offset), f"`{field['name']}`", field["type"], field["unit"], field["meaning"]])
        offset += size_of(field["type"])
    if message.get("array"):
        table.append([str(offset), "values", message["array"] + "[]", "", "the array"])
    if table:
        section += markdown_table(["offset", "field", "type", "unit", "meaning"], table)
    return section


def generate_faults(declaration: Table) -> str:
    """Return the text of docs/reference/faults.md."""
    kinds = {fault["kind"] for fault in declaration["fault"]}
    out = [
        FAULTS,
        *(f"- `{kind}`: {meaning}" for kind, meaning in FAULT_KINDS.items() if kind in kinds),
        "",
        *markdown_table(
            ["code", "name", "kind", "limit", "meaning", "fix"],
            [
                [
                    str(fault["code"]),
                    f"`{fault['name']}`",
                    fault["kind"],
                    f"`{fault['parameter']}`" if "parameter" in fault else "",
                    fault["meaning"],
                    fault["remedy"],
                ]
                for fault in declaration["fault"]
            ],
        ),
    ]
    return "\n".join(out).rstrip("\n") + "\n"


def generate_parameters(declaration: Table) -> str:
    """Return the text of docs/reference/parameters.md."""
    out = [
        PARAMETERS,
        *markdown_table(
            ["#", "name", "default", "range", "set", "meaning"],
            [
                [
                    str(index),
                    f"`{param['name']}`",
                    f"{param['default']:g} {param['unit']}".rstrip(),
                    f"{param['min']:g} to {param['max']:g}{kind_of(param)}",
                    param["when"],
                    param["meaning"],
                ]
                for index, param in enumerate(declaration["param"])
            ],
        ),
    ]
    return "\n".join(out).rstrip("\n") + "\n"


def kind_of(param: Table) -> str:
    """Return a restriction of the numbers in the range of a parameter, such as ", whole"; empty without one."""
    whole = ", whole" if param.get("integer", False) else ""
    return whole + (", not 0" if param.get("nonzero", False) else "")
