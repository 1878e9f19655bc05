"""The protocol of a session, without input and output: it consumes received bytes and returns frames to send.

It uses no thread, no clock and no port: `heli_host.link.driver.Driver` passes received bytes and the time,
and sends the bytes that `Engine.outgoing` returns. Therefore a session over a port, with a thread, and one in
lockstep with a simulation run the same protocol.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

from heli_host.declaration import (
    AckMessage,
    Event,
    EventMessage,
    MessageId,
    ParamsMessage,
    PingMessage,
    PongMessage,
    Reset,
    Result,
    State,
    StatusMessage,
    StopMessage,
    WelcomeMessage,
)
from heli_host.errors import LinkLost, fault_text
from heli_host.link.accounting import LinkCounters
from heli_host.link.command_slot import CommandSlot
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
from heli_host.link.handshake import Handshake, Welcome
from heli_host.link.missed_events import insert_missed
from heli_host.link.requests import Command, RequestNumbers
from heli_host.link.streams import DeviceTime, StreamedMessage, StreamedValues
from heli_host.link.telemetry import EMPTY_TICKS, Ticks
from heli_host.link.telemetry_receiver import TelemetryReceiver

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


class Engine:
    """The state of one session. It has no lock and no thread: callers serialise all calls.

    It owns the frames in both directions and passes the content of each frame to one of its four parts. A
    stop goes through `commands`: `CommandSlot.preempt` starts it, and the next `outgoing` returns its frame.
    """

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
        self._baseline = (0, 0, 0, 0, 0)

    def counters(self) -> LinkCounters:
        """Return all counts since the first welcome."""
        frames_ok, frames_bad, frames_lost, received, dropped = (
            present - first for present, first in zip(self._parser_counts(), self._baseline, strict=True)
        )
        streams, account = self.streams, self.telemetry.account
        return LinkCounters(
            frames_ok=frames_ok,
            frames_bad=frames_bad + self._malformed + self.telemetry.malformed,
            frames_lost=frames_lost,
            bytes_received=received,
            bytes_dropped=dropped,
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
        """Return the frames that are due: a command first, then streamed values, then a sign of life."""
        self.commands.expire(now_s)
        if not self.handshake.is_open:
            hello = self.handshake.due_hello(now_s)
            return b"" if hello is None else self._encode_next_frame(hello, now_s)
        command_waits = self.commands.waits
        command = self.commands.due(now_s)
        frames_out = b"" if command is None else self._encode_next_frame(command, now_s)
        now = DeviceTime(now_s, self.telemetry.account.last or 0, self.telemetry.speed)
        is_flying = self.telemetry.state in (State.CLOSED_LOOP, State.HOLD)
        for value in self.streams.due(now, flies=is_flying):
            frames_out += self._encode_next_frame(value, now_s)
        if self._last_sent_s == now_s:
            self._sent_tick = now.tick
        idle_s = now.since(self._last_sent_s, self._sent_tick)
        unpinged_s = now.since(self._last_ping_s, self._ping_tick)
        if not command_waits and (idle_s >= HEARTBEAT_S or unpinged_s >= CLOCK_PING_S):
            self._last_ping_s = now_s
            self._sent_tick = self._ping_tick = now.tick
            frames_out += self._encode_next_frame(
                PingMessage(self._numbers.take(), round(now_s * 1e6)), now_s
            )
        return frames_out

    def frame_past_lock(self, command: type[StopMessage]) -> bytes:
        """Return the frame of a command that any thread may send without the callers' lock. Nothing changes.

        The leading delimiter ends a frame that another thread has sent only in part.
        """
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
            self._baseline = self._parser_counts()
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

    def _parser_counts(self) -> tuple[int, int, int, int, int]:
        """Return the counters of frames and bytes, from which those of the session are differences."""
        parser = self.parser
        return (
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
