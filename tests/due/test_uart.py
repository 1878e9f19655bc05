"""UART0: bit timing from the divider, DMA both ways, and what goes wrong (sections 34 and 26)."""

from __future__ import annotations

import pytest
from due_emulator import Stop

from tests.due.chip import FULL_HZ, RAM, Chip

pytestmark = pytest.mark.emulated

RXRDY, TXRDY, ENDRX, ENDTX, OVRE, FRAME, PARE = (1 << i for i in (0, 1, 3, 4, 5, 6, 7))
TXEMPTY, TXBUFE, RXBUFF = 1 << 9, 1 << 11, 1 << 12
NO_PARITY = 4 << 9


def opened(divider: int = 21, mode: int = NO_PARITY, baud: int = 250_000) -> Chip:
    chip = Chip("UART", "PIOA")
    chip["PIOA.PDR"] = 0x300
    chip["UART.MR"] = mode
    chip["UART.BRGR"] = divider
    chip["UART.CR"] = 1 << 4 | 1 << 6
    chip.due.usb_line_coding(baud)
    return chip


def cycles_until(chip: Chip, mask: int, register: str = "UART.SR") -> int:
    start = chip.due.cycles
    while not chip[register] & mask:
        chip.run_cycles(1)
    return chip.due.cycles - start


@pytest.mark.parametrize("divider", [1, 21, 45, 547])
@pytest.mark.parametrize(("mode", "bits"), [(NO_PARITY, 10), (0, 11)])
def test_a_frame_lasts_its_bits_times_16_times_the_divider(divider: int, mode: int, bits: int) -> None:
    chip = opened(divider, mode)
    chip["UART.THR"] = 0x55
    # Looking costs a few cycles of bus time.
    assert cycles_until(chip, TXEMPTY) == pytest.approx(bits * 16 * divider, abs=8)


def test_250_kbaud_is_exact_and_115200_is_0_8_percent_off() -> None:
    assert FULL_HZ / (16 * 21) == 250_000
    assert pytest.approx(0.0127, abs=1e-4) == FULL_HZ / (16 * 45) / 115_200 - 1
    assert 2_000_000 / round(2_000_000 / 115_200) / 115_200 - 1 == pytest.approx(0.0212, abs=1e-4)


@pytest.mark.parametrize(("divider", "baud"), [(21, 250_000), (45, 115_200)])
def test_bytes_pass_both_ways(divider: int, baud: int) -> None:
    chip = opened(divider, baud=baud)
    chip.due.usb_write(b"\xc3")
    chip["UART.THR"] = 0x3C
    chip.due.run_us(6000)
    assert chip["UART.RHR"] == 0xC3
    assert chip.due.usb_read() == b"\x3c"


@pytest.mark.parametrize("divider", [10, 11])
def test_500_kbaud_passes_with_neither_divider(divider: int) -> None:
    chip = opened(divider, baud=500_000)
    chip.due.usb_write(b"\xc3")
    chip.due.run_us(100)
    assert chip["UART.SR"] & FRAME
    assert chip["UART.RHR"] != 0xC3


@pytest.mark.parametrize("mode", [0, 1 << 9, 2 << 9, 3 << 9])
def test_a_parity_bit_that_the_bridge_does_not_send_is_an_error(mode: int) -> None:
    chip = opened(mode=mode)
    chip.due.usb_write(b"\xc3")
    chip["UART.THR"] = 0x3C
    chip.due.run_us(6000)
    assert chip["UART.SR"] & (FRAME | PARE) == FRAME | PARE
    assert chip["UART.RHR"] != 0xC3
    assert chip.due.usb_read() != b"\x3c"


def test_one_byte_waits_and_the_next_is_an_overrun() -> None:
    chip = opened()
    chip.due.usb_write(b"abc")
    chip.due.run_us(130)
    assert chip["UART.SR"] & (RXRDY | OVRE) == RXRDY | OVRE
    assert chip.due.uart_overruns == 2


def test_dma_fills_two_buffers_in_a_row_and_says_when() -> None:
    chip = opened()
    chip["UART.RPR"], chip["UART.RCR"] = RAM, 3
    chip["UART.RNPR"], chip["UART.RNCR"] = RAM + 0x100, 2
    chip["UART.PTCR"] = 1
    assert chip["UART.SR"] & (ENDRX | RXBUFF) == 0
    chip.due.usb_write(b"abcde")
    chip.due.run_us(3 * 40 + 1)
    assert chip["UART.SR"] & (ENDRX | RXBUFF) == ENDRX
    assert (chip["UART.RPR"], chip["UART.RCR"], chip["UART.RNCR"]) == (RAM + 0x100, 2, 0)
    chip.due.run_us(2 * 40)
    assert chip["UART.SR"] & (ENDRX | RXBUFF) == ENDRX | RXBUFF
    assert chip.due.peek(RAM, 3) + chip.due.peek(RAM + 0x100, 2) == b"abcde"


def test_a_buffer_that_is_written_as_the_running_one_ends_is_noticed() -> None:
    chip = opened()
    chip["UART.RPR"], chip["UART.RCR"] = RAM, 3
    chip["UART.PTCR"] = 1
    chip.due.usb_write(b"ab")
    chip.due.run_us(2 * 40 + 1)
    assert chip["UART.RCR"] == 1
    with pytest.raises(Stop, match="moves the last byte"):
        chip["UART.RNCR"] = 2
    with pytest.raises(Stop, match="moves the running buffer"):
        chip["UART.RCR"] = 2


def test_dma_sends_back_to_back() -> None:
    chip = opened()
    chip.due.poke(RAM, bytes(range(64)))
    chip["UART.TPR"], chip["UART.TCR"] = RAM, 40
    chip["UART.TNPR"], chip["UART.TNCR"] = RAM + 40, 24
    chip["UART.PTCR"] = 1 << 8
    assert cycles_until(chip, TXEMPTY) == pytest.approx(64 * 3360, abs=8)
    assert chip["UART.SR"] & (ENDTX | TXBUFE) == ENDTX | TXBUFE
    chip.due.run_us(5000)
    assert chip.due.usb_read() == bytes(range(64))


def test_interrupt_line_follows_status_and_mask() -> None:
    chip = opened()
    # Pending interrupts of the processor; that of UART0 is number 8.
    pending = 0xE000E200
    assert chip.due.read_word(pending) >> 8 & 1 == 0
    chip["UART.IER"] = RXRDY
    chip.due.usb_write(b"x")
    chip.due.run_us(50)
    assert chip.due.read_word(pending) >> 8 & 1 == 1


@pytest.mark.parametrize(
    ("register", "value", "message"),
    [
        ("UART.MR", 1 << 14 | NO_PARITY, "channel mode"),
        ("UART.RHR", 1, "read-only"),
    ],
)
def test_what_is_not_modelled_or_wrong_is_refused(register: str, value: int, message: str) -> None:
    with pytest.raises(Stop, match=message):
        opened()[register] = value


def test_sending_without_the_pin_is_noticed() -> None:
    chip = opened()
    chip["PIOA.PER"] = 0x300
    chip["UART.THR"] = 1
    with pytest.raises(Stop, match="PA9 is not given to the UART"):
        chip.due.run_us(100)


def test_dma_into_nothing_is_noticed() -> None:
    chip = opened()
    chip["UART.RPR"], chip["UART.RCR"] = 0x1000_0000, 1
    chip["UART.PTCR"] = 1
    chip.due.usb_write(b"x")
    with pytest.raises(Stop, match=r"UART_RPR .* no SRAM"):
        chip.due.run_us(100)


def test_local_loopback_returns_what_is_sent() -> None:
    chip = opened(mode=2 << 14 | NO_PARITY)
    chip["UART.THR"] = 0x5A
    chip.due.run_us(50)
    assert chip["UART.RHR"] == 0x5A
