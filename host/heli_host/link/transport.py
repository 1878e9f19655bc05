"""Connections that carry bytes to and from a board: a serial port, a socket, or a simulation.

A URL names the board. ``/dev/ttyACM0``, ``COM3``, ``socket://host:port``, ``rfc2217://...`` and ``spy://...``
go to pyserial; any other scheme is looked up in the entry-point group ``heli_host.transports``, whose objects
are called with the URL. Therefore a simulated board is an ordinary transport, and nothing here imports it.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import select
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, cast, runtime_checkable

import serial
from serial.tools import list_ports

from heli_host.declaration import BAUD
from heli_host.errors import BadBaud, LinkError, LinkLost, PortError
from heli_host.link.installation import plugins

ENTRY_POINT_GROUP = "heli_host.transports"

# A Due sends a burst every 4 ms, and every waking costs processor time. A batch takes 20 ms anyway; a control
# loop on the host asks for shorter ones, and sets 1 ms here.
READ_INTERVAL_S = 0.02

_READ_SIZE = 65536
_WRITE_TIMEOUT_S = 1.0
_POLL_S = 0.002
_PAGE = "page"
_ERASING_BAUD = 1200
_RESET_PULSE_S = 0.05


@runtime_checkable
class Transport(Protocol):
    """Connection to a board, as a session uses it."""

    # A session calls `read` from one thread, and `write` from any thread, one call at a time.

    @property
    def lockstep(self) -> bool:
        """Whether device time advances only inside `read`."""
        ...

    @property
    def url(self) -> str:
        """Address of the board, as the user wrote it."""
        ...

    def read(self, timeout_s: float) -> bytes:
        """Return the bytes that arrived, waiting for them at most ``timeout_s``."""
        ...

    def write(self, data: bytes) -> None:
        """Send bytes."""
        ...

    def now_s(self) -> float:
        """Return a monotonic time [s]; simulated seconds in lockstep."""
        ...

    def wall_ns(self) -> int:
        """Return Unix time [ns]; in lockstep a fixed epoch plus simulated time, so that logs repeat."""
        ...

    def close(self) -> None:
        """Close the connection; a second call does nothing. No command is sent to the board."""
        ...

    def reopen(self) -> Transport:
        """Open the same board again, after this transport was lost and closed."""
        ...


class SerialTransport:
    """A board behind anything that pyserial can open."""

    # Opening clears the port's hang-up flag if the system has one. The kernel then keeps DTR raised when this
    # process ends. Therefore the next process does not reset a board that may still be flying.

    lockstep = False

    def __init__(
        self,
        url: str,
        baud: int = BAUD,
        *,
        reset_board: bool = False,
        min_read_interval_s: float = READ_INTERVAL_S,
    ) -> None:
        if baud == _ERASING_BAUD:
            raise BadBaud("1200 baud erases the flash of a Due", f"leave the rate at {BAUD}")
        self.url = url
        self.min_read_interval_s = min_read_interval_s
        self._baud = baud
        self._serial = _open_serial(url, baud)
        # After it was unplugged, a board may get another device number, so a permanent name is needed.
        self._stable_url = stable_name(url)
        self._last_read_s = -1.0
        try:
            # An rfc2217 connection has no file descriptor, and its fileno() raises an error.
            self._fd: int | None = self._serial.fileno()
        except (OSError, AttributeError):
            self._fd = None
        if self._fd is not None:
            _keep_dtr_on_close(self._fd)
        if reset_board:
            # The rising edge of DTR resets a Due.
            self._serial.dtr = False
            time.sleep(_RESET_PULSE_S)
            self._serial.dtr = True

    def read(self, timeout_s: float) -> bytes:
        """Return the bytes that arrived; see `Transport.read`."""
        deadline_s = time.monotonic() + timeout_s
        pause_s = min(self._last_read_s + self.min_read_interval_s, deadline_s) - time.monotonic()
        if pause_s > 0.0:
            time.sleep(pause_s)
        with self._errors_as_lost_link():
            while not (data := self._read_arrived()):
                remaining_s = deadline_s - time.monotonic()
                if remaining_s <= 0.0:
                    break
                if self._fd is None or os.name != "posix":
                    time.sleep(min(_POLL_S, remaining_s))
                else:
                    select.select([self._fd], [], [], remaining_s)
        self._last_read_s = time.monotonic()
        return data

    def write(self, data: bytes) -> None:
        """Send bytes; see `Transport.write`."""
        with self._errors_as_lost_link():
            self._serial.write(data)

    def now_s(self) -> float:
        """Return the system's monotonic clock [s]."""
        return time.monotonic()

    def wall_ns(self) -> int:
        """Return Unix time [ns]."""
        return time.time_ns()

    def close(self) -> None:
        """Close the port."""
        with contextlib.suppress(OSError, serial.SerialException):
            self._serial.close()

    def reopen(self) -> SerialTransport:
        """Open the same port again, if possible by its permanent name."""
        return SerialTransport(self._stable_url, self._baud, min_read_interval_s=self.min_read_interval_s)

    def _read_arrived(self) -> bytes:
        """Return all bytes that have arrived, without waiting."""
        # One call returns at most 4096 bytes of a terminal, even if more have arrived.
        first: bytes = self._serial.read(_READ_SIZE)
        if len(first) < 4095:
            return first
        pieces = [first]
        while len(pieces) < 64 and (more := self._serial.read(_READ_SIZE)):
            pieces.append(more)
        return b"".join(pieces)

    @contextlib.contextmanager
    def _errors_as_lost_link(self) -> Iterator[None]:
        """Translate errors of the port in this ``with`` block to LinkLost."""
        try:
            yield
        # TypeError and AttributeError: pyserial uses a handle that its own close has set to None.
        except (serial.SerialException, OSError, TypeError, AttributeError) as error:
            reason = (
                "it takes no bytes" if isinstance(error, serial.SerialTimeoutException) else "it went away"
            )
            raise LinkLost(
                f"lost {self.url}: {reason}", "check cable and power; heli_host reconnects"
            ) from error


@dataclass(frozen=True)
class PortInfo:
    """A serial port of this computer."""

    device: str  # Name to open it by
    stable_name: str  # Permanent name that survives unplugging; the same as ``device`` if the system has none
    description: str  # Description of the port by the operating system
    vendor_id: int | None  # vendor_id, product_id: USB numbers, None for a port that is not USB
    product_id: int | None


def available_ports() -> list[PortInfo]:
    """List the serial ports of this computer."""
    return [
        PortInfo(port.device, stable_name(port.device), port.description or "", port.vid, port.pid)
        for port in sorted(list_ports.comports(), key=lambda port: str(port.device))
    ]


def stable_name(device: str) -> str:
    """Return the permanent name of a port, which does not change when the board is plugged in again."""
    folder = Path("/dev/serial/by-id")
    if device.startswith("/dev/") and folder.is_dir() and not device.startswith(str(folder)):
        for link in sorted(folder.iterdir()):
            if link.resolve() == Path(device).resolve():
                return str(link)
    return device


def open_transport(
    url: str, *, baud: int = BAUD, reset_board: bool = False, min_read_interval_s: float = READ_INTERVAL_S
) -> Transport:
    """Open the board that a URL names."""
    if baud == _ERASING_BAUD:
        raise BadBaud("1200 baud erases the flash of a Due", f"leave the rate at {BAUD}")
    scheme = url.partition("://")[0].lower() if "://" in url else ""
    if scheme == _PAGE:
        raise PortError(
            f"{url.partition('?')[0]} is a dashboard, not a board", "join its flight: heli_host.join(address)"
        )
    if scheme:
        for entry in plugins(ENTRY_POINT_GROUP).select(name=scheme):
            factory = cast(Callable[[str], Transport], entry.load())
            return factory(url)
    return SerialTransport(url, baud, reset_board=reset_board, min_read_interval_s=min_read_interval_s)


def transport_label(transport: Transport) -> str:
    """Return a description of the board, if the transport has more information than the board sends."""
    return str(getattr(transport, "label", ""))


def transport_board_name(transport: Transport) -> str:
    """Return the name of the board for a log, which is the first part of its label without the word board."""
    return transport_label(transport).partition(",")[0].removesuffix(" board")


def transport_rig(transport: Transport) -> str:
    """Return the rig of a simulated board."""
    return str(getattr(transport, "rig", ""))


def transport_rig_parameters(transport: Transport) -> Mapping[str, float]:
    """Return the parameters that the rig of a simulated board determines."""
    parameters: Mapping[str, float] = getattr(transport, "rig_parameters", {})
    return parameters


def transport_recipe(transport: Transport) -> Mapping[str, str]:
    """Return what repeats a simulation: address, whole rig, digests of files; empty for hardware."""
    recipe: Mapping[str, str] = getattr(transport, "recipe", {})
    return recipe


def transport_note(transport: Transport) -> str:
    """Return a note for the user on how the board was chosen."""
    return str(getattr(transport, "note", ""))


def set_read_interval(transport: Transport, interval_s: float) -> None:
    """Set the time for which a transport collects bytes before it returns them."""
    if hasattr(transport, "min_read_interval_s"):
        transport.min_read_interval_s = interval_s


def _open_serial(url: str, baud: int) -> serial.SerialBase:
    """Open a serial port or a pyserial address without waiting reads. Errors are translated to LinkErrors
    with a remedy.
    """
    is_file = os.name == "posix" and "://" not in url
    options: dict[str, Any] = {"exclusive": True} if is_file else {}
    if url.lower().startswith("rfc2217://"):
        # pyserial's own client refuses a write_timeout, its socket has one; and with a timeout of 0 its read
        # returns one byte, however many wait.
        options |= {"timeout": _POLL_S}
    else:
        options |= {"timeout": 0, "write_timeout": _WRITE_TIMEOUT_S}
    try:
        return serial.serial_for_url(url, baud, **options)
    except ValueError as error:
        if "protocol" in str(error):
            scheme = url.partition("://")[0]
            raise LinkError(
                f"no installed package provides {scheme}:// links",
                "give a port name or socket://host:port, or install the package that provides it",
            ) from error
        raise BadBaud(f"{url} cannot run at {baud} baud", f"leave the rate at {BAUD}") from error
    except (serial.SerialException, OSError) as error:
        raise _port_error(url, error) from error


def _port_error(url: str, error: Exception) -> PortError:
    """Return the PortError for an error of the operating system: no permission, in use, or not there."""
    number = getattr(error, "errno", None)
    text = str(error).lower()
    if number in (errno.EACCES, errno.EPERM) or "permission" in text or "access is denied" in text:
        return PortError(
            f"no permission to open {url}", "run: sudo usermod -a -G dialout $USER, then log out and in again"
        )
    if number in (errno.EBUSY, errno.EAGAIN) or "lock" in text:
        return PortError(
            f"{url} is in use by another program",
            "close the other program; if it is ModemManager, heli-host doctor says how to stop it",
        )
    if "://" in url:
        return PortError(f"cannot open {url}", "check that its other end is running and listening")
    if re.fullmatch(r"[\w.-]+:\d+", url):
        return PortError(
            f"cannot open port {url}", f"for a board that is served over TCP, give socket://{url}"
        )
    # A computer's own serial ports, such as /dev/ttyS0, have no USB number; no Due is behind them.
    ports = ", ".join(port.device for port in available_ports() if port.vendor_id is not None)
    remedy = (
        f"choose an existing port: {ports}"
        if ports
        else "plug the board in, because no USB port exists, or simulate it: --sil, in Python sil://"
    )
    return PortError(f"cannot open port {url}", remedy)


def _keep_dtr_on_close(fd: int) -> None:
    """Keep the line DTR as it is when the port is closed: its edge resets the board."""
    # Sockets do not have this flag, and Windows does not have termios.
    try:
        import termios
    except ImportError:
        return
    with contextlib.suppress(OSError, termios.error):
        attributes = termios.tcgetattr(fd)
        attributes[2] &= ~termios.HUPCL
        termios.tcsetattr(fd, termios.TCSANOW, attributes)
