"""Registers against the vendor's description, and programs in plain C as on a desk."""

import contextlib
import io
import re
import shutil
import struct
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import fetch_svd
import pytest
from due_chip import PROGRAMS, Build
from due_emulator import Due, Image, new_due, read_image
from fetch_svd import Register

pytestmark = pytest.mark.emulated

# Levels at pins: what is wired there decides, and the fault inputs inside of the chip are low.
_FROM_OUTSIDE = {"PDSR", "FSR", "SR0", "SR1", "SR2"}
# The description gives MOSCXTEN = 1 and no RC: with those no clock would run, and a Due starts on the RC.
_WRONG_THERE = {("PMC", "CKGR_MOR"), ("PMC", "PMC_SR"), ("PMC", "CKGR_MCFR"), ("RSTC", "RSTC_SR")}


@pytest.fixture(scope="module")
def described() -> dict[int, Register]:
    """The vendor's registers by address."""
    vendors = fetch_svd.description()
    if vendors is None:
        pytest.skip(fetch_svd.MISSING)
    rows: dict[int, Register] = {}
    for peripheral in vendors.peripherals.values():
        for register in peripheral.registers.values():
            for index in range(register.count):
                name = register.name.replace("[%s]", str(index))
                address = peripheral.address + register.offset + index * register.step
                rows.setdefault(address, replace(register, name=name))
    return rows


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


def test_every_register_of_a_modelled_peripheral_is_known(described: dict[int, Register], due: Due) -> None:
    known = {base + offset for _, base, _, offset, *_ in due.registers()}
    modelled = {name for name, *_ in due.registers()}
    missing = [
        f"{r.peripheral}.{r.name}"
        for a, r in described.items()
        if r.peripheral in modelled and a not in known
    ]
    assert not missing
    assert len(known) > 400


def test_names_and_offsets_are_the_vendors(described: dict[int, Register], due: Due) -> None:
    mistakes = []
    for peripheral, base, name, offset, *_ in due.registers():
        row = described.get(base + offset)
        if row is None or row.peripheral != peripheral or _plain(row.name) != _plain(name):
            mistakes.append(f"{peripheral} {name} at {base + offset:#x}: the vendor has {row}")
    assert not mistakes


def test_access_is_the_vendors(described: dict[int, Register], due: Due) -> None:
    mistakes = []
    for peripheral, base, name, offset, readable, writable, _ in due.registers():
        row = described[base + offset]
        if (row.access != "write-only", row.access != "read-only") != (readable, writable):
            mistakes.append(f"{peripheral} {name}: {readable=} {writable=}, the vendor has {row}")
    assert not mistakes


def test_reset_values_are_the_vendors(described: dict[int, Register], due: Due) -> None:
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


HEADER = PROGRAMS / "due.h"
OPTIONS = ("-Os", "-Wall", "-Wextra", "-Werror")


def started(build: Build, name: str, us: float, baud: int = 115_200) -> tuple[Due, Image]:
    image = read_image(build(name, *OPTIONS))
    due = new_due(image)
    due.stop_at_hardfault(True)
    due.usb_line_coding(baud)
    due.power_on()
    due.run_us(us)
    assert due.mck_Hz == 84_000_000
    return due, image


def word(due: Due, image: Image, name: str) -> int:
    return int(struct.unpack("<I", due.peek(image.address(name), 4))[0])


def high_us(due: Due, pin: str, duration_us: float, step_us: float) -> float:
    """How long the pin is high in that time, looked at every step."""
    high = 0
    for _ in range(round(duration_us / step_us)):
        due.run_us(step_us)
        high += due.pin(pin)
    return high * step_us


def test_the_headers_addresses_are_the_vendors(described: dict[int, Register]) -> None:
    rows = re.findall(r"#define (\w+) REG\(0x(4\w+)\)", HEADER.read_text())
    assert len(rows) > 50
    for name, address in rows:
        row = described[int(address, 16)]
        peripheral, register = name.split("_", 1)
        assert peripheral == row.peripheral
        assert re.sub(r"^(PMC|PIO|EEFC|PWM|UOTGHS)_", "", row.name) == register, name


def test_a_clock_of_milliseconds_blinks_a_led(build: Build) -> None:
    due, image = started(build, "millis.c", 10_000)
    before = word(due, image, "millis")
    assert high_us(due, "PC8", duration_us=200_000, step_us=500) == pytest.approx(100_000, abs=1000)
    assert word(due, image, "millis") - before == 200


def test_bytes_come_back_as_capitals(build: Build) -> None:
    due, _ = started(build, "echo.c", 10_000)
    text = b"the quick brown fox, 3.14; THE LAZY DOG! " * 4
    due.usb_write(text)
    due.run_us(60_000)
    assert due.usb_read() == text.upper()
    assert due.uart_overruns == 0


def test_a_ramp_of_the_pwm_comes_out_at_its_pin(build: Build) -> None:
    due, _ = started(build, "pwm.c", 10_000)
    duties = []
    for _ in range(210):
        due.run_us(1000)
        duties.append(due.pin_duty("PC23"))
    steps = [round(after - before, 6) for before, after in pairwise(duties)]
    assert steps.count(0.01) >= 200
    assert min(duties) == 0.0
    assert max(duties) == 1.0
    while abs(due.pin_duty("PC23") - 0.3) > 0.004:
        due.run_us(1000)
    assert high_us(due, "PC23", duration_us=1000, step_us=2) == pytest.approx(300, abs=25)


def test_each_edge_of_a_pin_interrupts_whom_it_should(build: Build) -> None:
    due, image = started(build, "pin_interrupt.c", 10_000)
    for pin in ("PC4", "PC5"):
        due.set_pin(pin, "low")
    due.run_us(100)
    rising, falling = word(due, image, "rising"), word(due, image, "falling")
    for _ in range(30):
        for state in ("high", "low"):
            due.set_pin("PC4", state)
            due.run_us(50)
    for _ in range(20):
        for state in ("high", "low"):
            due.set_pin("PC5", state)
            due.run_us(50)
    due.set_pin("PC5", "high")
    due.run_us(50)
    assert (word(due, image, "rising") - rising, word(due, image, "falling") - falling) == (30, 20)


def test_voltages_are_read_by_polling_and_by_interrupt_and_put_out_again(build: Build) -> None:
    due, image = started(build, "adc.c", 10_000)
    for first, second in ((0.5, 3.0), (2.5, 1.1)):
        due.set_analog(7, first)
        due.set_analog(6, second)
        before = word(due, image, "interrupts")
        due.run_us(5_000)
        assert word(due, image, "polled") == int(first / 3.3 * 4096)
        assert word(due, image, "interrupted") == int(second / 3.3 * 4096)
        assert word(due, image, "interrupts") > before + 100
        code = word(due, image, "polled")
        assert due.analog_out(0) == pytest.approx(3.3 * (1 + 4 * code / 4095) / 6)


def test_a_program_that_opens_the_usb_port_gets_to_its_loop(build: Build) -> None:
    due, image = started(build, "usb_start.c", 20_000)
    assert due.usb_read() == b"ready\r\n"
    before = word(due, image, "millis")
    due.run_us(100_000)
    assert word(due, image, "millis") - before == 100


README = Path(__file__).resolve().parents[1] / "README.md"


def test_the_example_prints_what_its_comments_state(
    build: Build, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (example,) = re.findall(r"^```python\n(.*?)^```", README.read_text(), re.MULTILINE | re.DOTALL)
    stated = re.findall(r"^print\(.*\)  # ([^:\n]+)", example, re.MULTILINE)
    assert len(stated) == 3
    shutil.copy(build("button.c", "-Os", "-Wall", "-Wextra", "-Werror"), tmp_path / "button.elf")
    monkeypatch.chdir(tmp_path)
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(compile(example, str(README), "exec"), {})
    assert printed.getvalue().splitlines() == stated
