"""A pseudo-terminal as a serial port, with a symbolic link as its permanent name."""

from __future__ import annotations

import contextlib
import os
import termios
import tty
from pathlib import Path
from typing import Final

from typing_extensions import override

from heli_sim.errors import EndpointError
from heli_sim.sil.endpoint import Endpoint, LineChange
from heli_sim.sil.port_link import PortLink

_CHUNK: Final = 65536
# Indices into the list that tcgetattr returns.
_CFLAG: Final = 2
_OSPEED: Final = 5


class PtyEndpoint(Endpoint):
    """The board's side of a pseudo-terminal.

    A host opens the link like a device file. When the host closes the port, its unread bytes are discarded,
    and the terminal remains for the next host. A pseudo-terminal has no line DTR, so opening counts as its
    rise and closing as its fall. If the host has cleared the hang-up flag (``stty -hupcl``), DTR stays high,
    as with a serial port of Linux.
    """

    def __init__(self, link: str | Path | None = None) -> None:
        self._link = PortLink(Path(link)) if link is not None else None
        self._board_side = -1
        self._is_open = False
        self._dtr = False
        self._changes: list[LineChange] = []
        self._unsent = b""
        self.url = ""
        try:
            self.plug()
        except EndpointError:
            self.close()
            raise

    @override
    @property
    def ready(self) -> bool:
        """Whether a host has the port open and reads from it."""
        return self._is_open and not self._unsent

    @override
    def receive(self) -> bytes:
        if self._board_side < 0:
            return b""
        try:
            received = os.read(self._board_side, _CHUNK)
        except BlockingIOError:
            received = b""
        except OSError:
            # Linux answers EIO as long as no process has the other side open.
            if self._is_open:
                self._discard_after_close()
            return b""
        if not self._is_open:
            self._is_open = True
            self._set_dtr(True)
        return received

    @override
    def send(self, data: bytes) -> None:
        if not self._is_open:
            return
        self._unsent += data
        if not self._unsent:
            return
        try:
            self._unsent = self._unsent[os.write(self._board_side, self._unsent) :]
        except BlockingIOError:
            pass
        except OSError:
            self._discard_after_close()

    @override
    def take_lines(self) -> list[LineChange]:
        changes, self._changes = self._changes, []
        return changes

    @override
    def fileno(self) -> int:
        # If no host has the port open, the terminal would report a hang-up all the time.
        return self._board_side if self._is_open else -1

    @override
    def unplug(self) -> None:
        if self._board_side < 0:
            return
        if self._link is not None:
            self._link.remove()
        os.close(self._board_side)
        self._board_side = -1
        self._is_open, self._dtr, self._unsent = False, False, b""

    @override
    def plug(self) -> None:
        if self._board_side >= 0:
            return
        try:
            self._board_side, host_side = os.openpty()
        except OSError as error:
            raise EndpointError(
                f"cannot create a pseudo-terminal: {error.strerror}",
                "close programs that use pseudo-terminals",
            ) from None
        self.terminal = os.ttyname(host_side)
        """Name of the terminal itself, such as ``/dev/pts/3``."""
        # In its default mode the terminal would echo a host's bytes and change some of the board's, until the
        # host sets the port up. The settings last as long as this side is open.
        tty.setraw(host_side)
        # Serial ports start with this flag set, pseudo-terminals do not.
        settings = termios.tcgetattr(host_side)
        settings[_CFLAG] |= termios.HUPCL
        termios.tcsetattr(host_side, termios.TCSANOW, settings)
        os.close(host_side)
        os.set_blocking(self._board_side, False)
        self.url = self.terminal
        if self._link is not None:
            self._link.point_to(self.terminal)
            self.url = str(self._link.path)

    @override
    def close(self) -> None:
        self.unplug()
        if self._link is not None:
            self._link.release()

    def _discard_after_close(self) -> None:
        """Discard unsent bytes after the host closed the port, and lower DTR unless the host forbade it."""
        self._is_open, self._unsent = False, b""
        if termios.tcgetattr(self._board_side)[_CFLAG] & termios.HUPCL:
            self._set_dtr(False)
        # Linux would keep up to 4095 unread bytes for the next host; only the host's side can discard them.
        with contextlib.suppress(OSError, termios.error):
            host_side = os.open(self.terminal, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            try:
                termios.tcflush(host_side, termios.TCIOFLUSH)
            finally:
                os.close(host_side)

    def _set_dtr(self, on: bool) -> None:
        """Record a change of DTR together with the baud rate at that moment."""
        if on == self._dtr:
            return
        self._dtr = on
        # Only the rate that erases the flash matters; termios has no constant for the rate of the link.
        is_erasing_rate = termios.tcgetattr(self._board_side)[_OSPEED] == termios.B1200
        self._changes.append(LineChange(on, 1200 if is_erasing_rate else 0))
