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
# Places in what tcgetattr returns.
_CFLAG: Final = 2
_OSPEED: Final = 5


class PtyEndpoint(Endpoint):
    """The board's side of a pseudo-terminal.

    A host opens the link like a device file. When it closes the port, what it has not read is thrown away,
    and the terminal stays for the next one. A pseudo-terminal has no DTR: opening counts as its rise, and
    closing as its fall. If the host has cleared the hang-up flag (``stty -hupcl``), the line stays up and the
    next opening is no edge, as with a serial port of Linux.

    Parameters
    ----------
    link : str or Path or None
        Symbolic link to make; None to show the terminal under its own name only.

    Raises
    ------
    EndpointError
        When another server holds the link's path, or the link cannot be made there: see `PortLink`.
    """

    def __init__(self, link: str | Path | None = None) -> None:
        self._link = PortLink(Path(link)) if link is not None else None
        self._master = -1
        self._open = False
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
        return self._open and not self._unsent

    @override
    def receive(self) -> bytes:
        if self._master < 0:
            return b""
        try:
            data = os.read(self._master, _CHUNK)
        except BlockingIOError:
            data = b""
        except OSError:
            # Linux answers EIO as long as no process has the other side open.
            if self._open:
                self._hang_up()
            return b""
        if not self._open:
            self._open = True
            self._set_dtr(True)
        return data

    @override
    def send(self, data: bytes) -> None:
        if not self._open:
            return
        self._unsent += data
        if not self._unsent:
            return
        try:
            self._unsent = self._unsent[os.write(self._master, self._unsent) :]
        except BlockingIOError:
            pass
        except OSError:
            self._hang_up()

    @override
    def take_lines(self) -> list[LineChange]:
        changes, self._changes = self._changes, []
        return changes

    @override
    def fileno(self) -> int:
        # While no host has the port open the terminal would report its hang-up for ever.
        return self._master if self._open else -1

    @override
    def unplug(self) -> None:
        if self._master < 0:
            return
        if self._link is not None:
            self._link.remove()
        os.close(self._master)
        self._master = -1
        self._open, self._dtr, self._unsent = False, False, b""

    @override
    def plug(self) -> None:
        if self._master >= 0:
            return
        try:
            self._master, slave = os.openpty()
        except OSError as error:
            raise EndpointError(
                f"cannot create a pseudo-terminal: {error.strerror}",
                "close programs that use pseudo-terminals",
            ) from None
        self.terminal = os.ttyname(slave)
        """Name of the terminal itself, such as ``/dev/pts/3``."""
        # Without this a host sees its own bytes, and the board's zeros and returns changed, until it sets the
        # port up. The settings last as long as this side is open.
        tty.setraw(slave)
        # Serial ports start with this flag set, pseudo-terminals without.
        settings = termios.tcgetattr(slave)
        settings[_CFLAG] |= termios.HUPCL
        termios.tcsetattr(slave, termios.TCSANOW, settings)
        os.close(slave)
        os.set_blocking(self._master, False)
        self.url = self.terminal
        if self._link is not None:
            self._link.point_to(self.terminal)
            self.url = str(self._link.path)

    @override
    def close(self) -> None:
        self.unplug()
        if self._link is not None:
            self._link.release()

    def _hang_up(self) -> None:
        """Process that the host has closed the port: drop what is not sent, and switch DTR off if the host
        asked for it.
        """
        self._open, self._unsent = False, b""
        if termios.tcgetattr(self._master)[_CFLAG] & termios.HUPCL:
            self._set_dtr(False)
        # Linux keeps up to 4095 unread bytes for the next host; only the other side can drop them.
        with contextlib.suppress(OSError, termios.error):
            slave = os.open(self.terminal, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            try:
                termios.tcflush(slave, termios.TCIOFLUSH)
            finally:
                os.close(slave)

    def _set_dtr(self, on: bool) -> None:
        if on == self._dtr:
            return
        self._dtr = on
        # Of the rates only the one that erases matters; the one of the link is in no table of constants.
        erases = termios.tcgetattr(self._master)[_OSPEED] == termios.B1200
        self._changes.append(LineChange(on, 1200 if erases else 0))
