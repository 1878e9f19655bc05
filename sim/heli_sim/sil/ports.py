"""Ports of a simulated board that hosts reach over TCP: plain, and with control lines (RFC 2217).

pyserial's `serial.rfc2217.PortManager` implements that protocol; this module gives it a serial port and a
connection. DTR is low until the host raises it, and falls when the host disconnects.
"""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Any, Final, Protocol, cast

import serial
from heli_host.errors import listening_remedy
from serial import rfc2217
from typing_extensions import override

from heli_sim.errors import EndpointError


@dataclass(frozen=True)
class LineChange:
    """A change of the line DTR by the host."""

    dtr: bool  # The line now; a Due's bridge resets the board when it rises
    baud: int = 0
    """Rate of the port, bits per second; 0 if it is unknown. At 1200 a Due's bridge erases the flash."""


class Endpoint(Protocol):
    """The board's side of a port that a host may open, close and open again. No method blocks."""

    url: str
    """Address that a host opens."""

    def receive(self) -> bytes:
        """Return the bytes that the host wrote, or empty bytes. The call also notices that the host opened or
        closed the port.
        """
        ...

    def send(self, data: bytes) -> None:
        """Send `data` to the host. Bytes that do not fit are kept for the next call, or lost when the port is
        closed. Call it with empty data to send kept bytes only.
        """
        ...

    @property
    def ready(self) -> bool:
        """Whether a host has the port open and reads from it."""
        ...

    def take_lines(self) -> list[LineChange]:
        """Return the changes of DTR since the last call, oldest first."""
        ...

    def fileno(self) -> int:
        """File descriptor that becomes readable when bytes or a host arrive; -1 if there is none."""
        ...

    def unplug(self) -> None:
        """Remove the port, as pulling the cable does."""
        ...

    def plug(self) -> None:
        """Restore the port under the same address; an EndpointError if that is impossible."""
        ...

    def close(self) -> None:
        """Remove the port for good. Further calls do nothing."""
        ...


_CHUNK: Final = 65536
_SEND_BUFFER: Final = 16384
"""Size of the send buffer in bytes. For a host that does not read, the bridge must soon overflow, as with a
serial driver; the default buffer of a system may hold megabytes."""


SILENT_S: Final = 3.0
"""A host that sends nothing for this time is replaced by a waiting one; a session sends every 0.2 s."""
PATIENCE_S: Final = 1.0
"""Time after which a waiting host receives the line that names the connected host."""


class TcpEndpoint(Endpoint):
    """The board's side of a TCP connection."""

    # One host is connected at a time. The next host waits, and receives a line that names the connected host.
    # A connection does not transfer DTR. Its beginning counts as a rise of the line, and its end as a fall.

    scheme = "socket"
    """Scheme of the addresses, as pyserial knows it."""

    def __init__(
        self, host: str = "127.0.0.1", port: int = 0, now_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._address = (host, port)
        self._now_s = now_s
        self._connected_name = ""
        self._last_received_s = 0.0
        self._waiting: socket.socket | None = None
        self._waiting_since_s = 0.0
        self._is_informed = False
        self._listener: socket.socket | None = None
        self._peer: socket.socket | None = None
        self._changes: list[LineChange] = []
        self._unsent = b""
        self.url = ""
        self.plug()

    @override
    @property
    def ready(self) -> bool:
        """Whether a host is connected and reads."""
        return self._peer is not None and not self._unsent

    @override
    def receive(self) -> bytes:
        self._serve_waiting_host()
        if self._peer is None:
            return b""
        try:
            received = self._peer.recv(_CHUNK)
        except BlockingIOError:
            return b""
        except OSError:
            received = b""
        if received:
            self._last_received_s = self._now_s()
        else:
            self._disconnect_host()
        return received

    @override
    def send(self, data: bytes) -> None:
        if self._peer is None:
            return
        self._unsent += data
        if not self._unsent:
            return
        try:
            self._unsent = self._unsent[self._peer.send(self._unsent) :]
        except BlockingIOError:
            pass
        except OSError:
            self._disconnect_host()

    @override
    def take_lines(self) -> list[LineChange]:
        changes, self._changes[:] = self._changes[:], []
        return changes

    @override
    def fileno(self) -> int:
        socket_to_watch = self._peer or self._listener
        return socket_to_watch.fileno() if socket_to_watch is not None else -1

    @override
    def unplug(self) -> None:
        self._disconnect_host()
        if self._waiting is not None:
            self._waiting.close()
            self._waiting = None
        if self._listener is not None:
            self._listener.close()
            self._listener = None

    @override
    def plug(self) -> None:
        if self._listener is not None:
            return
        try:
            listener = socket.create_server(self._address, backlog=1)
        except (OSError, OverflowError) as error:
            host, port = self._address
            reason = getattr(error, "strerror", None) or str(error)
            remedy = listening_remedy(error, "HOST:PORT")
            raise EndpointError(f"cannot listen on {host}:{port}: {reason}", remedy) from None
        listener.setblocking(False)
        self._listener = listener
        self._address = (self._address[0], listener.getsockname()[1])
        self.url = f"{self.scheme}://{self._address[0]}:{self._address[1]}"

    @override
    def close(self) -> None:
        self.unplug()

    def _serve_waiting_host(self) -> None:
        """Connect the waiting host if the board is free; otherwise send it the name of the connected host."""
        if self._waiting is None:
            self._accept_waiting_host()
        if self._waiting is None:
            return
        now_s = self._now_s()
        if self._peer is not None and now_s - self._last_received_s >= SILENT_S:
            self._disconnect_host()
        if self._peer is None:
            self._peer, self._waiting = self._waiting, None
            self._connected_name = _address_text(self._peer)
            self._last_received_s = now_s
            self._note_dtr_rise()
        elif now_s - self._waiting_since_s >= PATIENCE_S and not self._is_informed:
            self._is_informed = True
            # Frames end with a zero, so this line does not become part of the board's first frame.
            with contextlib.suppress(OSError):
                self._waiting.send(f"\r\nthis board is held by {self._connected_name}\r\n\0".encode())
        else:
            self._drop_closed_waiting_host()

    def _accept_waiting_host(self) -> None:
        """Accept a waiting client."""
        if self._listener is None:
            return
        with contextlib.suppress(OSError):
            peer, _ = self._listener.accept()
            peer.setblocking(False)
            peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)
            self._waiting, self._waiting_since_s, self._is_informed = peer, self._now_s(), False

    def _drop_closed_waiting_host(self) -> None:
        """Remove a waiting host that has closed its connection, because another one may wait behind it."""
        if self._waiting is None:
            return
        try:
            has_closed = self._waiting.recv(1, socket.MSG_PEEK) == b""
        except BlockingIOError:
            return
        except OSError:
            has_closed = True
        if has_closed:
            self._waiting.close()
            self._waiting = None

    def _disconnect_host(self) -> None:
        """Disconnect the host, and discard bytes that were not sent."""
        peer, self._peer, self._unsent = self._peer, None, b""
        if peer is not None:
            peer.close()
            self._note_dtr_fall()

    def _note_dtr_rise(self) -> None:
        """Record that DTR rises, because a host has connected."""
        self._changes.append(LineChange(dtr=True))

    def _note_dtr_fall(self) -> None:
        """Record that DTR falls, because the host has disconnected."""
        self._changes.append(LineChange(dtr=False))


def _address_text(peer: socket.socket) -> str:
    """Return address and port of a connected host."""
    try:
        host, port = peer.getpeername()[:2]
    except OSError:
        return "a host that has gone"
    return f"{host}:{port}"


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


class Rfc2217Protocol(rfc2217.PortManager):
    """pyserial's server of the protocol, for hosts that may send any bytes."""

    # pyserial raises errors for an end of a request without its beginning, and for requests whose value is
    # missing or unknown; and it keeps a request without an end, however long it gets. Such requests are
    # ignored here, as the standard demands of unknown ones.

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
        self._manager: Rfc2217Protocol | None = None
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
        """Send `data` of the protocol itself without escaping; the board's bytes are escaped elsewhere."""
        # A host that sends requests and reads no answers is disconnected, so that the answers need no memory.
        self._is_overflowing = self._is_overflowing or len(self._unsent) > _MAX_UNSENT_BYTES
        if not self._is_overflowing:
            super().send(data)

    @override
    def _note_dtr_rise(self) -> None:
        self._is_overflowing = False
        self._lines = Lines(self._changes)
        # The type stubs require a complete serial port; the code uses only the attributes of Lines.
        self._manager = Rfc2217Protocol(cast(Any, self._lines), cast(Any, self))

    @override
    def _note_dtr_fall(self) -> None:
        if self._lines is not None:
            self._lines.dtr = False
        self._lines = self._manager = None
