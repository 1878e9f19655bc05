"""Interface of a serial port for the server, the same for all kinds of ports."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True)
class LineChange:
    """The host has changed DTR.

    Parameters
    ----------
    dtr : bool
        The line now; a Due's bridge resets the board when it rises.
    baud : int
        Rate of the port, bits per second; 0 if it is unknown. At 1200 a Due's bridge erases the flash.
    """

    dtr: bool
    baud: int = 0


class Endpoint(Protocol):
    """The board's side of a port that a host may open, close and open again. Nothing here waits."""

    url: str
    """Address that a host opens."""

    def receive(self) -> bytes:
        """Take the bytes that the host wrote; empty if there are none. Also notes opening and closing."""
        ...

    def send(self, data: bytes) -> None:
        """Give `data` to the host; what does not fit is kept for later, or lost when the port is closed.
        Empty data tries again with what was kept.
        """
        ...

    @property
    def ready(self) -> bool:
        """Whether a host has the port open and takes its bytes."""
        ...

    def take_lines(self) -> list[LineChange]:
        """Changes of DTR since the last call, in order."""
        ...

    def fileno(self) -> int:
        """File descriptor to watch for bytes or for the next host; -1 when there is none to watch."""
        ...

    def unplug(self) -> None:
        """Take the port away, as pulling the cable does."""
        ...

    def plug(self) -> None:
        """Bring the port back under the same address; raises EndpointError if that is impossible."""
        ...

    def close(self) -> None:
        """Take the port away for good; twice does nothing."""
        ...
