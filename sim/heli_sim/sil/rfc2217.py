"""A TCP port that also carries control lines and baud rate, for pyserial's ``rfc2217://HOST:PORT``.

pyserial's `serial.rfc2217.PortManager` implements the protocol; this module gives it a serial port and a
connection. DTR is low until the host raises it, and falls when the host disconnects.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from typing import Any, Final, cast

import serial
from serial import rfc2217
from typing_extensions import override

from heli_sim.sil.endpoint import LineChange
from heli_sim.sil.tcp import TcpEndpoint

_LONGEST_REQUEST_BYTES: Final = 64
"""Longest request that is kept [byte]; the longest that this module understands has 6."""
_MAX_UNSENT_BYTES: Final = 65536
"""Answers that may wait for a host that does not read [byte]: some thousands of requests."""
_VALUE_BYTES: Final = {
    rfc2217.SET_BAUDRATE: 4,
    rfc2217.SET_DATASIZE: 1,
    rfc2217.SET_PARITY: 1,
    rfc2217.SET_STOPSIZE: 1,
    rfc2217.SET_LINESTATE_MASK: 1,
    rfc2217.SET_MODEMSTATE_MASK: 1,
}
"""Length of the value of each request that needs one [byte]."""
# The value 0 asks for the present setting.
_VALUES: Final = {
    rfc2217.SET_PARITY: (b"\0", *(bytes((value,)) for value in rfc2217.RFC2217_REVERSE_PARITY_MAP)),
    rfc2217.SET_STOPSIZE: (b"\0", *(bytes((value,)) for value in rfc2217.RFC2217_REVERSE_STOPBIT_MAP)),
}
"""Values that a request may have; a request that is not listed may have any."""


class Lines:
    """The serial port that pyserial's server controls: its settings and control lines."""

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


class Protocol(rfc2217.PortManager):
    """pyserial's server of the protocol, for hosts that may send any bytes.

    pyserial raises errors for an end of a request without its beginning, and for requests whose value is
    missing or unknown; and it keeps a request without an end, however long it gets. Such requests are
    ignored here, as the standard demands of unknown ones.
    """

    @override
    def filter(self, data: bytes) -> Generator[bytes, None, None]:
        """Yield the bytes for the board, and carry out the requests between them."""
        for number in data:
            byte = bytes((number,))
            begins = self.suboption is None
            if begins and self.mode == rfc2217.M_IAC_SEEN and byte == rfc2217.SE:
                self.mode = rfc2217.M_NORMAL
                continue
            yield from super().filter(byte)
            if self.suboption is not None and len(self.suboption) > _LONGEST_REQUEST_BYTES:
                self.suboption = self.suboption[:_LONGEST_REQUEST_BYTES]

    # The type stubs do not have this method, which is the place where pyserial carries out a request.
    def _telnet_process_subnegotiation(self, suboption: bytes) -> None:
        option, value = suboption[1:2], suboption[2:]
        if len(value) < _VALUE_BYTES.get(option, 0):
            return
        if value[:1] not in _VALUES.get(option, (value[:1],)):
            return
        super()._telnet_process_subnegotiation(suboption)  # type: ignore[misc]


class Rfc2217Endpoint(TcpEndpoint):
    """The board's side of an RFC 2217 connection. One host is connected at a time; the next one waits."""

    scheme = "rfc2217"

    def __init__(
        self, host: str = "127.0.0.1", port: int = 0, now_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._is_overflowing = False
        self._lines: Lines | None = None
        self._manager: Protocol | None = None
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
        received = b"".join(self._manager.filter(data))
        if self._is_overflowing:
            self._disconnect_host()
            return b""
        return received

    @override
    def send(self, data: bytes) -> None:
        escaped = b"".join(self._manager.escape(data)) if self._manager is not None else b""
        super().send(escaped)

    def write(self, data: bytes) -> None:
        """Send `data` of the protocol itself without escaping; the board's bytes are escaped elsewhere.

        A host that sends requests and reads no answers is disconnected, so that the answers need no memory.
        """
        self._is_overflowing = self._is_overflowing or len(self._unsent) > _MAX_UNSENT_BYTES
        if not self._is_overflowing:
            super().send(data)

    @override
    def _note_dtr_rise(self) -> None:
        self._is_overflowing = False
        self._lines = Lines(self._changes)
        # The type stubs require a complete serial port; the code uses only the attributes of Lines.
        self._manager = Protocol(cast(Any, self._lines), cast(Any, self))

    @override
    def _note_dtr_fall(self) -> None:
        if self._lines is not None:
            self._lines.dtr = False
        self._lines = self._manager = None
