"""Names, offsets, access and reset values against the vendor's description of the chip."""

from __future__ import annotations

import re
from dataclasses import dataclass
from xml.etree import ElementTree

import pytest
from due_emulator import Due

from tests.due import fetch_svd

pytestmark = pytest.mark.emulated

# Levels at pins: what is wired there decides, and the fault inputs inside of the chip are low.
_FROM_OUTSIDE = {"PDSR", "FSR", "SR0", "SR1", "SR2"}
# The description gives MOSCXTEN = 1 and no RC: with those no clock would run, and a Due starts on the RC.
_WRONG_THERE = {("PMC", "CKGR_MOR"), ("PMC", "PMC_SR"), ("PMC", "CKGR_MCFR"), ("RSTC", "RSTC_SR")}


@dataclass(frozen=True)
class Described:
    """One register of the description."""

    peripheral: str
    name: str
    address: int
    readable: bool
    writable: bool
    reset: int | None


def _registers(element: ElementTree.Element, base: int, peripheral: str) -> list[Described]:
    rows = []
    for register in element.findall("registers/register"):
        name = str(register.findtext("name"))
        offset = int(str(register.findtext("addressOffset")), 16)
        access = str(register.findtext("access"))
        value = register.findtext("resetValue")
        count = int(register.findtext("dim") or "1")
        step = int(register.findtext("dimIncrement") or "0", 0)
        for index in range(count):
            rows.append(
                Described(
                    peripheral,
                    name.replace("[%s]", str(index)),
                    base + offset + index * step,
                    access != "write-only",
                    access != "read-only",
                    int(value, 16) if value else None,
                )
            )
    return rows


@pytest.fixture(scope="module")
def described() -> dict[int, Described]:
    path = fetch_svd.find()
    if path is None:
        pytest.skip(fetch_svd.MISSING)
    rows = []
    for element in ElementTree.parse(path).getroot().iter("peripheral"):
        name = str(element.findtext("name"))
        rows += _registers(element, int(str(element.findtext("baseAddress")), 16), name)
    return {row.address: row for row in reversed(rows)}


@pytest.fixture(scope="module")
def due() -> Due:
    due = Due()
    due.set_strict(False)
    due.power_on()
    due.run_us(1)
    due.all_clocks_on(True)
    return due


def _plain(name: str) -> str:
    """Without the block's prefix: PIO_PER and PER are the same register."""
    return re.sub(r"^(PIO|TC|PWM|ADC|DACC|TRNG|UOTGHS|UART|EEFC|WDT|RSTC|SUPC|RTT|CHIPID)_", "", name)


def test_every_register_of_a_modelled_peripheral_is_known(described: dict[int, Described], due: Due) -> None:
    known = {base + offset for _, base, _, offset, *_ in due.registers()}
    modelled = {name for name, *_ in due.registers()}
    missing = [
        f"{r.peripheral}.{r.name}"
        for a, r in described.items()
        if r.peripheral in modelled and a not in known
    ]
    assert not missing
    assert len(known) > 400


def test_names_and_offsets_are_the_vendors(described: dict[int, Described], due: Due) -> None:
    mistakes = []
    for peripheral, base, name, offset, *_ in due.registers():
        row = described.get(base + offset)
        if row is None or row.peripheral != peripheral or _plain(row.name) != _plain(name):
            mistakes.append(f"{peripheral} {name} at {base + offset:#x}: the vendor has {row}")
    assert not mistakes


def test_access_is_the_vendors(described: dict[int, Described], due: Due) -> None:
    mistakes = []
    for peripheral, base, name, offset, readable, writable, _ in due.registers():
        row = described[base + offset]
        if (row.readable, row.writable) != (readable, writable):
            mistakes.append(f"{peripheral} {name}: {readable=} {writable=}, the vendor has {row}")
    assert not mistakes


def test_reset_values_are_the_vendors(described: dict[int, Described], due: Due) -> None:
    wrong, compared = [], 0
    for peripheral, base, name, offset, readable, _, modelled in due.registers():
        row = described[base + offset]
        if not (readable and modelled) or row.reset is None or _plain(name) in _FROM_OUTSIDE:
            continue
        if (peripheral, name) in _WRONG_THERE or name.startswith("PMC_PCSR"):
            continue
        value = due.read_word(base + offset)
        compared += 1
        if value != row.reset:
            wrong.append(f"{peripheral} {name}: {value:#x}, the vendor has {row.reset:#x}")
    assert not wrong
    assert compared > 150
