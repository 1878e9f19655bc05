"""UART0, the bridge to USB, and the clock of the USB port (sections 26, 34 and 28)."""

from itertools import pairwise

import pytest
from due_chip import FULL_HZ, RAM, Chip
from due_emulator import Stop

pytestmark = pytest.mark.emulated

RXRDY, TXRDY, ENDRX, ENDTX, OVRE, FRAME, PARE = (1 << i for i in (0, 1, 3, 4, 5, 6, 7))
TXEMPTY, TXBUFE, RXBUFF = 1 << 9, 1 << 11, 1 << 12
NO_PARITY = 4 << 9
RXEN, TXEN = 1 << 4, 1 << 6
RXTEN = 1 << 0
"""In UART_PTCR: the DMA receives."""
TXTEN = 1 << 8
"""In UART_PTCR: the DMA sends."""
BYTE_CYCLES = 10 * 16 * 21
"""Start bit, eight of data and stop bit at 250 kbaud."""


def opened(divider: int = 21, mode: int = NO_PARITY, baud: int = 250_000) -> Chip:
    chip = Chip("UART", "PIOA")
    chip["PIOA.PDR"] = 0x300
    chip["UART.MR"] = mode
    chip["UART.BRGR"] = divider
    chip["UART.CR"] = RXEN | TXEN
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
    chip["UART.PTCR"] = RXTEN
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
    chip["UART.PTCR"] = RXTEN
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
    chip["UART.PTCR"] = TXTEN
    assert cycles_until(chip, TXEMPTY) == pytest.approx(64 * BYTE_CYCLES, abs=8)
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
    [("UART.MR", 1 << 14 | NO_PARITY, "channel mode"), ("UART.RHR", 1, "read-only")],
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
    chip["UART.PTCR"] = RXTEN
    chip.due.usb_write(b"x")
    with pytest.raises(Stop, match=r"UART_RPR .* no SRAM"):
        chip.due.run_us(100)


def test_local_loopback_returns_what_is_sent() -> None:
    chip = opened(mode=2 << 14 | NO_PARITY)
    chip["UART.THR"] = 0x5A
    chip.due.run_us(50)
    assert chip["UART.RHR"] == 0x5A


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
    chip["UART.PTCR"] = TXTEN
    chip.due.run_us(97 * 40 + 5)
    assert len(chip.due.usb_read()) == 97


def test_a_host_that_does_not_read_loses_bytes_silently() -> None:
    chip = opened()
    chip.due.usb_reading(False)
    chip["UART.TPR"], chip["UART.TCR"] = 0x2007_0000, 300
    chip["UART.PTCR"] = TXTEN
    chip.due.run_us(300 * 40 + 100)
    chip.due.usb_reading(True)
    chip.due.run_us(5000)
    assert len(chip.due.usb_read()) == 128
    assert chip.due.usb_lost == 300 - 128


def test_bytes_for_the_board_wait_in_the_hosts_driver() -> None:
    chip = opened()
    chip["UART.RPR"], chip["UART.RCR"] = 0x2007_0000, 2000
    chip["UART.PTCR"] = RXTEN
    data = bytes(i & 0xFF for i in range(1000))
    chip.due.usb_write(data)
    chip.due.run_us(1000 * 40 + 100)
    assert chip["UART.RCR"] == 1000
    assert chip.due.peek(0x2007_0000, 1000) == data


UPLLEN, LOCKU, UOTGCLK = 1 << 16, 1 << 6, 1 << 5
UPLLCOUNT = 3 << 20
"""Three steps of eight slow periods, in which the PLL locks."""
USBS_UPLL = 1 << 0
"""In PMC_USB: the clock comes from UPLL."""
UOTGHS_CLOCK = 1 << (40 - 32)
"""In PMC_PCER1."""
USBE, CLKUSABLE = 1 << 15, 1 << 14


@pytest.mark.parametrize("count", [1, 3, 15])
def test_UPLL_locks_after_eight_slow_periods_for_each_count(count: int) -> None:
    chip = Chip()
    chip["PMC.UCKR"] = count << 20 | UPLLEN
    assert chip["PMC.UCKR"] == count << 20 | UPLLEN
    lock_us = 8 * count / 32_000 * 1e6
    chip.due.run_us(lock_us - 5)
    assert chip["PMC.SR"] & LOCKU == 0
    chip.due.run_us(50)
    assert chip["PMC.SR"] & LOCKU
    chip["PMC.UCKR"] = count << 20
    assert chip["PMC.SR"] & LOCKU == 0


def test_the_usb_clock_is_shown_once_it_runs() -> None:
    chip = Chip()
    chip["PMC.UCKR"] = UPLLCOUNT | UPLLEN
    chip.wait("PMC.SR", LOCKU)
    chip["PMC.USB"] = USBS_UPLL
    assert chip["PMC.SCSR"] == 1
    chip["PMC.SCER"] = UOTGCLK
    assert chip["PMC.SCSR"] == UOTGCLK | 1
    with pytest.raises(Stop, match="UPLL is switched off while the USB clock runs from it"):
        chip["PMC.UCKR"] = 0
    chip["PMC.SCDR"] = UOTGCLK
    assert chip["PMC.SCSR"] == 1
    chip["PMC.UCKR"] = 0


def test_UPLL_needs_the_crystal() -> None:
    with pytest.raises(Stop, match="before the 12 MHz crystal runs"):
        Chip(full_speed=False)["PMC.UCKR"] = UPLLCOUNT | UPLLEN


def test_the_usb_clock_waits_for_the_lock_of_its_source() -> None:
    chip = Chip()
    chip["PMC.USB"] = USBS_UPLL
    chip["PMC.UCKR"] = UPLLCOUNT | UPLLEN
    with pytest.raises(Stop, match=r"before PMC_SR\.LOCKU says that UPLL"):
        chip["PMC.SCER"] = UOTGCLK


def test_a_lock_of_UPLL_that_is_said_too_early_is_noticed() -> None:
    chip = Chip()
    chip["PMC.USB"] = USBS_UPLL
    chip["PMC.UCKR"] = UPLLEN
    chip.wait("PMC.SR", LOCKU)
    with pytest.raises(Stop, match=r"UPLLCOUNT is too short: UPLL needs 0\.1 ms"):
        chip["PMC.SCER"] = UOTGCLK


def test_the_ports_clock_is_usable_with_UPLL_and_the_port_on() -> None:
    chip = Chip()
    chip["PMC.PCER1"] = UOTGHS_CLOCK
    for upll in (False, True):
        if upll:
            chip["PMC.UCKR"] = UPLLCOUNT | UPLLEN
            chip.wait("PMC.SR", LOCKU)
        for enabled in (0, USBE):
            chip["UOTGHS.CTRL"] = enabled
            assert bool(chip["UOTGHS.SR"] & CLKUSABLE) is (upll and enabled == USBE)


def test_masks_and_switches_of_the_port_are_kept() -> None:
    chip = Chip()
    chip["PMC.PCER1"] = UOTGHS_CLOCK
    chip["UOTGHS.DEVIER"] = 0x1C
    chip["UOTGHS.DEVIDR"] = 0x04
    assert chip["UOTGHS.DEVIMR"] == 0x18
    chip["UOTGHS.DEVCTRL"] = 0
    assert chip["UOTGHS.DEVCTRL"] == 0
    with pytest.raises(Stop, match=r"UOTGHS_DEVEPTCFG0 .*not modelled"):
        chip["UOTGHS.DEVEPTCFG0"] = 1
