"""The symbolic link to a pseudo-terminal, by which hosts find it. One server at a time owns its path."""

from __future__ import annotations

import contextlib
import fcntl
import os
from pathlib import Path

from heli_sim.errors import EndpointError


class PortLink:
    """A path that becomes a link to a pseudo-terminal, and is reserved until `release`.

    The reservation is a lock on a hidden file in the same folder. The kernel drops the lock when the server
    ends, however it ends. The file holds the server's process and its terminal, so that the next server
    recognizes a link that a killed server left behind. A terminal's number alone cannot show that: Linux
    gives the number to the next program that asks for a terminal.
    """

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
