"""The interface that pseudo-terminal, TCP and RFC 2217 ports share, for the server."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol


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
