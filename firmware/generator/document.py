"""The declaration for people: the pages link, parameters and faults in docs/reference."""

from __future__ import annotations

from firmware.generator import channels
from firmware.generator.declared import Table, full_fields, link_hash, rows, size_of
from firmware.generator.laws import document_laws

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
- A value is its raw number times the scale, in the unit. An encoder's count is an angle: 2 pi / |`*_counts_per_rev`| rad each, by the parameter of
  its axis. Samples, tables and logs hold every channel, under the names given here.
"""

FAULTS = """\
# Faults

The board reports a fault by number and name. This page lists every fault with its meaning and what to do; for a longer answer, see
[troubleshooting](../how-to/troubleshooting.md). The column *limit* names the parameter that sets the threshold: see
[Parameters](parameters.md). `firmware/generate.py` writes this page from `firmware/link.toml`.

A latched fault stays until you clear it with `heli-host fly ... --clear-fault`, or on the dashboard.
"""
FAULT_KINDS = {
    "trip": "the board cuts the motors and latches the fault.",
    "land": "the board lands, then cuts the motors and latches the fault.",
    "check": "the board refuses to arm.",
    "boot": "the board reports the fault when it starts.",
}
PARAMETERS = """\
# Parameters

The board has these parameters. `heli-host params list --long` prints them, and `heli-host params set NAME VALUE --save` changes one.
`heli-host tune` writes those of a control law for your rig. `firmware/generate.py` writes this page from `firmware/link.toml`.

- *range*: the board refuses every other value.
- *set*: when the parameter may change; `idle` means only while the motors are off.
"""


def markdown_table(header: list[str], body: list[list[str]]) -> list[str]:
    """The lines of a table."""
    return [
        "| " + " | ".join(header) + " |",
        "|" + "---|" * len(header),
        *("| " + " | ".join(row) + " |" for row in body),
        "",
    ]


def generate_doc(d: Table) -> str:
    """Text of docs/reference/link.md."""
    declared = d["channel"]
    text = FRAMING.format(
        hash=link_hash(d),
        nibble_bytes=(len(declared) + 1) // 2,
        base_bytes=sum(size_of(c["type"]) for c in declared),
        **d["link"],
    )
    out = [
        text,
        *markdown_table(
            ["channel", "base", "unit", "scale", "in samples and tables", "in logs", "meaning"],
            [
                [
                    f"`{c['name']}`",
                    c["type"],
                    c["unit"],
                    f"{c['scale']:g}",
                    f"`{channels.column(c)}`",
                    ", ".join(f"`{name}`" for name in channels.fields(c)),
                    c["meaning"],
                ]
                for c in declared
            ],
        ),
    ]
    out += document_laws(d)
    out.append("## Messages\n")
    for m in d["message"]:
        reply = f", answered by `{m['reply']}`" if m["kind"] == "command" else ""
        frozen = ", layout frozen for ever" if m.get("frozen") else ""
        out.append(f"### {m['id']} `{m['name']}` ({m['kind']}{reply}{frozen})\n\n{m['meaning']}\n")
        table = []
        offset = 0
        for f in full_fields(m):
            table.append([str(offset), f"`{f['name']}`", f["type"], f["unit"], f["meaning"]])
            offset += size_of(f["type"])
        if m.get("array"):
            table.append([str(offset), "values", m["array"] + "[]", "", "the array"])
        if table:
            out += markdown_table(["offset", "field", "type", "unit", "meaning"], table)
    for name, entries in d["enums"].items():
        out.append(f"## {name}\n\n{entries['meaning']}\n")
        table = [[str(e["value"]), f"`{k}`", e["meaning"]] for k, e in rows(entries)]
        out += markdown_table(["value", "name", "meaning"], table)
    for name, entries in d["bits"].items():
        out.append(f"## {name} (bits)\n\n{entries['meaning']}\n")
        table = [[str(e["bit"]), f"`{k}`", e["meaning"]] for k, e in rows(entries)]
        out += markdown_table(["bit", "name", "meaning"], table)
    out.append("Faults are in [Faults](faults.md), parameters in [Parameters](parameters.md).")
    return "\n".join(out).rstrip("\n") + "\n"


def generate_faults(d: Table) -> str:
    """Text of docs/reference/faults.md."""
    kinds = {f["kind"] for f in d["fault"]}
    out = [
        FAULTS,
        *(f"- `{kind}`: {meaning}" for kind, meaning in FAULT_KINDS.items() if kind in kinds),
        "",
        *markdown_table(
            ["code", "name", "kind", "limit", "meaning", "do"],
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
        ),
    ]
    return "\n".join(out).rstrip("\n") + "\n"


def generate_parameters(d: Table) -> str:
    """Text of docs/reference/parameters.md."""
    out = [
        PARAMETERS,
        *markdown_table(
            ["#", "name", "default", "range", "set", "meaning"],
            [
                [
                    str(i),
                    f"`{p['name']}`",
                    f"{p['default']:g} {p['unit']}".rstrip(),
                    f"{p['min']:g} to {p['max']:g}{kind_of(p)}",
                    p["when"],
                    p["meaning"],
                ]
                for i, p in enumerate(d["param"])
            ],
        ),
    ]
    return "\n".join(out).rstrip("\n") + "\n"


def kind_of(param: Table) -> str:
    """Which numbers between its ends a parameter takes, if not all."""
    whole = ", whole" if param.get("integer", False) else ""
    return whole + (", not 0" if param.get("nonzero", False) else "")
