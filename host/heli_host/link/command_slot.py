"""The command in progress: at most one, and a stop takes the place of any other."""

from __future__ import annotations

import dataclasses

from heli_host.errors import HeliError, LinkError
from heli_host.link.frames import Frame
from heli_host.link.requests import Command, Request, RequestNumbers


class CommandSlot:
    """The one command that may be in progress. Part of an `Engine`: its callers serialise all calls.

    It owns the command from its start to its answer. `due` returns it whenever it must be sent, again and
    again, until the answer comes or the time is up.
    """

    def __init__(self, numbers: RequestNumbers) -> None:
        self.stops = 0
        self.retries = 0
        self._numbers = numbers
        self._request: Request | None = None
        self._round_trip_s = 0.0

    @property
    def preempted(self) -> bool:
        """Whether a command of `preempt` still waits for its answer."""
        request = self._request
        return request is not None and request.urgent and not request.done

    def ask(self, command: Command, now_s: float, timeout_s: float) -> Request:
        """Start a command.

        The caller waits for the previous command before it starts the next.
        """
        # A protocol's dataclasses are not known to be such.
        numbered = dataclasses.replace(command, request=self._numbers.take())  # type: ignore[type-var]
        self._request = Request(numbered, now_s + timeout_s, now_s)
        return self._request

    def preempt(self, command: Command, now_s: float, timeout_s: float) -> Request:
        """Start a `command` ahead of all others, used for the stop.

        A command in progress is given up with an error. While `preempted` is true the caller must not start
        another command. `now_s`, `timeout_s` and the returned request are those of `ask`.
        """
        if self._request is not None and not self._request.done:
            name = self._request.command.ID.name.lower()
            self._request.error = LinkError(f"a stop came before the board answered {name}", "begin again")
        self.stops += 1
        request = self.ask(command, now_s, timeout_s)
        request.urgent = True
        return request

    def expire(self, now_s: float) -> None:
        """Give the command up if its time is over."""
        if self._request is not None:
            self._request.expire(now_s)

    @property
    def waits(self) -> bool:
        """Whether a command waits for its answer."""
        return self._request is not None and not self._request.done

    def due(self, now_s: float) -> Command | None:
        """Return the command if it must be sent now, for the caller to send, and schedule its repetition."""
        request = self._request
        if request is None or request.done or now_s < request.next_try_s:
            return None
        self.retries += request.tries > 0
        request.note_try(now_s, self._round_trip_s)
        return request.command

    def hasten(self, now_s: float) -> None:
        """Send the command again immediately, because the link is back."""
        if self._request is not None:
            self._request.next_try_s = now_s

    def fail(self, error: HeliError) -> None:
        """Give up the command that waits, if there is one."""
        if self._request is not None and not self._request.done:
            self._request.error = error

    def match(self, frame: Frame) -> None:
        """Accept a frame as the reply if it answers the command in progress."""
        if self._request is not None:
            self._request.match(frame)

    def observe_round_trip(self, duration_s: float) -> None:
        """Adapt the time between repetitions to the link."""
        self._round_trip_s = max(0.8 * self._round_trip_s, duration_s)
