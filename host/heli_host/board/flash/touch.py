"""Erasing and resetting a Due by the control lines of its USB bridge."""

from __future__ import annotations

import errno
import time

import serial

from heli_host.declaration import BAUD
from heli_host.errors import FlashError

ERASING_BAUD = 1200
# When a control line changes at this rate, the ATmega16U2 holds ERASE and then RESET for 180 rounds
# of 4.096 ms, 0.74 s (its published source). The loader in the chip needs a moment more.
ERASE_S = 1.2

# How long a lowered DTR is held, and how long a write to the chip's boot bit may take before the reset.
PULSE_S = 0.05
SETTLE_S = 0.1

_NO_CONTROL_LINES = (errno.ENOTTY, errno.EINVAL)


def erase_chip(port: str, wait_s: float = ERASE_S) -> None:
    """Erase all flash of the Due behind its programming port; the chip's own loader (SAM-BA) then answers."""
    try:
        with serial.Serial(port, ERASING_BAUD) as touched:
            _set_dtr(touched, False)
            time.sleep(wait_s)
            # The next program to open the port raises DTR before it sets its rate, so that a rate of 1200
            # baud, left from here, would erase the flash again.
            touched.baudrate = BAUD
    except (serial.SerialException, OSError, ValueError) as error:
        raise FlashError(
            f"{port} cannot be opened at {ERASING_BAUD} baud to erase the board: {error}",
            "close other programs that use it (heli-host doctor names ModemManager), then try again",
        ) from error


def restart_chip(port: str) -> None:
    """Reset the Due behind its programming `port`, by the rising edge of DTR that its USB bridge waits for; a
    FlashError when it cannot be opened.
    """
    time.sleep(SETTLE_S)
    try:
        with serial.Serial(port, BAUD) as touched:
            _set_dtr(touched, False)
            time.sleep(PULSE_S)
            _set_dtr(touched, True)
    except (serial.SerialException, OSError, ValueError) as error:
        raise FlashError(
            f"the flash was written, but {port} cannot be opened to restart the board: {error}",
            "press RESET on the board",
        ) from error


def _set_dtr(port: serial.Serial, high: bool) -> None:
    """Set the line DTR, if the port has one."""
    try:
        port.dtr = high
    except OSError as error:
        # A pseudo-terminal has no such line; the simulated board reads the rate instead.
        if error.errno not in _NO_CONTROL_LINES:
            raise
