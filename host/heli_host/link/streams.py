"""Streamed values: of several that wait, only the newest is sent, at a limited rate and with permission."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeAlias, TypeVar

from heli_host.declaration import FollowingMessage, SetpointMessage, VoltagesMessage
from heli_host.link.clock import TICK_S

SETPOINT_INTERVAL_S = 1.0 / 200.0
VOLTAGES_INTERVAL_S = 1.0 / 500.0
# A little less than 10 Hz: in lockstep time passes in steps of 0.1 s, and a step must not be just too short.
KEEP_ALIVE_S = 0.099

# Samples that wait in the port arrive faster than they were made, and the estimated speed of the device is
# then meaningless: so much device time may pass unseen [s]. More: the host floods the board after it read
# slowly, and a stop waits behind the flood. Less: batches of a fast simulation delay the next sign of life.
_UNSEEN_S = 0.05

StreamedMessage: TypeAlias = SetpointMessage | VoltagesMessage | FollowingMessage

Streamed = TypeVar("Streamed", SetpointMessage, VoltagesMessage, FollowingMessage)


@dataclass(frozen=True)
class DeviceTime:
    """The present time of the host, and as much as it knows of the device's."""

    now_s: float  # Host time [s]
    tick: int  # Newest tick received
    speed: float  # Device seconds per host second

    def since(self, sent_s: float, sent_tick: int) -> float:
        """Return the device time since a moment [s].

        It follows from the device's speed, but is not much more than the samples show.
        """
        host_s = self.now_s - sent_s
        seen_s = (self.tick - sent_tick) * TICK_S + _UNSEEN_S
        return max(host_s, min(host_s * self.speed, seen_s))


@dataclass
class Stream(Generic[Streamed]):
    """Rate limit of one kind of streamed value."""

    interval_s: float  # Shortest device time between two values [s]
    waiting: Streamed | None = None  # The newest value that was not sent yet
    sent_s: float = -1e9  # Host time at which the last value was sent [s]
    sent: int = 0
    """sent, skipped: Number of values that were sent, and that a newer one replaced before they were sent."""
    skipped: int = 0

    def put(self, message: Streamed) -> None:
        """Set the value to send next; it replaces a waiting value."""
        self.skipped += self.waiting is not None
        self.waiting = message

    def release_due(self, now: DeviceTime) -> Streamed | None:
        """Release the waiting value if the rate limit permits; None if nothing is due."""
        if self.waiting is None or now.now_s < self.sent_s + self.interval_s / now.speed:
            return None
        return self.release(self.waiting, now.now_s)

    def release(self, message: Streamed, now_s: float) -> Streamed:
        """Record that `message` is sent now, and return it."""
        self.waiting, self.sent_s = None, now_s
        self.sent += 1
        return message


class StreamedValues:
    """Setpoints and voltages on their way to the board. Part of an `Engine`: its callers serialise all calls.

    It owns the values that wait, the setpoint that is kept alive, and the permission to send either. No value
    has an answer: the newest replaces those before it.
    """

    def __init__(self) -> None:
        self.kept: SetpointMessage | None = None
        self.permitted: Callable[[], bool] = lambda: True
        self.setpoints = Stream[SetpointMessage](SETPOINT_INTERVAL_S)
        self.voltages = Stream[VoltagesMessage](VOLTAGES_INTERVAL_S)
        self._following = Stream[FollowingMessage](VOLTAGES_INTERVAL_S)
        self._setpoint_tick = 0

    def put(self, message: StreamedMessage) -> None:
        """Set the next value; `due` returns it as soon as the rate limit permits."""
        if isinstance(message, SetpointMessage):
            self.setpoints.put(message)
        elif isinstance(message, VoltagesMessage):
            self.voltages.put(message)
        else:
            self._following.put(message)

    def due(self, now: DeviceTime, *, flies: bool) -> list[StreamedMessage]:
        """Return the values that are due, for the caller to send."""
        now_s = now.now_s
        setpoint_age_s = now.since(self.setpoints.sent_s, self._setpoint_tick)
        keep_alive = self.kept if flies and setpoint_age_s >= KEEP_ALIVE_S else None
        if (self.setpoints.waiting or self.voltages.waiting or keep_alive) and not self.permitted():
            keep_alive = self.setpoints.waiting = self.voltages.waiting = self._following.waiting = None
        replaces_kept = self.setpoints.waiting is not None
        values: list[StreamedMessage | None] = [
            stream.release_due(now) for stream in (self.setpoints, self.voltages, self._following)
        ]
        if keep_alive is not None and not replaces_kept:
            # Its tick may be in the past; the board then continues towards the same target.
            values.append(self.setpoints.release(keep_alive, now_s))
        if self.setpoints.sent_s == now_s:
            self._setpoint_tick = now.tick
        return [value for value in values if value is not None]
