"""The protocol of a session, without input and output: it consumes received bytes and returns frames to send.

It uses no thread, no clock and no port: `heli_host.link.session.Driver` passes received bytes and the time,
and sends the bytes that `Engine.outgoing` returns. Therefore a session over a port, with a thread, and one in
lockstep with a simulation run the same protocol.
"""

from __future__ import annotations

import dataclasses
import math
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum, auto
from typing import ClassVar, Final, Generic, NamedTuple, Protocol, TypeAlias, TypeVar

from heli_host.declaration import (
    LINK_HASH,
    LINK_VERSION,
    AckMessage,
    Event,
    EventMessage,
    FollowingMessage,
    HelloMessage,
    MessageId,
    ParamsMessage,
    PingMessage,
    PongMessage,
    Reset,
    Result,
    SetpointMessage,
    State,
    StatusMessage,
    StopMessage,
    VoltagesMessage,
    WelcomeMessage,
)
from heli_host.errors import (
    CommandRefused,
    CommandTimeout,
    HeliError,
    LinkError,
    LinkLost,
    LinkVersionMismatch,
    fault_text,
)
from heli_host.link.clock import TICK_S
from heli_host.link.events import (
    BOARD_RESTARTED,
    LINK_LOST,
    LINK_RESTORED,
    LINK_SILENT,
    LinkEvent,
    event_kind,
    event_text,
)
from heli_host.link.frames import Frame, FrameParser, encode_frame
from heli_host.link.telemetry import EMPTY_TICKS, LinkCounters, TelemetryReceiver, Ticks, insert_missed

# A reply takes 20 ms at most over a busy Due line. Tries grow apart, so that a slow simulation is not
# flooded.
_FIRST_TRY_S = 0.06
_LONGEST_TRY_S = 0.5


UNNUMBERED: Final = 0
"""Request number of a command that is not sent yet: `CommandSlot.ask` gives it the next number."""


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
        """Request number; `heli_host.link.engine.CommandSlot` sets it."""
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


class CommandSlot:
    """The one command that may be in progress."""

    # Part of an `Engine`: its callers serialise all calls.
    # It owns the command from its start to its answer. `due` returns it whenever it must be sent, again and
    # again, until the answer comes or the time is up.

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
        """Start a command."""
        # The caller waits for the previous command before it starts the next.
        # A protocol's dataclasses are not known to be such.
        numbered = dataclasses.replace(command, request=self._numbers.take())  # type: ignore[type-var]
        self._request = Request(numbered, now_s + timeout_s, now_s)
        return self._request

    def preempt(self, command: Command, now_s: float, timeout_s: float) -> Request:
        """Start a `command` ahead of all others, used for the stop."""
        # A command in progress is given up with an error. While `preempted` is true the caller must not start
        # another command. `now_s`, `timeout_s` and the returned request are those of `ask`.
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
        """Return the device time since a moment [s]."""
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
    """Setpoints and voltages on their way to the board."""

    # Part of an `Engine`: its callers serialise all calls.
    # It owns the values that wait, the setpoint that is kept alive, and the permission to send either. No
    # value has an answer: the newest replaces those before it.

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


HELLO_INTERVAL_S = 0.1


class Welcome(Enum):
    """Meaning of a welcome for this session."""

    IGNORED = auto()
    """It answers no hello of this handshake, or refuses the session: `Handshake.mismatch` is then set."""
    FIRST = auto()
    SAME_START = auto()
    """The link was lost or silent, and the board has run on meanwhile."""
    RESTARTED = auto()


class Handshake:
    """Hello and welcome."""

    # Part of an `Engine`: its callers serialise all calls.
    # It owns whether the session is open, and the newest welcome. While it is not open, it greets every
    # `HELLO_INTERVAL_S`.

    def __init__(self, session_number: int, numbers: RequestNumbers) -> None:
        self.is_open = False
        self.welcome: WelcomeMessage | None = None
        self.mismatch: LinkVersionMismatch | None = None
        self.unreachable_since_s: float | None = None
        self.reconnects = 0
        self.restarts = 0
        self._session_number = session_number
        self._numbers = numbers
        self._hello_request = numbers.take()
        # Before any host time: the first greeting is due immediately.
        self._next_hello_s = -math.inf

    @property
    def unreachable(self) -> bool:
        """Whether a board that welcomed this session before does not answer now."""
        return self.welcome is not None and not self.is_open

    def begin(self, now_s: float) -> None:
        """Greet again, because the board does not answer or has restarted."""
        if self.is_open or self.unreachable_since_s is None:
            self.unreachable_since_s = now_s
        self.is_open = False
        self._next_hello_s = now_s
        self._hello_request = self._numbers.take()

    def due_hello(self, now_s: float) -> HelloMessage | None:
        """Return a hello if one is due, for the caller to send."""
        if now_s < self._next_hello_s:
            return None
        self._next_hello_s = now_s + HELLO_INTERVAL_S
        return HelloMessage(self._hello_request, LINK_HASH, self._session_number)

    def take_welcome(self, welcome: WelcomeMessage, *, is_behind: bool) -> Welcome:
        """Open the session, if the welcome answers the present hello and the declarations are the same."""
        if self.is_open or welcome.request != self._hello_request:
            return Welcome.IGNORED
        if welcome.result != Result.OK or welcome.link_hash != LINK_HASH:
            board_link = f"{welcome.link_major}.{welcome.link_minor}"
            firmware = f"{welcome.firmware_major}.{welcome.firmware_minor}.{welcome.firmware_patch}"
            self.mismatch = LinkVersionMismatch(
                LINK_VERSION, LINK_HASH, board_link, welcome.link_hash, firmware
            )
            return Welcome.IGNORED
        previous = self.welcome
        self.welcome = welcome
        self.is_open = True
        self.unreachable_since_s = None
        if previous is None:
            return Welcome.FIRST
        self.reconnects += 1
        # Either condition alone may fail: the boot id of another start is the same by chance once in 2^24,
        # and the tick may be higher although the board restarted, if that was long ago.
        if welcome.boot_id == previous.boot_id and not is_behind:
            return Welcome.SAME_START
        self.restarts += 1
        return Welcome.RESTARTED


# A little less than 5 Hz: in lockstep time passes in steps of 0.1 s, and a step must not be just too short.
HEARTBEAT_S = 0.199
CLOCK_PING_S = 1.0
SILENCE_S = 1.0

_TICK_MASK = 0xFFFFFFFF


@dataclass
class Received:
    """Contents of the frames of one reading."""

    ticks: Ticks = EMPTY_TICKS
    events: list[LinkEvent] = field(default_factory=list)  # Events of board and link, in order
    statuses: list[StatusMessage] = field(default_factory=list)  # The board's counters


class _ParserCounts(NamedTuple):
    """Counters of the frame parser."""

    frames_ok: int
    frames_bad: int
    frames_lost: int
    bytes_received: int
    bytes_dropped: int


class Engine:
    """The state of one session."""

    # It has no lock and no thread: callers serialise all calls.
    # It owns the frames in both directions and passes the content of each frame to one of its four parts. A
    # stop goes through `commands`: `CommandSlot.preempt` starts it, and the next `outgoing` returns its
    # frame.

    def __init__(self, session_number: int) -> None:
        numbers = RequestNumbers(session_number)
        self.parser = FrameParser()
        self.handshake = Handshake(session_number, numbers)
        self.commands = CommandSlot(numbers)
        self.streams = StreamedValues()
        self.telemetry = TelemetryReceiver()
        self._numbers = numbers
        self._seq = 0
        self._last_heard_s = 0.0
        self._last_sent_s = self._last_ping_s = -1e9
        self._sent_tick = self._ping_tick = 0
        self._malformed = 0
        self._board: StatusMessage | None = None
        self._counts_at_welcome = _ParserCounts(
            frames_ok=0, frames_bad=0, frames_lost=0, bytes_received=0, bytes_dropped=0
        )

    def counters(self) -> LinkCounters:
        """Return all counts since the first welcome."""
        now, at_welcome = self._parser_counts(), self._counts_at_welcome
        counts = _ParserCounts(*(present - before for present, before in zip(now, at_welcome, strict=True)))
        streams, account = self.streams, self.telemetry.account
        return LinkCounters(
            frames_ok=counts.frames_ok,
            frames_bad=counts.frames_bad + self._malformed + self.telemetry.malformed,
            frames_lost=counts.frames_lost,
            bytes_received=counts.bytes_received,
            bytes_dropped=counts.bytes_dropped,
            retries=self.commands.retries,
            reconnects=self.handshake.reconnects,
            restarts=self.handshake.restarts,
            ticks_received=account.received,
            ticks_lost=account.lost,
            setpoints_sent=streams.setpoints.sent,
            setpoints_skipped=streams.setpoints.skipped,
            voltages_sent=streams.voltages.sent,
            voltages_skipped=streams.voltages.skipped,
            board=self._board,
        )

    def receive(self, data: bytes, now_s: float, wall_ns: int) -> Received:
        """Process bytes from the board."""
        received = Received()
        frames = self.parser.feed(data) if data else []
        if frames:
            self._last_heard_s = now_s
        for frame in frames:
            if frame.id == MessageId.TELEMETRY:
                self.telemetry.hold(frame.payload)
            else:
                self._process_frame(frame, now_s, wall_ns, received)
        if not self.handshake.is_open:
            self.telemetry.shorten_held()
            return received
        self._accept_telemetry(now_s, wall_ns, received)
        if now_s - self._last_heard_s > SILENCE_S:
            self._restart_handshake(now_s)
            received.events.append(self._link_event(LINK_SILENT, "the board has fallen silent", wall_ns))
        return received

    def outgoing(self, now_s: float) -> bytes:
        """Return the frames that are due: a command first, then streamed values, then a ping."""
        # Before the board has answered the handshake, only a hello is sent.
        self.commands.expire(now_s)
        if not self.handshake.is_open:
            hello = self.handshake.due_hello(now_s)
            return b"" if hello is None else self._encode_next_frame(hello, now_s)
        command = self.commands.due(now_s)
        frames_out = b"" if command is None else self._encode_next_frame(command, now_s)
        now = DeviceTime(now_s, self.telemetry.account.last or 0, self.telemetry.speed)
        is_flying = self.telemetry.state in (State.CLOSED_LOOP, State.HOLD)
        for value in self.streams.due(now, flies=is_flying):
            frames_out += self._encode_next_frame(value, now_s)
        if frames_out:
            self._sent_tick = now.tick
        # While a command waits, its repetitions show the board that the host is there.
        if not self.commands.waits and self._ping_is_due(now):
            self._last_ping_s = now_s
            self._sent_tick = self._ping_tick = now.tick
            ping = PingMessage(self._numbers.take(), round(now_s * 1e6))
            frames_out += self._encode_next_frame(ping, now_s)
        return frames_out

    def _ping_is_due(self, now: DeviceTime) -> bool:
        """Return whether the board needs a sign of life, or the clock a new round trip."""
        silence_s = now.since(self._last_sent_s, self._sent_tick)
        unpinged_s = now.since(self._last_ping_s, self._ping_tick)
        return silence_s >= HEARTBEAT_S or unpinged_s >= CLOCK_PING_S

    def frame_past_lock(self, command: type[StopMessage]) -> bytes:
        """Return the frame of a command that any thread may send without the callers' lock."""
        # Nothing changes.
        # The leading delimiter ends a frame that another thread has sent only in part.
        return b"\0" + encode_frame(command.ID, self._seq + 1, command(self._numbers.distant()).pack())

    def cut(self, now_s: float, wall_ns: int, reason: str) -> LinkEvent:
        """Record that the connection is lost; the handshake starts again after a reconnect."""
        self.parser.restart()
        self._restart_handshake(now_s)
        return self._link_event(LINK_LOST, reason, wall_ns)

    def _process_frame(self, frame: Frame, now_s: float, wall_ns: int, received: Received) -> None:
        """Process a frame from the board. A frame with a payload of wrong length is counted, and ignored."""
        try:
            match frame.id:
                case MessageId.WELCOME:
                    self._process_welcome(WelcomeMessage.unpack(frame.payload), now_s, wall_ns, received)
                case MessageId.PONG:
                    self._process_pong(PongMessage.unpack(frame.payload), now_s)
                case MessageId.STATUS:
                    self._board = StatusMessage.unpack(frame.payload)
                    received.statuses.append(self._board)
                case MessageId.EVENT:
                    self._process_event(EventMessage.unpack(frame.payload), now_s, wall_ns, received)
                case MessageId.PARAMS:
                    # A reply that is too short must not reach the caller of the command.
                    ParamsMessage.unpack(frame.payload)
                case MessageId.ACK:
                    if AckMessage.unpack(frame.payload).result == Result.NO_HANDSHAKE:
                        self._restart_handshake(now_s)
                        return
            self.commands.match(frame)
        except struct.error:
            self._malformed += 1

    def _process_welcome(
        self, message: WelcomeMessage, now_s: float, wall_ns: int, received: Received
    ) -> None:
        """Process a welcome: the first one, one after a lost link, or one after a restart of the board, which
        makes all unanswered commands fail.
        """
        is_behind = self.telemetry.is_behind(message.tick)
        welcome = self.handshake.take_welcome(message, is_behind=is_behind)
        if welcome is Welcome.IGNORED:
            return
        self._last_sent_s = self._last_ping_s = now_s - HEARTBEAT_S
        if welcome is Welcome.FIRST:
            self.telemetry.discard_held()
            self._counts_at_welcome = self._parser_counts()
        elif welcome is Welcome.SAME_START:
            received.events.append(self._link_event(LINK_RESTORED, "the link is back", wall_ns))
            self.commands.hasten(now_s)
        else:
            self.telemetry.restart()
            self.streams.kept = None
            text = _restart_text(message)
            received.events.append(self._link_event(BOARD_RESTARTED, text, wall_ns))
            self.commands.fail(LinkLost(f"{text} before it answered", "check its supply, then arm again"))

    def _process_pong(self, pong: PongMessage, now_s: float) -> None:
        """Measure the round trip and the device clock by an answer to a ping."""
        sent_s = pong.host_us * 1e-6
        self.commands.observe_round_trip(now_s - sent_s)
        if self.handshake.is_open:
            tick = self.telemetry.account.unwrap(pong.tick)
            self.telemetry.clock.observe_pong(sent_s, tick, now_s)

    def _process_event(self, message: EventMessage, now_s: float, wall_ns: int, received: Received) -> None:
        """Process an event of the board; if it reports a new start, begin the handshake again."""
        event = LinkEvent(message.tick, wall_ns, event_kind(message), event_text(message), message)
        received.events.append(event)
        self.telemetry.take_event(message)
        welcome = self.handshake.welcome
        is_same_start = welcome is not None and message.value == welcome.boot_id
        if message.kind == Event.BOOT and not is_same_start:
            self._restart_handshake(now_s)

    def _accept_telemetry(self, now_s: float, wall_ns: int, received: Received) -> None:
        """Accept the telemetry of a reading, with the events that it shows to be lost."""
        accepted = self.telemetry.accept_held(now_s)
        if accepted is None:
            return
        received.ticks = accepted.ticks
        for message in accepted.missed:
            insert_missed(message, wall_ns, received.events)
        if accepted.jumped_back:
            self._restart_handshake(now_s)

    def _restart_handshake(self, now_s: float) -> None:
        self.handshake.begin(now_s)
        self.parser.restart_sequence()

    def _link_event(self, kind: str, text: str, wall_ns: int) -> LinkEvent:
        return LinkEvent((self.telemetry.account.last or 0) & _TICK_MASK, wall_ns, kind, text)

    def _encode_next_frame(self, message: Command | StreamedMessage, now_s: float) -> bytes:
        self._last_sent_s = now_s
        self._seq = (self._seq + 1) & 0xFF
        return encode_frame(message.ID, self._seq, message.pack())

    def _parser_counts(self) -> _ParserCounts:
        """Return the counters of frames and bytes since the connection was opened."""
        parser = self.parser
        return _ParserCounts(
            parser.frames_ok,
            parser.frames_bad,
            parser.frames_lost,
            parser.bytes_received,
            parser.bytes_dropped,
        )


def _restart_text(welcome: WelcomeMessage) -> str:
    """Describe a restart of the board, with its cause and its fault."""
    reset = welcome.reset
    reason = Reset(reset).name.lower() if reset in Reset._value2member_map_ else "unknown"
    fault = f"; {fault_text(welcome.boot_fault)}" if welcome.boot_fault else ""
    return f"the board restarted ({reason}){fault}"
