"""What the server needs of a serial port, whatever it is made of."""

from __future__ import annotations

from typing import Protocol


class Endpoint(Protocol):
    """The board's side of a port that a host may open, close and open again. Nothing here waits."""

    url: str
    """Address that a host opens."""

    def receive(self) -> bytes:
        """Take what the host wrote; also notes whether the port was opened or closed."""
        ...

    def send(self, data: bytes) -> None:
        """Give bytes to the host; what does not fit is kept for later, or lost when the port is closed.

        Parameters
        ----------
        data : bytes
            Bytes for the host; may be empty to try again with what was kept.
        """
        ...

    @property
    def ready(self) -> bool:
        """Whether a host has the port open and takes its bytes."""
        ...

    def take_opened(self) -> bool:
        """Whether the port was opened since the last call."""
        ...

    def fileno(self) -> int:
        """File descriptor to watch for bytes; -1 when nobody is there."""
        ...

    def unplug(self) -> None:
        """Take the port away, as pulling the cable does."""
        ...

    def plug(self) -> None:
        """Bring the port back under the same address."""
        ...

    def close(self) -> None:
        """Take the port away for good; twice does nothing."""
        ...
