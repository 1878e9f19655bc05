"""A command in progress: sent, repeated with the same number until the answer comes, or given up."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol

from heli_host.declaration import AckMessage, MessageId, Result
from heli_host.errors import CommandRefused, CommandTimeout, HeliError
from heli_host.link.frames import Frame

# A reply takes 20 ms at most over a busy Due line. Tries grow apart, so that a slow simulation is not
# flooded.
_FIRST_TRY_S = 0.06
_LONGEST_TRY_S = 0.5


class RequestNumbers:
    """Numbers of the requests of a session, from 1 to 255 and then from 1 again."""

    def __init__(self, seed: int) -> None:
        self._number = seed & 0xFF

    def take(self) -> int:
        """Return the next number."""
        # 0 is the number of messages that the board sends without a request.
        self._number = self._number % 255 + 1
        return self._number

    def distant(self) -> int:
        """Return a number that no request of the last 100 has had, and take none."""
        return (self._number + 126) % 255 + 1


class Command(Protocol):
    """A message that the board answers; every class of the declaration with a ``REPLY`` is one."""

    ID: ClassVar[MessageId]
    REPLY: ClassVar[MessageId]

    @property
    def request(self) -> int:
        """Request number; `heli_host.link.command_slot.CommandSlot` sets it."""
        ...

    def pack(self) -> bytes:
        """Return the payload bytes."""
        ...


@dataclass
class Request:
    """A command in progress."""

    command: Command
    deadline_s: float  # Host time at which the request fails without an answer [s]
    next_try_s: float  # Host time at which the request is sent next [s]
    tries: int = 0  # Number of times that the request was sent
    reply: Frame | None = None  # The board's answer
    error: HeliError | None = None  # Reason why the request failed
    urgent: bool = False  # True for a stop: other commands wait until it is done

    @property
    def done(self) -> bool:
        """Whether the command was answered or given up."""
        return self.reply is not None or self.error is not None

    def expire(self, now_s: float) -> None:
        """Give up when the deadline has passed."""
        if not self.done and now_s >= self.deadline_s:
            name = self.command.ID.name.lower()
            self.error = CommandTimeout(
                f"the board did not answer {name} in {self.tries} tries",
                "check the link with heli-host doctor",
            )

    def note_try(self, now_s: float, round_trip_s: float) -> None:
        """Record that the command is sent now, and schedule its next repetition."""
        patience_s = max(_FIRST_TRY_S, 2.0 * round_trip_s) * 1.5**self.tries
        self.next_try_s = now_s + min(patience_s, _LONGEST_TRY_S)
        self.tries += 1

    def match(self, frame: Frame) -> None:
        """Accept a frame as the reply if it answers this command."""
        if self.done or not frame.payload or frame.payload[0] != self.command.request:
            return
        is_ack = frame.id == MessageId.ACK
        is_reply = frame.payload[1] == self.command.ID if is_ack else frame.id == self.command.REPLY
        if is_reply:
            self.reply = frame

    def answer(self) -> Frame:
        """Return the board's answer."""
        if self.reply is None:
            raise self.error or CommandTimeout("the board did not answer the command", "try again")
        if self.reply.id == MessageId.ACK:
            ack = AckMessage.unpack(self.reply.payload)
            if ack.result != Result.OK:
                raise CommandRefused(ack.command, ack.result, ack.detail, ack.value)
        return self.reply
