"""Rate limit of streamed values: of several that wait, only the newest is sent."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

from heli_host.declaration import FollowingMessage, SetpointMessage, VoltagesMessage

SETPOINT_INTERVAL_S = 1.0 / 200.0
VOLTAGES_INTERVAL_S = 1.0 / 500.0

Streamed = TypeVar("Streamed", SetpointMessage, VoltagesMessage, FollowingMessage)


@dataclass
class Stream(Generic[Streamed]):
    """Rate limit of one kind of streamed value.

    Parameters
    ----------
    interval_s : float
        Shortest device time between two values [s].
    waiting : SetpointMessage, VoltagesMessage, FollowingMessage or None
        The newest value that was not sent yet.
    sent_s : float
        Host time at which the last value was sent [s].
    sent, skipped : int
        Number of values that were sent, and that a newer one replaced before they were sent.
    """

    interval_s: float
    waiting: Streamed | None = None
    sent_s: float = -1e9
    sent: int = 0
    skipped: int = 0

    def put(self, message: Streamed) -> None:
        """Set the value to send next; it replaces one that waits."""
        self.skipped += self.waiting is not None
        self.waiting = message

    def due(self, now_s: float, speed: float) -> bool:
        """Whether the rate limit permits sending the waiting value now; False if none waits.

        Parameters
        ----------
        now_s : float
            Host time [s].
        speed : float
            Device seconds per host second.
        """
        return self.waiting is not None and now_s >= self.sent_s + self.interval_s / speed

    def release(self, message: Streamed, now_s: float) -> Streamed:
        """Record that `message` is sent now, and return it.

        Parameters
        ----------
        now_s : float
            Host time [s].
        """
        self.waiting, self.sent_s = None, now_s
        self.sent += 1
        return message
