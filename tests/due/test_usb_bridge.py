"""The ATmega16U2 as its published firmware works."""

from __future__ import annotations

from itertools import pairwise

import pytest

from tests.due.chip import Chip
from tests.due.test_uart import opened

pytestmark = pytest.mark.emulated


def test_a_rising_DTR_resets_the_board_for_205_ms() -> None:
    chip = Chip()
    chip.due.usb_control_lines(True)
    chip.due.run_us(5_000)
    assert chip.due.held_in_reset
    chip.due.run_us(195_000)
    assert chip.due.held_in_reset
    chip.due.run_us(10_000)
    assert not chip.due.held_in_reset
    assert chip.due.last_reset == "user"
    chip.due.usb_control_lines(True)
    chip.due.run_us(10_000)
    assert chip.due.resets == 2


def test_1200_baud_erases_the_flash() -> None:
    chip = Chip()
    chip.due.usb_line_coding(1200)
    chip.due.usb_control_lines(False)
    chip.due.run_us(900_000)
    assert set(chip.due.flash()) == {0xFF}
    assert chip.due.in_rom


def test_bytes_leave_every_4_096_ms() -> None:
    chip = opened()
    chip["UART.THR"] = 1
    chip.due.run_us(50)
    arrivals: list[float] = []
    for _ in range(300):
        if not arrivals or chip.due.now_us - arrivals[-1] > 100:
            chip["UART.THR"] = 2
        chip.due.run_us(100)
        if chip.due.usb_read():
            arrivals.append(chip.due.now_us)
    gaps = [b - a for a, b in pairwise(arrivals)]
    assert all(4000 <= gap <= 4200 for gap in gaps)
    assert len(gaps) >= 5


def test_96_bytes_do_not_wait() -> None:
    chip = opened()
    chip.due.poke(0x2007_0000, bytes(120))
    chip["UART.TPR"], chip["UART.TCR"] = 0x2007_0000, 97
    while chip.due.usb_read() or chip.due.now_us % 4096 > 50:
        chip.due.run_us(10)
    chip["UART.PTCR"] = 1 << 8
    chip.due.run_us(97 * 40 + 5)
    assert len(chip.due.usb_read()) == 97


def test_a_host_that_does_not_read_loses_bytes_silently() -> None:
    chip = opened()
    chip.due.usb_reading(False)
    chip["UART.TPR"], chip["UART.TCR"] = 0x2007_0000, 300
    chip["UART.PTCR"] = 1 << 8
    chip.due.run_us(300 * 40 + 100)
    chip.due.usb_reading(True)
    chip.due.run_us(5000)
    assert len(chip.due.usb_read()) == 128
    assert chip.due.usb_lost == 300 - 128


def test_bytes_for_the_board_wait_in_the_hosts_driver() -> None:
    chip = opened()
    chip["UART.RPR"], chip["UART.RCR"] = 0x2007_0000, 2000
    chip["UART.PTCR"] = 1
    data = bytes(i & 0xFF for i in range(1000))
    chip.due.usb_write(data)
    chip.due.run_us(1000 * 40 + 100)
    assert chip["UART.RCR"] == 1000
    assert chip.due.peek(0x2007_0000, 1000) == data
