"""Streamed values: the latest wins, at a bounded rate, and the last setpoint is kept fresh."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

from heli_host.declaration import FollowingMessage, SetpointMessage, VoltagesMessage

SETPOINT_INTERVAL_S = 1.0 / 200.0
VOLTAGES_INTERVAL_S = 1.0 / 500.0

Streamed = TypeVar("Streamed", SetpointMessage, VoltagesMessage, FollowingMessage)


@dataclass
class Stream(Generic[Streamed]):
    """One kind of streamed value.

    Parameters
    ----------
    interval_s : float
        Shortest time between two of them [s].
    waiting : SetpointMessage, VoltagesMessage, FollowingMessage or None
        The newest, not yet sent.
    sent_s : float
        Host time at which the last was sent [s].
    sent, skipped : int
        Values sent, and values that a later one replaced before they could be.
    """

    interval_s: float
    waiting: Streamed | None = None
    sent_s: float = -1e9
    sent: int = 0
    skipped: int = 0

    def put(self, message: Streamed) -> None:
        """Put a value in line, in the place of one that waits.

        Parameters
        ----------
        message : SetpointMessage, VoltagesMessage or FollowingMessage
            The value.
        """
        self.skipped += self.waiting is not None
        self.waiting = message

    def due(self, now_s: float, speed: float) -> bool:
        """Whether the value that waits may go.

        Parameters
        ----------
        now_s : float
            Host time [s].
        speed : float
            Device seconds in a host second.

        Returns
        -------
        bool
            False also when none waits.
        """
        return self.waiting is not None and now_s >= self.sent_s + self.interval_s / speed

    def release(self, message: Streamed, now_s: float) -> Streamed:
        """Note that a value is sent now.

        Parameters
        ----------
        message : SetpointMessage, VoltagesMessage or FollowingMessage
            The value.
        now_s : float
            Host time [s].

        Returns
        -------
        SetpointMessage, VoltagesMessage or FollowingMessage
            The same.
        """
        self.waiting, self.sent_s = None, now_s
        self.sent += 1
        return message
