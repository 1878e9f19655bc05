"""A session with one board: handshake, commands, streams, samples, events, reconnect.

The protocol (`heli_host.link.engine`) runs in one of two ways. Over a port, a background thread reads all the
time and calls of the user wait for it. In lockstep with a simulation there is no thread: a waiting call reads
bytes itself, and only that makes simulated time pass. The same calls then give the same bytes every time.
"""

from __future__ import annotations

import contextlib
import math
import secrets
import struct
import threading
from collections import deque
from collections.abc import Callable
from types import TracebackType
from typing import NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from heli_host.declaration import (
    PARAMS,
    AckMessage,
    ArmMessage,
    ControlMessage,
    ExciteMessage,
    FollowingMessage,
    ParamsMessage,
    ParamsReadMessage,
    SetpointMessage,
    State,
    StatusMessage,
    StatusReadMessage,
    StopMessage,
    StreamMessage,
    VoltagesMessage,
    WelcomeMessage,
)
from heli_host.errors import HeliError, LinkError, LinkLost, WaitTimeout
from heli_host.link.clock import TICK_S, ClockEstimate, check_duration
from heli_host.link.engine import UNNUMBERED, Command, Engine, Received, Request
from heli_host.link.events import CALLBACK_FAILED, LinkEvent
from heli_host.link.frames import Frame, no_welcome
from heli_host.link.telemetry import EMPTY_TICKS, LinkCounters, Ticks
from heli_host.link.transport import READ_INTERVAL_S, Transport, set_read_interval

TicksCallback = Callable[[Ticks], None]
EventCallback = Callable[[LinkEvent], None]
StatusCallback = Callable[[StatusMessage], None]
Unsubscribe = Callable[[], None]

_EVENTS_KEPT = 1000

_T = TypeVar("_T")


class RawTick(NamedTuple):
    """The newest tick of a board, as it came over the link."""

    tick: int
    """Unwrapped beyond 2^32."""
    raw: npt.NDArray[np.int32]
    """Wire numbers, shape (channels,)."""


class Subscribers:
    """The callbacks of a session."""

    def __init__(self) -> None:
        self.on_ticks: tuple[TicksCallback, ...] = ()
        self.on_event: tuple[EventCallback, ...] = ()
        self.on_status: tuple[StatusCallback, ...] = ()
        self.events: deque[LinkEvent] = deque(maxlen=_EVENTS_KEPT)
        self.error: HeliError | None = None

    def remove(self, callback: object) -> None:
        """Cancel all subscriptions of `callback`."""
        self.on_ticks = tuple(each for each in self.on_ticks if each is not callback)
        self.on_event = tuple(each for each in self.on_event if each is not callback)
        self.on_status = tuple(each for each in self.on_status if each is not callback)

    def deliver(self, ticks: Ticks, events: list[LinkEvent], statuses: list[StatusMessage]) -> None:
        """Call the callbacks, in the caller's thread. One that raises is removed; the others still run."""
        if len(ticks):
            for on_ticks in self.on_ticks:
                self._call_safely(on_ticks, ticks)
        for event in events:
            self.events.append(event)
            for on_event in self.on_event:
                self._call_safely(on_event, event)
        for status in statuses:
            for on_status in self.on_status:
                self._call_safely(on_status, status)

    def take_error(self) -> HeliError | None:
        """Return and clear the error of the first callback that failed; None if there is none."""
        error, self.error = self.error, None
        return error

    def _call_safely(self, callback: Callable[[_T], None], value: _T) -> None:
        """Call a subscriber; one that raises is removed, and its error becomes an event of the link."""
        try:
            callback(value)
        # The link must survive any error of a user's function, because it keeps the arm in the air.
        except Exception as error:  # noqa: BLE001
            self.remove(callback)
            if isinstance(error, HeliError):
                failed = error
            else:
                failed = HeliError(
                    f"a callback failed: {type(error).__name__}: {error}", "fix it; it is not called again"
                )
                failed.__cause__ = error
            if self.error is None:
                self.error = failed
            newest = self.events[-1] if self.events else None
            tick, wall_ns = (newest.tick, newest.wall_ns) if newest is not None else (0, 0)
            self.events.append(LinkEvent(tick, wall_ns, CALLBACK_FAILED, str(failed)))


READ_TIMEOUT_S = 0.02

LOCK_PATIENCE_S = 0.005
"""Longest wait of a stop for the link's lock [s].

A thread keeps the lock while it decodes one reading, or while it writes frames. Shorter: stops are sent twice
for no reason. Longer: the stop comes later by as much."""

_BACKOFF_S = (0.05, 0.1, 0.2, 0.5, 1.0)
# In lockstep a board that does not come back may take no time to say so.
_MAX_ATTEMPTS = 2000


class Driver:
    """Reads and sends bytes, lets calls wait, and reconnects to a lost board."""

    def __init__(
        self, transport: Transport, engine: Engine, subscribers: Subscribers, reconnect_timeout_s: float
    ) -> None:
        self.transport = transport
        # Blocks use this lock instead of the condition: Condition.__enter__ is Python code, and a Ctrl-C
        # within it would leave the lock held for ever. RLock.__enter__ is C code, which Ctrl-C cannot
        # interrupt.
        self.lock = threading.RLock()
        self._changed = threading.Condition(self.lock)
        self.read_interval_s = READ_INTERVAL_S
        self.handshake_deadline_s = 0.0
        self.fatal_error: HeliError | None = None
        self._reconnect_timeout_s = reconnect_timeout_s
        self._engine = engine
        self._subscribers = subscribers
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()

    @property
    def in_reading_thread(self) -> bool:
        """Whether the call comes from the reading thread, that is from a callback."""
        return threading.current_thread() is self._thread

    def start(self) -> None:
        """Start the reading thread; in lockstep there is none."""
        if not self.transport.lockstep:
            self._thread = threading.Thread(
                target=self._read_until_closed, name="heli-host link", daemon=True
            )
            self._thread.start()

    def close(self) -> None:
        """End the reading thread and close the port. The motors are not touched."""
        self._stop.set()
        if self._thread is not None and not self.in_reading_thread:
            self._thread.join()
        self.transport.close()
        self._end_with_error(LinkError("the session is closed", "connect again"))

    def check(self) -> None:
        """Raise the error of a failed callback, or the reason why the session has ended, if there is any."""
        error = self._subscribers.take_error() or self.fatal_error
        if error is not None:
            raise error

    def send_due(self) -> None:
        """Send the frames that are due, from any thread. A lost port is detected by the next reading."""
        with self.lock, contextlib.suppress(LinkLost):
            if due := self._engine.outgoing(self.transport.now_s()):
                self.transport.write(due)

    def send_past_lock(self, command: type[StopMessage]) -> None:
        """Send a command without the lock if another thread keeps it; do nothing if the lock is free.

        Only for a stop: the frame may damage a frame that the other thread writes at the same moment. Both
        senders then repeat theirs, because neither gets an answer.
        """
        if self.lock.acquire(timeout=LOCK_PATIENCE_S):
            self.lock.release()
            return
        with contextlib.suppress(LinkLost):
            self.transport.write(self._engine.frame_past_lock(command))

    def wait_for(self, predicate: Callable[[], bool], timeout_s: float | None, step_s: float) -> bool:
        """Wait until a condition holds; see `heli_host.link.session.Session.wait_for`."""
        end_s = float("inf") if timeout_s is None else self.transport.now_s() + timeout_s
        inline = self._thread is None or self.in_reading_thread
        with contextlib.nullcontext() if inline else self.lock:
            while not predicate():
                self.check()
                left_s = end_s - self.transport.now_s()
                if left_s <= 0.0:
                    return False
                if inline:
                    self.pump(min(step_s, left_s))
                else:
                    self._changed.wait(min(left_s, 0.1))
        self.check()
        return True

    def pump(self, timeout_s: float) -> None:
        """Read once, process the bytes, send the frames that are due, and call the subscribers."""
        transport, engine = self.transport, self._engine
        # A simulated board may run faster than real time; in lockstep its time passes by the reads.
        speed = 1.0 if transport.lockstep else engine.telemetry.speed
        set_read_interval(transport, timeout_s if transport.lockstep else self.read_interval_s / speed)
        lost: LinkLost | None = None
        received = Received()
        try:
            data = transport.read(timeout_s / speed)
            with self.lock:
                received = engine.receive(data, transport.now_s(), transport.wall_ns())
                if due := engine.outgoing(transport.now_s()):
                    transport.write(due)
        except LinkLost as error:
            lost = error
        self._call_subscribers(received)
        if lost is not None:
            self._reopen_port(lost)
        if engine.handshake.mismatch is not None:
            self._end_with_error(engine.handshake.mismatch)
        elif engine.handshake.unreachable and self.transport.now_s() >= self._welcome_deadline_s():
            self._end_with_error(
                LinkLost("the board does not answer any more", "check its supply, then connect again")
            )

    def _read_until_closed(self) -> None:
        """Read and send until the end, in a thread of its own."""
        try:
            while not self._stop.is_set() and self.fatal_error is None:
                self.pump(READ_TIMEOUT_S)
        # A thread that dies in silence would leave its user waiting for ever.
        except Exception as error:  # noqa: BLE001
            self._end_with_error(
                LinkError(f"reading failed: {type(error).__name__}: {error}", "report it with the log")
            )

    def _call_subscribers(self, received: Received) -> None:
        self._subscribers.deliver(received.ticks, received.events, received.statuses)
        with self.lock:
            self._changed.notify_all()

    def _reopen_port(self, error: LinkLost) -> None:
        """Open a lost port again, with growing pauses; the session fails if it does not come back in time."""
        transport = self.transport
        with self.lock:
            event = self._engine.cut(transport.now_s(), transport.wall_ns(), error.cause)
        self._call_subscribers(Received(events=[event]))
        transport.close()
        for attempt in range(_MAX_ATTEMPTS):
            if self._stop.is_set() or transport.now_s() >= self._welcome_deadline_s():
                break
            try:
                reopened = transport.reopen()
            except LinkError:
                if not transport.lockstep:
                    self._stop.wait(_BACKOFF_S[min(attempt, len(_BACKOFF_S) - 1)])
                continue
            with self.lock:
                self.transport = reopened
            return
        self._end_with_error(
            LinkLost(f"{error.cause} and did not come back", "check cable and power, then connect again")
        )

    def _welcome_deadline_s(self) -> float:
        """Return the time at which waiting for a welcome ends."""
        handshake = self._engine.handshake
        since_s = handshake.unreachable_since_s
        if handshake.welcome is None or since_s is None:
            return self.handshake_deadline_s
        return since_s + self._reconnect_timeout_s

    def _end_with_error(self, error: HeliError) -> None:
        """End the session with an error, and wake all threads that wait."""
        with self.lock:
            if self.fatal_error is None:
                self.fatal_error = error
            self._changed.notify_all()


COMMAND_TIMEOUT_S = 2.0
HANDSHAKE_TIMEOUT_S = 5.0
RECONNECT_TIMEOUT_S = 30.0

# Reading in long pieces is what makes a simulation fast: a batch costs 35 us alone, 3 us among many.
_LOCKSTEP_STEP_S = 0.1
_LOCKSTEP_REPLY_STEP_S = 0.002
_FIRST_SAMPLE_TIMEOUT_S = 5.0
_STATE_TIMEOUT_S = 1.0
_AHEAD_TICKS = 250
_START_MOTORS = (ArmMessage, ControlMessage, ExciteMessage, StreamMessage)


class Session:
    """One session with one board."""

    # All methods may be called from any thread; commands run one at a time.
    # The session itself never switches motors off, except by `stop_now`: see `heli_host.Heli.close`.

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
        self._engine = Engine(session_number)
        self._subscribers = Subscribers()
        self._driver = Driver(transport, self._engine, self._subscribers, reconnect_timeout_s)
        self._one_command = threading.RLock()
        self._stop_latched = False

    def __enter__(self) -> Session:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def transport(self) -> Transport:
        """Connection to the board; a different object after a reconnect."""
        return self._driver.transport

    @property
    def lockstep(self) -> bool:
        """Whether device time passes only while a call of this session waits, as in a simulation."""
        return self._driver.transport.lockstep

    @property
    def welcome(self) -> WelcomeMessage:
        """Description that the board sent when it last welcomed this session."""
        if self._engine.handshake.welcome is None:
            raise LinkError("the session is not open yet", "call connect() first")
        return self._engine.handshake.welcome

    @property
    def connected(self) -> bool:
        """Whether the board answers at present."""
        return self._engine.handshake.is_open and self._driver.fatal_error is None

    def check(self) -> None:
        """Raise the error of a failed callback, or the reason why the session has ended, if there is any."""
        self._driver.check()

    @property
    def counters(self) -> LinkCounters:
        """Counters of frames, ticks, retries and reconnects since the first welcome."""
        with self._driver.lock:
            return self._engine.counters()

    @property
    def clock(self) -> ClockEstimate | None:
        """Estimated relation of device time to host time; None before the first sample."""
        with self._driver.lock:
            return self._engine.telemetry.clock.estimate()

    @property
    def events(self) -> tuple[LinkEvent, ...]:
        """The last thousand events of board and link, oldest first."""
        with self._driver.lock:
            return tuple(self._subscribers.events)

    @property
    def latest(self) -> RawTick | None:
        """Newest tick; None before the first."""
        with self._driver.lock:
            telemetry = self._engine.telemetry
            tick, raw = telemetry.account.last, telemetry.latest_raw
            return None if tick is None or raw is None else RawTick(tick, raw)

    @property
    def state(self) -> State | None:
        """Supervisor state in the newest sample; None before the first."""
        return self._engine.telemetry.state

    @property
    def read_interval_s(self) -> float:
        """Interval at which the port is read [s]; may be set. A shorter interval costs processor time."""
        return self._driver.read_interval_s

    @read_interval_s.setter
    def read_interval_s(self, interval_s: float) -> None:
        self._driver.read_interval_s = interval_s

    def connect(self) -> WelcomeMessage:
        """Greet the board until it answers, then keep the link alive until `close`."""
        driver = self._driver
        driver.handshake_deadline_s = driver.transport.now_s() + self.handshake_timeout_s
        while not self._engine.handshake.is_open:
            driver.check()
            # The clock is read before the port: the answer of a board that waits there counts, however long
            # the machine let this thread wait.
            is_late = driver.transport.now_s() >= driver.handshake_deadline_s
            driver.pump(READ_TIMEOUT_S)
            if is_late and not self._engine.handshake.is_open:
                raise no_welcome(self._engine.parser, driver.transport.url, self.handshake_timeout_s)
        driver.start()
        return self.welcome

    def close(self) -> None:
        """End the session and close the port. The motors are not switched off: the caller must send a stop
        first. A board that flies on setpoints misses them from now on, holds level and lands.
        """
        self._driver.close()

    def request(self, command: Command, timeout_s: float = COMMAND_TIMEOUT_S) -> Frame:
        """Send a command and wait for its answer. Retries included, the command takes effect exactly once."""
        # A callback runs in the reading thread. If it waited here, the answer to the other command would
        # never be read.
        if not self._one_command.acquire(blocking=not self._driver.in_reading_thread):
            raise LinkError(
                "a callback cannot send a command while another command waits for its answer",
                "send it after the callback has returned",
            )
        try:
            self._driver.check()
            new_request: Request | None = None
            # A stop goes ahead of other commands, maybe again between the wait and the lock.
            while new_request is None:
                self.wait_for(lambda: not self._engine.commands.preempted, step_s=_LOCKSTEP_REPLY_STEP_S)
                with self._driver.lock:
                    if self._stop_latched and isinstance(command, _START_MOTORS):
                        raise LinkError("a stop cancelled this command", "send the command again")
                    if not self._engine.commands.preempted:
                        new_request = self._engine.commands.ask(command, self.transport.now_s(), timeout_s)
            self._driver.send_due()
            sent_request = new_request
            self.wait_for(lambda: sent_request.done, step_s=_LOCKSTEP_REPLY_STEP_S)
        finally:
            self._one_command.release()
        return sent_request.answer()

    def command(self, command: Command, timeout_s: float = COMMAND_TIMEOUT_S) -> AckMessage:
        """Send a command that is answered by an ack; see `request`."""
        return AckMessage.unpack(self.request(command, timeout_s).payload)

    @property
    def stops(self) -> int:
        """Number of calls of `stop_now` so far: the stop epoch that `release_stop` compares."""
        return self._engine.commands.stops

    def stop_now(self) -> None:
        """Switch both motors off: send the stop immediately and return without waiting for the answer.

        May be called from any thread, also from a callback. If another thread keeps the link's lock for more
        than 5 ms, the first stop is sent without it. The stop is repeated until the board answers, for at
        most 2 s. A command that waits for its answer is cancelled, and setpoints are no longer repeated.
        Until `release_stop` the session refuses commands that can start the motors (arm, control, excite,
        stream), because another thread may be about to send one. An arm in the air falls.
        """
        self._driver.send_past_lock(StopMessage)
        with self._driver.lock:
            self._stop_latched = True
            self._engine.streams.kept = None
            self._engine.commands.preempt(StopMessage(UNNUMBERED), self.transport.now_s(), COMMAND_TIMEOUT_S)
        self._driver.send_due()
        # After the bytes are sent: a pending error of a callback must not delay the stop.
        self._driver.check()

    def release_stop(self, stops: int) -> bool:
        """Accept commands that can start the motors again after `stop_now`. The motors stay off."""
        with self._driver.lock:
            if self._engine.commands.stops != stops:
                return False
            self._stop_latched = False
            return True

    def permit_streams(self, permitted: Callable[[], bool]) -> None:
        """Register a condition for sending setpoints and voltages, including those that are kept alive.

        While the condition is false none is sent. A board that flies on setpoints then holds level after
        ``setpoint_hold_s`` and lands after ``setpoint_land_s``; its motors keep running meanwhile. Streamed
        voltages expire, and the board holds level as well.

        `permitted`: Called before each value that is due, from any thread, with the link's lock held: it must
        not block and must not call the session.
        """
        with self._driver.lock:
            self._engine.streams.permitted = permitted

    def read_params(self) -> tuple[float, ...]:
        """Read all parameters of the board."""
        values: list[float] = []
        while len(values) < len(PARAMS):
            payload = self.request(ParamsReadMessage(UNNUMBERED, len(values))).payload
            head = ParamsMessage.unpack(payload)
            size = ParamsMessage.STRUCT.size
            if head.first != len(values) or head.count == 0 or len(payload) != size + 4 * head.count:
                raise LinkError(
                    "the board's list of parameters is damaged", "flash the firmware of this release"
                )
            values += struct.unpack_from(f"<{head.count}f", payload, size)
        return tuple(values[: len(PARAMS)])

    def status(self) -> StatusMessage:
        """Read the board's present counters."""
        return StatusMessage.unpack(self.request(StatusReadMessage(UNNUMBERED)).payload)

    def stream(self, message: SetpointMessage | VoltagesMessage | FollowingMessage) -> None:
        """Send a setpoint, a pair of voltages, or the setpoints that a Python law follows; not answered.

        At most 200 setpoints and 500 pairs of voltages are sent per second. A value that a newer one replaces
        before it is sent counts as skipped.
        """
        self._driver.check()
        with self._driver.lock:
            self._engine.streams.put(message)
        self._driver.send_due()

    def keep_alive(self, setpoint: SetpointMessage | None) -> None:
        """Repeat a setpoint ten times per second while the board flies on setpoints.

        This defeats the board's failsafe as long as this process runs, unless `permit_streams` forbids it.
        """
        with self._driver.lock:
            self._engine.streams.kept = setpoint

    def device_tick(self) -> int:
        """Estimate the present device time."""
        with self._driver.lock:
            telemetry = self._engine.telemetry
            last, estimate = telemetry.account.last, telemetry.clock.estimate()
            if last is None or estimate is None:
                raise LinkError("no sample has come from the board yet", "wait a moment, then try again")
            tick = round(estimate.tick_at(self._driver.transport.now_s()))
            return min(max(tick, last), last + _AHEAD_TICKS)

    def ticks_counted_on(self, ticks: Ticks) -> npt.NDArray[np.int64]:
        """Return the tick numbers of samples, unwrapped beyond 2^32. Returns shape (n,)."""
        if len(ticks) == 0:
            return np.empty(0, np.int64)
        last = self._engine.telemetry.account.unwrap(int(ticks.tick[-1]))
        ticks_before_newest = (ticks.tick[-1] - ticks.tick).astype(np.int64)
        return np.asarray(last - ticks_before_newest, np.int64)

    def wait_for(
        self, predicate: Callable[[], bool], timeout_s: float | None = None, step_s: float = 0.02
    ) -> bool:
        """Wait until a condition holds; samples, events and replies are processed meanwhile."""
        return self._driver.wait_for(predicate, timeout_s, step_s)

    def wait_for_state(self, *states: State) -> None:
        """Wait for up to 1 s until telemetry shows one of these states, some batches after a command."""
        # A state that has already gone on, into a fault for example, is for the caller to see.
        self.wait_for(lambda: self.state in states, _STATE_TIMEOUT_S)

    def wait(self, duration_s: float) -> None:
        """Wait until a sample arrives that is `duration_s` of device time later than the newest one now.

        At least one tick passes: a loop that waits for a rest of less than a tick comes to its end.
        """
        check_duration(duration_s, "a wait")
        # The tolerance keeps 0.3 s at 300 ticks, although 0.3 / 0.001 is a little more.
        ticks = max(math.ceil(duration_s / TICK_S - 1e-6), 1)
        account, handshake = self._engine.telemetry.account, self._engine.handshake
        if account.last is None and not self.wait_for(
            lambda: account.last is not None, _FIRST_SAMPLE_TIMEOUT_S
        ):
            raise WaitTimeout("the board sends no samples", "reset it, then connect again")
        restarts_before, goal_tick = handshake.restarts, (account.last or 0) + ticks

        def has_restarted() -> bool:
            return handshake.restarts != restarts_before

        def has_ended() -> bool:
            return has_restarted() or (account.last is not None and account.last >= goal_tick)

        # In lockstep, reads that are too long would simulate beyond the goal.
        while self.lockstep and not has_ended():
            self._driver.check()
            remaining_s = (goal_tick - (account.last or 0)) * TICK_S
            self._driver.pump(min(max(remaining_s, TICK_S), _LOCKSTEP_STEP_S))
        self.wait_for(has_ended)
        if has_restarted():
            raise LinkLost("the board restarted while the host waited", "check its supply, then arm again")

    def subscribe_ticks(self, callback: TicksCallback) -> Unsubscribe:
        """Register a callback for new samples.

        `callback`: Called in the reading thread with all samples of one reading; in lockstep, in the thread
        that waits. It must not block, and must not send a command that waits for an answer. If it raises, its
        subscription ends, and the next call of this session by the user raises that error.
        """
        self._subscribers.on_ticks = (*self._subscribers.on_ticks, callback)
        return lambda: self._subscribers.remove(callback)

    def subscribe_events(self, callback: EventCallback) -> Unsubscribe:
        """Register a callback for events of board, link and host."""
        self._subscribers.on_event = (*self._subscribers.on_event, callback)
        return lambda: self._subscribers.remove(callback)

    def tell(self, kind: str, text: str, names: tuple[str, ...] = ()) -> None:
        """Publish an event of the host to all subscribers of events, in the caller's thread."""
        newest = self.latest
        tick = newest.tick if newest is not None else 0
        event = LinkEvent(tick, self.transport.wall_ns(), kind, text, names=names)
        self._subscribers.deliver(EMPTY_TICKS, [event], [])

    def subscribe_status(self, callback: StatusCallback) -> Unsubscribe:
        """Register a callback for the board's counters, which arrive once per second."""
        self._subscribers.on_status = (*self._subscribers.on_status, callback)
        return lambda: self._subscribers.remove(callback)
