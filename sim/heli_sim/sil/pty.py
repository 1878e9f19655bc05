"""A pseudo-terminal as a serial port, with a symbolic link as its permanent name.

One server at a time owns the path of the link.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import termios
import tty
from pathlib import Path
from typing import Final

from typing_extensions import override

from heli_sim.errors import EndpointError
from heli_sim.sil.ports import Endpoint, LineChange


class PortLink:
    """A path that becomes a link to a pseudo-terminal, and is reserved until `release`."""

    # The reservation is a lock on a hidden file in the same folder. The kernel drops the lock when the server
    # ends, however it ends. The file holds the server's process and its terminal, so that the next server
    # recognizes a link that a killed server left behind. A terminal's number alone cannot show that: Linux
    # gives the number to the next program that asks for a terminal.

    def __init__(self, path: Path) -> None:
        self.path = path
        self._terminal = ""
        self._refuse_a_file()
        self._lock_path = path.with_name(f".{path.name}.lock")
        self._lock = self._take_lock()
        _, self._terminal_before = self._process_and_terminal_in_lock()

    def point_to(self, terminal: str) -> None:
        """Make the link; it replaces a link that a killed server left."""
        self._refuse_a_file()
        try:
            if self.path.is_symlink():
                self._refuse_the_link_of_others(terminal)
                self.path.unlink()
            os.ftruncate(self._lock, 0)
            os.pwrite(self._lock, f"{os.getpid()} {terminal}\n".encode(), 0)
            # Unlike a rename, this replaces nothing that another program made in the meantime.
            self.path.symlink_to(terminal)
        except OSError as error:
            raise self._error_of_link(error) from None
        self._terminal = terminal

    def remove(self) -> None:
        """Remove the link if it still points to this server's terminal."""
        terminal, self._terminal = self._terminal, ""
        with contextlib.suppress(OSError):
            if terminal and str(self.path.readlink()) == terminal:
                self.path.unlink()

    def release(self) -> None:
        """Remove the link, so that another server can use the path. Further calls do nothing."""
        self.remove()
        if self._lock >= 0:
            with contextlib.suppress(OSError):
                self._lock_path.unlink()
            os.close(self._lock)
            self._lock = -1

    def _take_lock(self) -> int:
        """Lock the path of the port against other simulated boards, and return the file descriptor of the
        lock.
        """
        while True:
            try:
                lock = os.open(self._lock_path, os.O_RDWR | os.O_CREAT, 0o644)
            except OSError as error:
                raise self._error_of_link(error) from None
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                self._lock = lock
                process, _ = self._process_and_terminal_in_lock()
                os.close(lock)
                if not isinstance(error, BlockingIOError):
                    raise self._error_of_link(error) from None
                raise EndpointError(
                    f"{self.path} is the port of another simulated board{process and f', process {process}'}",
                    "end that program with Ctrl-C, or choose another path for this port",
                ) from None
            # A server that ended between the two calls removed the file that is locked here.
            with contextlib.suppress(OSError):
                if os.path.samestat(os.fstat(lock), self._lock_path.stat()):
                    return lock
            os.close(lock)

    def _process_and_terminal_in_lock(self) -> tuple[str, str]:
        """Process and terminal of the server that wrote the lock's file; empty in a new file."""
        words = os.pread(self._lock, 200, 0).decode(errors="replace").split()
        return (words[0], words[1]) if len(words) == 2 else ("", "")

    def _refuse_a_file(self) -> None:
        """Raise an EndpointError if the path is a file or folder, which must not be replaced."""
        if self.path.is_symlink() or not self.path.exists():
            return
        kind = "folder" if self.path.is_dir() else "file"
        raise EndpointError(f"{self.path} is a {kind}, not a link", "choose another path for the port")

    def _refuse_the_link_of_others(self, terminal: str) -> None:
        """Refuse a link that no simulated board made, so that no file of a user is replaced."""
        target = str(self.path.readlink())
        is_terminal = target.startswith(terminal.rstrip("0123456789"))
        if is_terminal and (target == self._terminal_before or not Path(target).exists()):
            return
        raise EndpointError(
            f"{self.path} is a link to {target}, which no simulated board made",
            "remove that link, or choose another path for the port",
        )

    def _error_of_link(self, error: OSError) -> EndpointError:
        return EndpointError(
            f"cannot make the port {self.path}: {error.strerror}", "choose a folder that you can write"
        )


_CHUNK: Final = 65536
# Indices into the list that tcgetattr returns.
_CFLAG: Final = 2
_OSPEED: Final = 5


class PtyEndpoint(Endpoint):
    """The board's side of a pseudo-terminal."""

    # A host opens the link like a device file. When the host closes the port, its unread bytes are discarded,
    # and the terminal remains for the next host. A pseudo-terminal has no line DTR, so opening counts as its
    # rise and closing as its fall. If the host has cleared the hang-up flag (``stty -hupcl``), DTR stays
    # high, as with a serial port of Linux. Without a link, the host opens the terminal itself.

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
