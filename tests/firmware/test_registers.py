"""registers.hpp says what the vendor's description of the chip says."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.firmware import built
from tests.firmware.description import Description, Register

pytestmark = pytest.mark.emulated

HEADER = built.DRIVERS / "registers.hpp"

# Structures of the header: their peripheral in the description, and where in it they begin.
BLOCKS = {
    "Pmc": ("PMC", 0),
    "Uart": ("UART", 0),
    "Efc": ("EFC0", 0),
    "Pio": ("PIOA", 0),
    "Rstc": ("RSTC", 0),
    "Wdt": ("WDT", 0),
    "Gpbr": ("GPBR", 0),
    "Tc": ("TC0", 0),
    "Pwm": ("PWM", 0),
    "Trng": ("TRNG", 0),
}
# Structures that stand in others: who holds them, in which array, of how many.
NESTED = {"TcChannel": ("Tc", "TC_CHANNEL", 3), "PwmChannel": ("Pwm", "PWM_CH_NUM", 8)}

PREFIXES = ("PMC_", "UART_", "EEFC_", "PIO_", "RSTC_", "WDT_", "SYS_", "TC_", "PWM_", "TRNG_")

ACCESS = {"ReadOnly": "read-only", "WriteOnly": "write-only", "ReadWrite": "read-write"}


@dataclass(frozen=True)
class Member:
    """A register of the header."""

    block: str  # Its structure
    access: str  # Its type
    name: str  # As in the datasheet


def text() -> str:
    return HEADER.read_text()


def members() -> list[Member]:
    matches = []
    for block in re.finditer(r"^struct (\w+) \{\n(.*?)^\};", text(), re.MULTILINE | re.DOTALL):
        for line in re.finditer(
            r"^  (ReadOnly|WriteOnly|ReadWrite) (\w+)(?:\[\d+\])?;", block[2], re.MULTILINE
        ):
            matches.append(Member(block[1], line[1], line[2]))
    return matches


def short(name: str) -> str:
    for prefix in PREFIXES:
        if name.startswith(prefix):
            return name.removeprefix(prefix)
    return name


def described(description: Description, member: Member) -> list[tuple[int, Register]]:
    """The same register in the description: index in an array of channels, and what it says."""
    block, _, count = NESTED.get(member.block, (member.block, "", 0))
    peripheral = description.peripherals[BLOCKS[block][0]]
    name = short(member.name)
    if not count:
        return [(0, peripheral.registers[name])]
    return [(index, peripheral.registers[f"{name}{index}"]) for index in range(count)]


def compile_claims(claims: list[str], folder: Path) -> None:
    compiler = shutil.which("c++") or shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        pytest.skip("no C++ compiler is installed")
    source = folder / "claims.cpp"
    lines = ["#include <cstddef>", f'#include "{HEADER}"', "using namespace heli::due;", *claims]
    source.write_text("\n".join(lines) + "\n")
    flags = ["-std=c++17", "-fsyntax-only", "-Wno-int-to-pointer-cast", "-Wno-invalid-offsetof"]
    process = subprocess.run([compiler, *flags, source], capture_output=True, text=True, check=False)
    failed = re.findall(r"static assertion failed[^\n]*|error:[^\n]*", process.stderr)
    assert process.returncode == 0, "\n".join(failed)


def test_every_register_of_the_header_is_in_the_description(description: Description) -> None:
    assert len(members()) > 60
    for member in members():
        assert described(description, member)


def test_registers_stand_where_the_description_has_them(description: Description, tmp_path: Path) -> None:
    claims = []
    for member in members():
        for index, register in described(description, member):
            place = f"{member.block}, {member.name}"
            if member.block in NESTED:
                outer, array, _ = NESTED[member.block]
                place = f"{outer}, {array}[{index}].{member.name}"
            claims.append(f'static_assert(offsetof({place}) == {register.offset:#x}, "{place}");')
    compile_claims(claims, tmp_path)


def test_registers_can_be_read_and_written_as_on_the_chip(description: Description) -> None:
    mistakes = [
        f"{member.name} is {register.access}, the header says {ACCESS[member.access]}"
        for member in members()
        for _, register in described(description, member)
        if ACCESS[member.access] != register.access
    ]
    assert not mistakes, "\n".join(mistakes)


def test_peripherals_stand_where_the_description_has_them(description: Description) -> None:
    definitions = re.findall(r"^inline constexpr At<(\w+)> (\w+)\{(0x[0-9A-Fa-f]+)\};", text(), re.MULTILINE)
    assert len(definitions) >= len(BLOCKS)
    for _, name, address in definitions:
        assert int(address, 16) == description.peripherals[name].address, name


def test_identifiers_are_those_of_the_description(description: Description) -> None:
    definitions = re.findall(r"^inline constexpr unsigned ID_(\w+) = (\d+);", text(), re.MULTILINE)
    assert definitions
    for name, number in definitions:
        assert description.interrupts[name] == int(number), name


def split(constant: str, description: Description) -> tuple[list[Register], str]:
    """A constant's registers, and what follows their name in it: PMC_SR_LOCKA is LOCKA of SR."""
    prefix = constant.partition("_")[0]
    peripheral = {"CKGR": "PMC", "EEFC": "EFC0", "TC": "TC0"}.get(prefix, prefix)
    registers = description.peripherals[peripheral].registers
    for key in (constant, constant.removeprefix(f"{prefix}_")):
        for length in range(key.count("_"), 0, -1):
            words = key.split("_")
            name, rest = "_".join(words[:length]), "_".join(words[length:])
            hits = [registers[also] for also in (name, f"{name}0", f"{name}0_WAVE_EQ_1") if also in registers]
            if hits:
                return hits, rest
    raise AssertionError(f"{constant} belongs to no register")


def test_bits_and_fields_are_those_of_the_description(description: Description) -> None:
    bits = re.findall(r"^inline constexpr std::uint32_t (\w+) = bit\((\d+)\);", text(), re.MULTILINE)
    fields = re.findall(r"^inline constexpr Field (\w+)\{(\d+), (\d+)\};", text(), re.MULTILINE)
    assert len(bits) + len(fields) > 60
    mistakes = []
    for name, offset, width in [*((name, offset, "1") for name, offset in bits), *fields]:
        registers, field = split(name, description)
        says = {register.fields[field] for register in registers if field in register.fields}
        if says != {(int(offset), int(width))}:
            mistakes.append(f"{name}: {offset}, {width} instead of {says}")
    assert not mistakes, "\n".join(mistakes)


def test_named_values_are_those_of_the_description(description: Description) -> None:
    values = re.findall(r"^inline constexpr std::uint32_t (\w+) =\s*(\w+)\((\d+)\);", text(), re.MULTILINE)
    values = [value for value in values if value[1] != "bit"]
    assert len(values) >= 8
    mistakes = []
    for name, field_name, value in values:
        registers, field = split(field_name, description)
        meaning = name.removeprefix(field_name + "_")
        says = {register.values.get((field, meaning)) for register in registers} - {None}
        if says != {int(value)}:
            mistakes.append(f"{name}: {value} instead of {says}")
    assert not mistakes, "\n".join(mistakes)


def test_no_constant_of_the_header_escapes_these_tests() -> None:
    kinds = (r"At<\w+> \w+\{0x\w+\};", r"unsigned ID_\w+ = \d+;", r"Field \w+\{\d+, \d+\};")
    known = [*kinds, r"std::uint32_t \w+ =\s*\w+\(\d+\);"]
    constants = re.findall(r"^inline constexpr ([^;]+;)", text(), re.MULTILINE)
    assert not [line for line in constants if not any(re.fullmatch(kind, line) for kind in known)]
