"""The vendor's description of the SAM3X8E, which tests/due/fetch_svd.py fetches and finds, taken apart."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree


@dataclass(frozen=True)
class Register:
    """One register."""

    offset: int  # From the start of its peripheral
    access: str  # read-only, write-only or read-write
    count: int  # Length of an array; 1 for a single register
    fields: dict[str, tuple[int, int]]  # Lowest bit and width of each field
    values: dict[tuple[str, str], int]  # Values of fields that have names, by field and name


@dataclass(frozen=True)
class Peripheral:
    """One peripheral."""

    address: int  # Where it begins
    registers: dict[str, Register]  # By name, without the peripheral's prefix


@dataclass(frozen=True)
class Description:
    """The chip."""

    peripherals: dict[str, Peripheral]  # By name
    # Number of each interrupt, which is also the identifier of the peripheral's clock
    interrupts: dict[str, int]


def _text(node: ElementTree.Element, name: str) -> str:
    text = node.findtext(name)
    return "" if text is None else text.strip()


def _register(node: ElementTree.Element) -> Register:
    fields, values = {}, {}
    for field in node.iter("field"):
        name = _text(field, "name")
        fields[name] = (
            int(_text(field, "bitOffset") or _text(field, "lsb"), 0),
            int(_text(field, "bitWidth") or "1"),
        )
        for value in field.iter("enumeratedValue"):
            values[name, _text(value, "name")] = int(_text(value, "value"), 0)
    count = int(_text(node, "dim") or "1", 0)
    return Register(int(_text(node, "addressOffset"), 0), _text(node, "access"), count, fields, values)


def read_description(path: Path) -> Description:
    """Take the file apart."""
    root = ElementTree.parse(path).getroot()
    nodes = {_text(node, "name"): node for node in root.iter("peripheral")}
    peripherals = {}
    interrupts = {}
    for name, node in nodes.items():
        source = nodes[node.get("derivedFrom", name)]
        prefixes = (f"{name}_", f"{name.rstrip('0123456789')}_")
        registers = {}
        for register in source.iter("register"):
            short = _text(register, "name").removesuffix("[%s]")
            for prefix in prefixes:
                short = short.removeprefix(prefix)
            registers[short] = _register(register)
        peripherals[name] = Peripheral(int(_text(node, "baseAddress"), 0), registers)
        for interrupt in node.findall("interrupt"):
            interrupts[_text(interrupt, "name")] = int(_text(interrupt, "value"), 0)
    return Description(peripherals, interrupts)
