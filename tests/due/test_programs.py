"""Programs for the Due in plain C that are not the helicopter's: each runs in strict mode as on a desk."""

from __future__ import annotations

import re
import struct
from itertools import pairwise

import pytest
from due_emulator import Due, Image, new_due, read_image

from tests.due.conftest import HERE, Build
from tests.due.test_registers import Described, described

__all__ = ["described"]
pytestmark = pytest.mark.emulated

HEADER = HERE / "programs" / "due.h"
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


def test_the_headers_addresses_are_the_vendors(described: dict[int, Described]) -> None:
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
    assert high_us(due, "PC8", 200_000, 500) == pytest.approx(100_000, abs=1000)
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
    assert high_us(due, "PC23", 1000, 2) == pytest.approx(300, abs=25)


def test_each_edge_of_a_pin_interrupts_whom_it_should(build: Build) -> None:
    due, image = started(build, "pin_interrupt.c", 10_000)
    for pin in ("PC4", "PC5"):
        due.set_pin(pin, "low")
    due.run_us(100)
    start = word(due, image, "rising"), word(due, image, "falling")
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
    assert (word(due, image, "rising") - start[0], word(due, image, "falling") - start[1]) == (30, 20)


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
