"""The protocol of a session, without input and output: it consumes received bytes and returns frames to send.

It uses no thread, no clock and no port: `heli_host.link.driver.Driver` passes received bytes and the time,
and sends the bytes that `Engine.outgoing` returns. Therefore a session over a port, with a thread, and one in
lockstep with a simulation run the same protocol.
"""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum, auto

import numpy as np
import numpy.typing as npt

from heli_host.declaration import (
    LINK_HASH,
    LINK_VERSION,
    AckMessage,
    Channel,
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
    VoltagesMessage,
    WelcomeMessage,
)
from heli_host.errors import LinkError, LinkLost, LinkVersionMismatch, fault_text
from heli_host.link.accounting import LinkCounters, TickAccount
from heli_host.link.channels import MODES, declared
from heli_host.link.clock import TICK_S, ClockFit
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
from heli_host.link.missed_events import MissedEvents
from heli_host.link.requests import Command, Request
from heli_host.link.streams import SETPOINT_INTERVAL_S, VOLTAGES_INTERVAL_S, Stream
from heli_host.link.telemetry import EMPTY_TICKS, TelemetryDecoder, Ticks

HELLO_INTERVAL_S = 0.1
# A little less than 5 and 10 Hz: in lockstep time passes in steps of 0.1 s, and a step must not be just too
# short.
HEARTBEAT_S = 0.199
KEEP_ALIVE_S = 0.099
CLOCK_PING_S = 1.0
SILENCE_S = 1.0

# Samples that wait in the port arrive faster than they were made, and the estimated speed of the device is
# then meaningless: so much device time may pass unseen [s]. More: the host floods the board after it read
# slowly, and a stop waits behind the flood. Less: batches of a fast simulation delay the next sign of life.
_UNSEEN_S = 0.05
_HELD_BATCHES = 500
_TICK_MASK = 0xFFFFFFFF


class Phase(Enum):
    """Whether the board has welcomed this session."""

    GREETING = auto()
    OPEN = auto()


@dataclass
class Received:
    """Contents of the frames of one reading.

    Parameters
    ----------
    events : list of LinkEvent
        Events of board and link, in order.
    statuses : list of StatusMessage
        The board's counters.
    """

    ticks: Ticks = EMPTY_TICKS
    events: list[LinkEvent] = field(default_factory=list)
    statuses: list[StatusMessage] = field(default_factory=list)


class Engine:
    """The state of one session. It has no lock: callers serialise all calls.

    Parameters
    ----------
    session_number : int
        Number by which the board distinguishes this session; unchanged by a reconnect.

    Attributes
    ----------
    parser : FrameParser
        Frames and their counts.
    account : TickAccount
        Ticks received and lost.
    clock : ClockFit
        Relation of device time to host time.
    phase : Phase
        Whether the board has welcomed this session.
    welcome : WelcomeMessage or None
        The board's newest welcome.
    mismatch : LinkVersionMismatch or None
        Set if the board's firmware was built from another version of link.toml.
    latest_raw : ndarray of int32, shape (channels,), or None
        Newest sample, channels in the declaration's order.
    unreachable_since_s : float or None
        Host time at which the board stopped answering [s].
    restarts : int
        Number of restarts of the board during the session.
    kept : SetpointMessage or None
        Setpoint that is repeated ten times per second while the board flies on setpoints.
    permitted : callable returning bool
        Condition for sending setpoints and voltages, evaluated whenever some are due. While it is false they
        are dropped; the board then holds level and lands.
    stops : int
        Number of calls of `preempt`.
    """

    def __init__(self, session_number: int) -> None:
        self.parser = FrameParser()
        self.account = TickAccount()
        self.clock = ClockFit()
        self.phase = Phase.GREETING
        self.welcome: WelcomeMessage | None = None
        self.mismatch: LinkVersionMismatch | None = None
        self.latest_raw: npt.NDArray[np.int32] | None = None
        self.unreachable_since_s: float | None = None
        self.kept: SetpointMessage | None = None
        self.permitted: Callable[[], bool] = lambda: True
        self.stops = 0
        self._decoder = TelemetryDecoder()
        self._missed = MissedEvents()
        self._session_number = session_number
        self._seq = 0
        self._request_number = session_number & 0xFF
        self._hello_request = self._number()
        self._next_hello_s = -1e9
        self._last_sent_s = -1e9
        self._last_heard_s = 0.0
        self._last_ping_s = -1e9
        self._sent_tick = self._ping_tick = self._setpoint_tick = 0
        self._request: Request | None = None
        self._setpoints = Stream[SetpointMessage](SETPOINT_INTERVAL_S)
        self._voltages = Stream[VoltagesMessage](VOLTAGES_INTERVAL_S)
        self._following = Stream[FollowingMessage](VOLTAGES_INTERVAL_S)
        self._held: list[bytes] = []
        self._retries = 0
        self._reconnects = 0
        self.restarts = 0
        self._malformed = 0
        self._board: StatusMessage | None = None
        self._baseline = (0, 0, 0, 0, 0)
        self._round_trip_s = 0.0

    @property
    def state(self) -> State | None:
        """Supervisor state in the newest sample; None before the first, and for one unknown to this host."""
        if self.latest_raw is None:
            return None
        state = State._value2member_map_.get(int(self.latest_raw[Channel.STATE]))
        return state if isinstance(state, State) else None

    @property
    def speed(self) -> float:
        """Device seconds per host second, at least 1; a fast simulation shortens all intervals."""
        estimate = self.clock.estimate()
        return 1.0 if estimate is None else max(estimate.rate, 1.0)

    @property
    def unreachable(self) -> bool:
        """Whether a board that welcomed this session before does not answer now."""
        return self.welcome is not None and self.phase is Phase.GREETING

    def counters(self) -> LinkCounters:
        """Return all counts since the first welcome."""
        frames_ok, frames_bad, frames_lost, received, dropped = (
            now - then for now, then in zip(self._parser_counts(), self._baseline, strict=True)
        )
        return LinkCounters(
            frames_ok=frames_ok,
            frames_bad=frames_bad + self._malformed + self._decoder.malformed,
            frames_lost=frames_lost,
            bytes_received=received,
            bytes_dropped=dropped,
            retries=self._retries,
            reconnects=self._reconnects,
            restarts=self.restarts,
            ticks_received=self.account.received,
            ticks_lost=self.account.lost,
            setpoints_sent=self._setpoints.sent,
            setpoints_skipped=self._setpoints.skipped,
            voltages_sent=self._voltages.sent,
            voltages_skipped=self._voltages.skipped,
            board=self._board,
        )

    def receive(self, data: bytes, now_s: float, wall_ns: int) -> Received:
        """Process bytes from the board.

        Parameters
        ----------
        data : bytes
            Bytes of one reading; may be empty.
        now_s : float
            Host time of their arrival [s].
        wall_ns : int
            Unix time of their arrival [ns].
        """
        received = Received()
        frames = self.parser.feed(data) if data else []
        if frames:
            self._last_heard_s = now_s
        for frame in frames:
            if frame.id == MessageId.TELEMETRY:
                self._held.append(frame.payload)
            else:
                self._take(frame, now_s, wall_ns, received)
        if self.phase is Phase.GREETING:
            # After a reconnect these become samples, once the welcome has said that it is the same start.
            del self._held[:-_HELD_BATCHES]
            return received
        if self._held:
            self._take_telemetry(now_s, wall_ns, received)
        if now_s - self._last_heard_s > SILENCE_S:
            self._greet(now_s)
            received.events.append(self._event(LINK_SILENT, "the board has fallen silent", wall_ns))
        return received

    def outgoing(self, now_s: float) -> bytes:
        """Return the frames that are due.

        Parameters
        ----------
        now_s : float
            Host time [s].

        Returns
        -------
        bytes
            Bytes that the caller must send immediately; empty if nothing is due.
        """
        request = self._request
        if request is not None:
            request.expire(now_s)
            if request.done:
                request = None
        if self.phase is Phase.GREETING:
            if now_s < self._next_hello_s:
                return b""
            self._next_hello_s = now_s + HELLO_INTERVAL_S
            return self._frame(HelloMessage(self._hello_request, LINK_HASH, self._session_number), now_s)
        speed = self.speed
        out = b""
        if request is not None and now_s >= request.next_try_s:
            self._retries += request.tries > 0
            request.note_try(now_s, self._round_trip_s)
            out += self._frame(request.command, now_s)
        setpoint, voltages = self._setpoints.waiting, self._voltages.waiting
        stale_s = self._device_s(self._setpoints.sent_s, self._setpoint_tick, now_s)
        flies = self.state in (State.CLOSED_LOOP, State.HOLD)
        kept = self.kept if flies and stale_s >= KEEP_ALIVE_S else None
        if (setpoint or voltages or kept) and not self.permitted():
            kept = None
            self._setpoints.waiting = self._voltages.waiting = setpoint = voltages = None
            self._following.waiting = None
        if setpoint is not None and self._setpoints.due(now_s, speed):
            out += self._frame(self._setpoints.release(setpoint, now_s), now_s)
        if voltages is not None and self._voltages.due(now_s, speed):
            out += self._frame(self._voltages.release(voltages, now_s), now_s)
        following = self._following.waiting
        if following is not None and self._following.due(now_s, speed):
            out += self._frame(self._following.release(following, now_s), now_s)
        if kept is not None and setpoint is None:
            # Its tick may lie in the past: the board then goes on towards the same target.
            out += self._frame(self._setpoints.release(kept, now_s), now_s)
        newest = self.account.last or 0
        if self._setpoints.sent_s == now_s:
            self._setpoint_tick = newest
        if self._last_sent_s == now_s:
            self._sent_tick = newest
        idle_s = self._device_s(self._last_sent_s, self._sent_tick, now_s)
        unpinged_s = self._device_s(self._last_ping_s, self._ping_tick, now_s)
        if request is None and (idle_s >= HEARTBEAT_S or unpinged_s >= CLOCK_PING_S):
            self._last_ping_s = now_s
            self._sent_tick = self._ping_tick = newest
            out += self._frame(PingMessage(self._number(), round(now_s * 1e6)), now_s)
        return out

    def _device_s(self, since_s: float, since_tick: int, now_s: float) -> float:
        """Device time since a moment [s]: by the device's speed, but not much more than the samples show."""
        host_s = now_s - since_s
        seen_s = ((self.account.last or 0) - since_tick) * TICK_S + _UNSEEN_S
        return max(host_s, min(host_s * self.speed, seen_s))

    def ask(self, command: Command, now_s: float, timeout_s: float) -> Request:
        """Start a command; `outgoing` sends it and repeats it until the answer comes.

        Only one command may be in progress: the caller waits for the previous one.

        Parameters
        ----------
        command : Command
            Any message with a reply; its request number is replaced.
        now_s : float
            Host time [s].
        timeout_s : float
            Time after which the command is given up [s].

        Returns
        -------
        Request
            Done when the command was answered or given up.
        """
        # A protocol's dataclasses are not known to be such.
        numbered = dataclasses.replace(command, request=self._number())  # type: ignore[type-var]
        self._request = Request(numbered, now_s + timeout_s, now_s)
        return self._request

    @property
    def preempted(self) -> bool:
        """Whether a command of `preempt` still waits for its answer."""
        request = self._request
        return request is not None and request.urgent and not request.done

    def preempt(self, command: Command, now_s: float, timeout_s: float) -> Request:
        """Start a command ahead of all others, used for the stop.

        A command in progress is given up with an error. While `preempted` is true the caller must not start
        another command.

        Parameters
        ----------
        command : Command
            Any message with a reply; its request number is replaced.
        now_s : float
            Host time [s].
        timeout_s : float
            Time after which the command is given up [s].

        Returns
        -------
        Request
            Done when the command was answered or given up.
        """
        if self._request is not None and not self._request.done:
            name = self._request.command.ID.name.lower()
            self._request.error = LinkError(f"a stop came before the board answered {name}", "begin again")
        self.stops += 1
        request = self.ask(command, now_s, timeout_s)
        request.urgent = True
        return request

    def stream(self, message: SetpointMessage | VoltagesMessage | FollowingMessage) -> None:
        """Set the next streamed value; `outgoing` sends it as soon as the rate limit permits.

        Parameters
        ----------
        message : SetpointMessage, VoltagesMessage or FollowingMessage
            It replaces a waiting value of the same kind.
        """
        if isinstance(message, SetpointMessage):
            self._setpoints.put(message)
        elif isinstance(message, VoltagesMessage):
            self._voltages.put(message)
        else:
            self._following.put(message)

    def cut(self, now_s: float, wall_ns: int, reason: str) -> LinkEvent:
        """Record that the connection is lost; the handshake starts again after a reconnect.

        Parameters
        ----------
        now_s : float
            Host time [s].
        wall_ns : int
            Unix time [ns].
        reason : str
            Cause, for the event's text.
        """
        self.parser.restart()
        self._greet(now_s)
        return self._event(LINK_LOST, reason, wall_ns)

    def _take(self, frame: Frame, now_s: float, wall_ns: int, received: Received) -> None:
        try:
            match frame.id:
                case MessageId.WELCOME:
                    self._take_welcome(WelcomeMessage.unpack(frame.payload), now_s, wall_ns, received)
                case MessageId.PONG:
                    pong = PongMessage.unpack(frame.payload)
                    sent_s = pong.host_us * 1e-6
                    self._round_trip_s = max(0.8 * self._round_trip_s, now_s - sent_s)
                    if self.phase is Phase.OPEN:
                        self.clock.observe_pong(sent_s, self.account.unwrap(pong.tick), now_s)
                case MessageId.STATUS:
                    self._board = StatusMessage.unpack(frame.payload)
                    received.statuses.append(self._board)
                case MessageId.EVENT:
                    self._take_event(EventMessage.unpack(frame.payload), now_s, wall_ns, received)
                case MessageId.PARAMS:
                    # Too short a reply must not reach who asked.
                    ParamsMessage.unpack(frame.payload)
                case MessageId.ACK:
                    if AckMessage.unpack(frame.payload).result == Result.NO_HANDSHAKE:
                        self._greet(now_s)
                        return
            if self._request is not None:
                self._request.match(frame)
        except struct.error:
            self._malformed += 1

    def _take_welcome(self, welcome: WelcomeMessage, now_s: float, wall_ns: int, received: Received) -> None:
        if self.phase is Phase.OPEN or welcome.request != self._hello_request:
            return
        if welcome.result != Result.OK or welcome.link_hash != LINK_HASH:
            self.mismatch = LinkVersionMismatch(
                LINK_VERSION,
                LINK_HASH,
                f"{welcome.link_major}.{welcome.link_minor}",
                welcome.link_hash,
                f"{welcome.firmware_major}.{welcome.firmware_minor}.{welcome.firmware_patch}",
            )
            return
        before = self.welcome
        self.phase, self.welcome, self.unreachable_since_s = Phase.OPEN, welcome, None
        self._last_sent_s = self._last_ping_s = now_s - HEARTBEAT_S
        if before is None:
            self._held.clear()
            self._baseline = self._parser_counts()
            return
        self._reconnects += 1
        # Each holds where the other may not: the id of another start may be the same by chance, once in 2^24,
        # and a start may be older than the outage.
        behind = self.account.last is not None and self.account.unwrap(welcome.tick) < self.account.last
        if welcome.boot_id == before.boot_id and not behind:
            received.events.append(self._event(LINK_RESTORED, "the link is back", wall_ns))
            if self._request is not None:
                self._request.next_try_s = now_s
            return
        self._held.clear()
        self.account.restart()
        self._missed.restart()
        self.clock.reset()
        self.latest_raw = None
        self.kept = None
        self.restarts += 1
        reason = Reset(welcome.reset).name.lower() if welcome.reset in Reset._value2member_map_ else "unknown"
        fault = f"; {fault_text(welcome.boot_fault)}" if welcome.boot_fault else ""
        text = f"the board restarted ({reason}){fault}"
        received.events.append(self._event(BOARD_RESTARTED, text, wall_ns))
        if self._request is not None and not self._request.done:
            self._request.error = LinkLost(f"{text} before it answered", "check its supply, then arm again")

    def _take_event(self, message: EventMessage, now_s: float, wall_ns: int, received: Received) -> None:
        event = LinkEvent(message.tick, wall_ns, event_kind(message), event_text(message), message)
        received.events.append(event)
        self._missed.take_event(message)
        known = self.welcome is not None and message.value == self.welcome.boot_id
        if message.kind == Event.BOOT and not known:
            self._greet(now_s)

    def _take_telemetry(self, now_s: float, wall_ns: int, received: Received) -> None:
        ticks = self._decoder.decode(self._held)
        self._held.clear()
        if self.latest_raw is None or (ticks.raw[:, MODES] != self.latest_raw[MODES]).any():
            ticks = self._declared(ticks)
        accepted, jumped_back = self.account.take(ticks)
        if len(accepted):
            self.latest_raw = accepted.raw[-1]
            self.clock.observe(self.account.last or 0, now_s)
            received.ticks = accepted
            for message in self._missed.take_ticks(accepted):
                self._insert_missed(message, wall_ns, received.events)
        if jumped_back:
            self._greet(now_s)

    def _declared(self, ticks: Ticks) -> Ticks:
        """Leave out what was garbled before its CRC was made: nobody could say what it means. Each run of
        such samples counts as one malformed frame.
        """
        sound = declared(ticks.raw)
        if sound.all():
            return ticks
        self._malformed += int(np.count_nonzero(np.diff(sound.view(np.int8), prepend=np.int8(1)) < 0))
        return Ticks(ticks.tick[sound], ticks.raw[sound])

    def _insert_missed(self, message: EventMessage, wall_ns: int, events: list[LinkEvent]) -> None:
        """Insert a reconstructed event before the events that happened later."""
        text = f"{event_text(message)}; from telemetry, its event was lost"
        later = (
            index
            for index, other in enumerate(events)
            if other.message is not None and 0 < (other.tick - message.tick) & _TICK_MASK < _TICK_MASK // 2
        )
        events.insert(
            next(later, len(events)), LinkEvent(message.tick, wall_ns, event_kind(message), text, message)
        )

    def _greet(self, now_s: float) -> None:
        if self.phase is Phase.OPEN or self.unreachable_since_s is None:
            self.unreachable_since_s = now_s
        self.phase = Phase.GREETING
        self._next_hello_s = now_s
        self._hello_request = self._number()
        self.parser.restart_sequence()

    def _event(self, kind: str, text: str, wall_ns: int) -> LinkEvent:
        return LinkEvent((self.account.last or 0) & _TICK_MASK, wall_ns, kind, text)

    def _frame(
        self, message: Command | SetpointMessage | VoltagesMessage | FollowingMessage, now_s: float
    ) -> bytes:
        self._last_sent_s = now_s
        self._seq = (self._seq + 1) & 0xFF
        return encode_frame(message.ID, self._seq, message.pack())

    def _number(self) -> int:
        # 0 is the number of what the board sends unasked.
        self._request_number = self._request_number % 255 + 1
        return self._request_number

    def _parser_counts(self) -> tuple[int, int, int, int, int]:
        parser = self.parser
        return (
            parser.frames_ok,
            parser.frames_bad,
            parser.frames_lost,
            parser.bytes_received,
            parser.bytes_dropped,
        )
