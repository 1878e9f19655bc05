"""A TCP port that also carries control lines and baud rate, for pyserial's ``rfc2217://HOST:PORT``.

pyserial's `serial.rfc2217.PortManager` implements the protocol; this module gives it a serial port and a
connection. DTR is low until the host raises it, and falls when the host disconnects.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, cast

import serial
from serial import rfc2217
from typing_extensions import override

from heli_sim.sil.endpoint import LineChange
from heli_sim.sil.tcp import TcpEndpoint


class Lines:
    """The serial port that pyserial's server controls: its settings and control lines.

    Parameters
    ----------
    changes : list of LineChange
        Each change of DTR is appended to it.
    """

    def __init__(self, changes: list[LineChange]) -> None:
        self._changes = changes
        self._dtr = False
        # The protocol reads the following attributes. The rate is the default of the 16U2, the USB chip.
        self.baudrate = 9600
        self.bytesize = serial.EIGHTBITS
        self.parity = serial.PARITY_NONE
        self.stopbits = serial.STOPBITS_ONE
        self.xonxoff = self.rtscts = self.rts = self.break_condition = False
        self.cts = self.dsr = self.cd = True
        self.ri = False

    @property
    def dtr(self) -> bool:
        """The line DTR; only a new value counts as a change."""
        return self._dtr

    @dtr.setter
    def dtr(self, on: bool) -> None:
        if on != self._dtr:
            self._dtr = on
            self._changes.append(LineChange(on, self.baudrate))

    def reset_input_buffer(self) -> None:
        """Do nothing: this side has no buffer."""

    def reset_output_buffer(self) -> None:
        """Do nothing: this side has no buffer."""


class Rfc2217Endpoint(TcpEndpoint):
    """The board's side of an RFC 2217 connection. One host is connected at a time; the next one waits.

    Parameters
    ----------
    host : str
        Address to listen on; ``127.0.0.1`` keeps it on this machine.
    port : int
        Port to listen on; 0 takes any free one.
    now_s : callable returning float
        Monotonic clock of the machine [s].

    Raises
    ------
    EndpointError
        When the address cannot be listened on.
    """

    scheme = "rfc2217"

    def __init__(
        self, host: str = "127.0.0.1", port: int = 0, now_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._lines: Lines | None = None
        self._manager: rfc2217.PortManager | None = None
        super().__init__(host, port, now_s)

    @override
    @property
    def ready(self) -> bool:
        """Whether a host is connected, has raised DTR, and reads."""
        return super().ready and self._lines is not None and self._lines.dtr

    @override
    def receive(self) -> bytes:
        data = super().receive()
        if self._manager is None or not data:
            return b""
        return b"".join(self._manager.filter(data))

    @override
    def send(self, data: bytes) -> None:
        escaped = b"".join(self._manager.escape(data)) if self._manager is not None else b""
        super().send(escaped)

    def write(self, data: bytes) -> None:
        """Send `data` of the protocol itself without escaping; the board's bytes are escaped elsewhere."""
        super().send(data)

    @override
    def _note_dtr_rise(self) -> None:
        self._lines = Lines(self._changes)
        # The type stubs require a complete serial port; the code uses only the attributes of Lines.
        self._manager = rfc2217.PortManager(cast(Any, self._lines), cast(Any, self))

    @override
    def _note_dtr_fall(self) -> None:
        if self._lines is not None:
            self._lines.dtr = False
        self._lines = self._manager = None
