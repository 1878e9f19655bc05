"""A session with one board: handshake, commands, streams, samples, events, reconnect.

Two drivers share one protocol (`heli_host.link.engine`). Over a port a thread reads all the time, and calls
of the user wait for it. In lockstep with a simulation there is no thread: whatever waits reads, which makes
time pass, and the same calls give the same bytes every time.
"""

from __future__ import annotations

import contextlib
import secrets
import struct
import threading
from collections import deque
from collections.abc import Callable
from types import TracebackType
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from heli_host.errors import (
    CommandRefused,
    HandshakeTimeout,
    HeliError,
    LinkError,
    LinkLost,
    WaitTimeout,
    WrongDevice,
)
from heli_host.link.accounting import LinkCounters
from heli_host.link.clock import TICK_S, ClockEstimate
from heli_host.link.declaration import (
    PARAMS,
    AckMessage,
    MessageId,
    ParamsMessage,
    ParamsReadMessage,
    Result,
    SetpointMessage,
    State,
    StatusMessage,
    StatusReadMessage,
    VoltagesMessage,
    WelcomeMessage,
)
from heli_host.link.engine import Command, Engine, Phase, Received, Request
from heli_host.link.events import CALLBACK_FAILED, LinkEvent
from heli_host.link.frames import Frame
from heli_host.link.telemetry import Ticks
from heli_host.link.transport import READ_INTERVAL_S, Transport, set_read_interval

COMMAND_TIMEOUT_S = 2.0
HANDSHAKE_TIMEOUT_S = 5.0
RECONNECT_TIMEOUT_S = 30.0

_READ_TIMEOUT_S = 0.02
# Reading in long pieces is what makes a simulation fast: a batch costs 35 us alone, 3 us among many.
_LOCKSTEP_STEP_S = 0.1
_LOCKSTEP_REPLY_STEP_S = 0.002
_BACKOFF_S = (0.05, 0.1, 0.2, 0.5, 1.0)
_AHEAD_TICKS = 250
_EVENTS_KEPT = 1000
_MOST_ATTEMPTS = 2000

_T = TypeVar("_T")

TicksCallback = Callable[[Ticks], None]
EventCallback = Callable[[LinkEvent], None]
StatusCallback = Callable[[StatusMessage], None]
Unsubscribe = Callable[[], None]


class Session:
    """One session with one board.

    Parameters
    ----------
    transport : Transport
        The board's bytes, open; the session closes it, and opens it again when it is lost.
    session_number : int or None
        Tells this session from others. None: random over a port, 1 in lockstep.
    handshake_timeout_s : float
        Longest wait for the welcome [s]. A Due that resets when its port is opened takes up to 3 s.
    reconnect_timeout_s : float
        How long a lost board is looked for [s]; 0 gives up at once.
    """

    def __init__(
        self,
        transport: Transport,
        *,
        session_number: int | None = None,
        handshake_timeout_s: float = HANDSHAKE_TIMEOUT_S,
        reconnect_timeout_s: float = RECONNECT_TIMEOUT_S,
    ) -> None:
        if session_number is None:
            session_number = 1 if transport.lockstep else secrets.randbits(32)
        self.handshake_timeout_s = handshake_timeout_s
        self.reconnect_timeout_s = reconnect_timeout_s
        self._transport = transport
        self._engine = Engine(session_number)
        self._condition = threading.Condition(threading.RLock())
        self._one_command = threading.RLock()
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()
        self._fatal: HeliError | None = None
        self._callback_error: HeliError | None = None
        self._handshake_deadline_s = 0.0
        self._read_interval_s = READ_INTERVAL_S
        self._events: deque[LinkEvent] = deque(maxlen=_EVENTS_KEPT)
        self._on_ticks: tuple[TicksCallback, ...] = ()
        self._on_event: tuple[EventCallback, ...] = ()
        self._on_status: tuple[StatusCallback, ...] = ()

    def __enter__(self) -> Session:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def transport(self) -> Transport:
        """The board's bytes; another one after a reconnect."""
        return self._transport

    @property
    def lockstep(self) -> bool:
        """Whether time passes only while something waits."""
        return self._transport.lockstep

    @property
    def welcome(self) -> WelcomeMessage:
        """What the board said of itself when it last welcomed this session."""
        if self._engine.welcome is None:
            raise LinkError("the session is not open yet", "call connect() first")
        return self._engine.welcome

    @property
    def connected(self) -> bool:
        """Whether the board answers at present."""
        return self._engine.phase is Phase.OPEN and self._fatal is None

    @property
    def counters(self) -> LinkCounters:
        """All counts since the first welcome."""
        with self._condition:
            return self._engine.counters()

    @property
    def clock(self) -> ClockEstimate | None:
        """Device time to host time; None before the first sample."""
        with self._condition:
            return self._engine.clock.estimate()

    @property
    def events(self) -> tuple[LinkEvent, ...]:
        """The last thousand events of board and link, oldest first."""
        with self._condition:
            return tuple(self._events)

    @property
    def latest(self) -> tuple[int, npt.NDArray[np.int32]] | None:
        """Newest tick, counted on over 2^32, and its sample (11,) in raw units; None before the first."""
        with self._condition:
            tick, raw = self._engine.account.last, self._engine.latest_raw
            return None if tick is None or raw is None else (tick, raw)

    @property
    def state(self) -> State | None:
        """Supervisor state in the newest sample; None before the first."""
        return self._engine.state

    @property
    def read_interval_s(self) -> float:
        """How long a port collects bytes between two readings [s]; less costs processor time."""
        return self._read_interval_s

    @read_interval_s.setter
    def read_interval_s(self, interval_s: float) -> None:
        self._read_interval_s = interval_s

    def connect(self) -> WelcomeMessage:
        """Greet the board until it answers, then keep the link alive until `close`.

        Returns
        -------
        WelcomeMessage
            What the board says of itself.

        Raises
        ------
        HandshakeTimeout
            Nothing was heard, or hello was not answered, in time.
        WrongDevice
            Bytes came, but no frame of this link.
        LinkVersionMismatch
            The board was built from another declaration.
        LinkLost
            The port went away and did not come back in time.
        """
        self._handshake_deadline_s = self._transport.now_s() + self.handshake_timeout_s
        while self._engine.phase is Phase.GREETING:
            self._check()
            if self._transport.now_s() >= self._handshake_deadline_s:
                raise self._handshake_error()
            self._pump(_READ_TIMEOUT_S)
        if not self.lockstep:
            self._thread = threading.Thread(target=self._run, name="heli-host link", daemon=True)
            self._thread.start()
        return self.welcome

    def close(self) -> None:
        """End the session and let go of the port; motors are the business of the caller."""
        self._stop.set()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join()
        self._transport.close()
        if self._fatal is None:
            self._fail(LinkError("the session is closed", "connect again"))

    def request(self, command: Command, timeout_s: float = COMMAND_TIMEOUT_S) -> Frame:
        """Send a command and wait for its answer; it takes effect exactly once, however often it is sent.

        Parameters
        ----------
        command : Command
            Any message of the declaration that has a reply; its request number is chosen here.
        timeout_s : float
            Longest wait for the answer, retries included [s].

        Returns
        -------
        Frame
            The answer, as it came.

        Raises
        ------
        CommandRefused
            The board said no.
        CommandTimeout
            No answer came in time.
        LinkLost
            The board is gone, or started anew before it answered.
        """
        # A callback runs in the reading thread: to wait there for another's command would be for ever.
        if not self._one_command.acquire(blocking=threading.current_thread() is not self._thread):
            raise LinkError("a callback cannot send a command while another is on its way", "send it later")
        try:
            self._check()
            with self._condition:
                pending = self._engine.ask(command, self._transport.now_s(), timeout_s)
                self._send_due()
            self.wait_for(lambda: pending.done, step_s=_LOCKSTEP_REPLY_STEP_S)
        finally:
            self._one_command.release()
        return _answer(pending)

    def command(self, command: Command, timeout_s: float = COMMAND_TIMEOUT_S) -> AckMessage:
        """Send a command that is answered by an ack; see `request`.

        Parameters
        ----------
        command : Command
            The command.
        timeout_s : float
            Longest wait for the answer, retries included [s].

        Returns
        -------
        AckMessage
            The answer; its result is ok.

        Raises
        ------
        CommandRefused
            The board said no.
        CommandTimeout
            No answer came in time.
        LinkLost
            The board is gone.
        """
        return AckMessage.unpack(self.request(command, timeout_s).payload)

    def read_params(self) -> tuple[float, ...]:
        """Read all parameters.

        Returns
        -------
        tuple of float
            In the order of the declaration's ``PARAMS``.

        Raises
        ------
        LinkError
            As `request`.
        """
        values: list[float] = []
        while len(values) < len(PARAMS):
            payload = self.request(ParamsReadMessage(0, len(values))).payload
            head = ParamsMessage.unpack(payload)
            size = ParamsMessage.STRUCT.size
            if head.first != len(values) or head.count == 0 or len(payload) != size + 4 * head.count:
                raise LinkError(
                    "the board's list of parameters is garbled", "flash the firmware of this release"
                )
            values += struct.unpack_from(f"<{head.count}f", payload, size)
        return tuple(values[: len(PARAMS)])

    def status(self) -> StatusMessage:
        """Ask for the board's counters.

        Returns
        -------
        StatusMessage
            As of now.

        Raises
        ------
        LinkError
            As `request`.
        """
        return StatusMessage.unpack(self.request(StatusReadMessage(0)).payload)

    def stream(self, message: SetpointMessage | VoltagesMessage) -> None:
        """Send a setpoint or a pair of voltages; not answered, the latest wins.

        At most 200 setpoints and 500 pairs of voltages a second go out; what a later one replaced meanwhile
        is counted as skipped.

        Parameters
        ----------
        message : SetpointMessage or VoltagesMessage
            The value.

        Raises
        ------
        LinkError
            The session is over.
        """
        self._check()
        with self._condition:
            self._engine.stream(message)
            self._send_due()

    def keep_alive(self, setpoint: SetpointMessage | None) -> None:
        """Send a setpoint again ten times a second while the board flies on setpoints.

        Parameters
        ----------
        setpoint : SetpointMessage or None
            What to send; None ends it, and the board's failsafe is then the caller's business again.
        """
        with self._condition:
            self._engine.kept = setpoint

    def device_tick(self) -> int:
        """Estimate the device's time now.

        Returns
        -------
        int
            Tick, counted on over 2^32; at most 250 ahead of the newest sample, whatever the clock fit says.

        Raises
        ------
        LinkError
            No sample has come yet.
        """
        with self._condition:
            last, estimate = self._engine.account.last, self._engine.clock.estimate()
            if last is None or estimate is None:
                raise LinkError("no sample has come from the board yet", "wait a moment, then try again")
            tick = round(estimate.tick_at(self._transport.now_s()))
            return min(max(tick, last), last + _AHEAD_TICKS)

    def ticks_counted_on(self, ticks: Ticks) -> npt.NDArray[np.int64]:
        """Return the tick numbers of samples counted on over 2^32.

        Parameters
        ----------
        ticks : Ticks
            Samples just handed over.

        Returns
        -------
        ndarray of int64, shape (n,)
            Device time [tick].
        """
        last = self._engine.account.unwrap(int(ticks.tick[-1]))
        behind = (ticks.tick[-1] - ticks.tick).astype(np.int64)
        return np.asarray(last - behind, np.int64)

    def wait_for(
        self, predicate: Callable[[], bool], timeout_s: float | None = None, step_s: float = 0.02
    ) -> bool:
        """Wait until something is so; samples, events and replies are taken in meanwhile.

        Parameters
        ----------
        predicate : callable returning bool
            Asked after every reading.
        timeout_s : float or None
            Longest wait in the transport's time [s]; None waits as long as the link lives.
        step_s : float
            In lockstep: simulated time between two askings [s].

        Returns
        -------
        bool
            False when time ran out.

        Raises
        ------
        LinkLost
            The board is gone for good.
        HeliError
            A callback failed.
        """
        now_s = self._transport.now_s()
        end_s = float("inf") if timeout_s is None else now_s + timeout_s
        inline = self.lockstep or self._thread is None or threading.current_thread() is self._thread
        with contextlib.nullcontext() if inline else self._condition:
            while not predicate():
                self._check()
                left_s = end_s - self._transport.now_s()
                if left_s <= 0.0:
                    return False
                if inline:
                    self._pump(min(step_s, left_s))
                else:
                    self._condition.wait(min(left_s, 0.1))
        self._check()
        return True

    def wait(self, duration_s: float) -> None:
        """Wait in device time: until samples of this much later have come.

        Parameters
        ----------
        duration_s : float
            Device time [s].

        Raises
        ------
        LinkLost
            The board is gone for good, or started anew.
        HeliError
            A callback failed.
        """
        account, engine = self._engine.account, self._engine
        if account.last is None and not self.wait_for(lambda: account.last is not None, 5.0):
            raise WaitTimeout("the board sends no samples", "check telemetry with heli-host doctor")
        restarts, goal = engine.restarts, (account.last or 0) + round(duration_s / TICK_S)

        def passed() -> bool:
            return engine.restarts != restarts or (account.last is not None and account.last >= goal)

        if self.lockstep:
            while not passed():
                left_s = (goal - (account.last or 0)) * TICK_S
                self.wait_for(passed, 0.0)
                self._pump(min(max(left_s, TICK_S), _LOCKSTEP_STEP_S))
        self.wait_for(passed)
        if engine.restarts != restarts:
            raise LinkLost(
                "the board started anew while its time was waited for", "check its supply, then arm again"
            )

    def subscribe_ticks(self, callback: TicksCallback) -> Unsubscribe:
        """Have every new sample handed over, in the reading thread.

        Parameters
        ----------
        callback : callable taking Ticks
            Called with the samples of one reading. When it raises, it is called no more, and the next call of
            the user raises in its place.

        Returns
        -------
        callable
            Ends the subscription.
        """
        self._on_ticks = (*self._on_ticks, callback)
        return lambda: self._unsubscribe(callback)

    def subscribe_events(self, callback: EventCallback) -> Unsubscribe:
        """Have every event of board and link handed over, in the reading thread.

        Parameters
        ----------
        callback : callable taking LinkEvent
            See `subscribe_ticks`.

        Returns
        -------
        callable
            Ends the subscription.
        """
        self._on_event = (*self._on_event, callback)
        return lambda: self._unsubscribe(callback)

    def subscribe_status(self, callback: StatusCallback) -> Unsubscribe:
        """Have the board's counters handed over, once a second, in the reading thread.

        Parameters
        ----------
        callback : callable taking StatusMessage
            See `subscribe_ticks`.

        Returns
        -------
        callable
            Ends the subscription.
        """
        self._on_status = (*self._on_status, callback)
        return lambda: self._unsubscribe(callback)

    def _unsubscribe(self, callback: object) -> None:
        self._on_ticks = tuple(one for one in self._on_ticks if one is not callback)
        self._on_event = tuple(one for one in self._on_event if one is not callback)
        self._on_status = tuple(one for one in self._on_status if one is not callback)

    def _run(self) -> None:
        while not self._stop.is_set() and self._fatal is None:
            self._pump(_READ_TIMEOUT_S)

    def _pump(self, timeout_s: float) -> None:
        """Read once, take in what came, send what is due, and hand everything over."""
        transport, engine = self._transport, self._engine
        speed = engine.speed
        interval_s = timeout_s if transport.lockstep else self._read_interval_s / speed
        set_read_interval(transport, interval_s)
        lost: LinkLost | None = None
        received = Received()
        try:
            data = transport.read(timeout_s if transport.lockstep else timeout_s / speed)
            with self._condition:
                received = engine.receive(data, transport.now_s(), transport.wall_ns())
                if due := engine.outgoing(transport.now_s()):
                    transport.write(due)
        except LinkLost as error:
            lost = error
        self._deliver(received)
        if lost is not None:
            self._reopen(lost)
        if engine.mismatch is not None:
            self._fail(engine.mismatch)
        elif engine.unreachable and transport.now_s() >= self._give_up_s():
            self._fail(LinkLost("the board does not answer any more", "check its supply, then connect again"))

    def _send_due(self) -> None:
        # Whoever reads finds out by itself that the port is gone, and looks for it.
        with contextlib.suppress(LinkLost):
            if due := self._engine.outgoing(self._transport.now_s()):
                self._transport.write(due)

    def _give_up_s(self) -> float:
        since_s = self._engine.unreachable_since_s
        if self._engine.welcome is None or since_s is None:
            return self._handshake_deadline_s
        return since_s + self.reconnect_timeout_s

    def _reopen(self, error: LinkLost) -> None:
        transport = self._transport
        with self._condition:
            event = self._engine.cut(transport.now_s(), transport.wall_ns(), error.cause)
        self._deliver(Received(events=[event]))
        transport.close()
        for attempt in range(_MOST_ATTEMPTS):
            if self._stop.is_set() or transport.now_s() >= self._give_up_s():
                break
            try:
                reopened = transport.reopen()
            except LinkError:
                if not transport.lockstep:
                    self._stop.wait(_BACKOFF_S[min(attempt, len(_BACKOFF_S) - 1)])
                continue
            with self._condition:
                self._transport = reopened
            return
        if not self._stop.is_set():
            self._fail(
                LinkLost(f"{error.cause} and did not come back", "check cable and power, then connect again")
            )

    def _deliver(self, received: Received) -> None:
        if len(received.ticks):
            self._hand_over(self._on_ticks, received.ticks)
        for event in received.events:
            self._events.append(event)
            self._hand_over(self._on_event, event)
        for status in received.statuses:
            self._hand_over(self._on_status, status)
        with self._condition:
            self._condition.notify_all()

    def _hand_over(self, callbacks: tuple[Callable[[_T], None], ...], value: _T) -> None:
        for callback in callbacks:
            try:
                callback(value)
            except Exception as error:  # noqa: BLE001
                self._unsubscribe(callback)
                failed = error if isinstance(error, HeliError) else None
                if failed is None:
                    failed = HeliError(
                        f"a callback failed: {type(error).__name__}: {error}", "mend it; it is called no more"
                    )
                    failed.__cause__ = error
                self._callback_error = self._callback_error or failed
                tick = (self._engine.account.last or 0) & 0xFFFFFFFF
                self._events.append(LinkEvent(tick, self._transport.wall_ns(), CALLBACK_FAILED, str(failed)))

    def _check(self) -> None:
        if self._callback_error is not None:
            error, self._callback_error = self._callback_error, None
            raise error
        if self._fatal is not None:
            raise self._fatal

    def _fail(self, error: HeliError) -> None:
        with self._condition:
            self._fatal = error
            self._condition.notify_all()

    def _handshake_error(self) -> LinkError:
        parser, url = self._engine.parser, self._transport.url
        if parser.frames_ok:
            return HandshakeTimeout(
                f"frames come from {url}, but hello was not answered in {self.handshake_timeout_s:g} s",
                "press the board's reset button; if it stays, flash the firmware of this release",
            )
        if parser.bytes_received == 0:
            return HandshakeTimeout(
                f"nothing was heard from {url} in {self.handshake_timeout_s:g} s",
                "check power and cable, that it is the programming port, and that the firmware is flashed",
            )
        excerpt = (parser.excerpt + parser.pending)[-16:]
        heard = f"{parser.bytes_received} bytes (the last: {excerpt.hex(' ')})"
        return WrongDevice(
            f"{heard} came from {url}, but no frame of this link",
            "choose another port (heli-host ports lists them), or flash the firmware of this release",
            parser.bytes_received,
            excerpt,
        )


def _answer(pending: Request) -> Frame:
    if pending.reply is None:
        raise pending.error or LinkError("the command was given up", "try again")
    if pending.reply.id == MessageId.ACK:
        ack = AckMessage.unpack(pending.reply.payload)
        if ack.result != Result.OK:
            raise CommandRefused(ack.command, ack.result, ack.detail, ack.value)
    return pending.reply
