"""A session with one board: handshake, commands, streams, samples, events, reconnect.

Two drivers share one protocol (`heli_host.link.engine`). Over a port a thread reads all the time, and calls
of the user wait for it. In lockstep with a simulation there is no thread: whatever waits reads, which makes
time pass, and the same calls give the same bytes every time.
"""

from __future__ import annotations

import secrets
import struct
import threading
from collections.abc import Callable
from types import TracebackType

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
from heli_host.errors import LinkError, LinkLost, WaitTimeout
from heli_host.link.accounting import LinkCounters
from heli_host.link.clock import TICK_S, ClockEstimate
from heli_host.link.driver import READ_TIMEOUT_S, Driver
from heli_host.link.engine import Engine, Phase
from heli_host.link.events import LinkEvent
from heli_host.link.frames import Frame
from heli_host.link.greeting import no_welcome
from heli_host.link.requests import Command, Request
from heli_host.link.subscribers import (
    EventCallback,
    StatusCallback,
    Subscribers,
    TicksCallback,
    Unsubscribe,
)
from heli_host.link.telemetry import EMPTY_TICKS, Ticks
from heli_host.link.transport import Transport

COMMAND_TIMEOUT_S = 2.0
HANDSHAKE_TIMEOUT_S = 5.0
RECONNECT_TIMEOUT_S = 30.0

# Reading in long pieces is what makes a simulation fast: a batch costs 35 us alone, 3 us among many.
_LOCKSTEP_STEP_S = 0.1
_LOCKSTEP_REPLY_STEP_S = 0.002
_FIRST_SAMPLE_TIMEOUT_S = 5.0
_AHEAD_TICKS = 250
_START_MOTORS = (ArmMessage, ControlMessage, ExciteMessage, StreamMessage)


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
        self._engine = Engine(session_number)
        self._subscribers = Subscribers()
        self._driver = Driver(transport, self._engine, self._subscribers, reconnect_timeout_s)
        self._one_command = threading.RLock()
        self._latched = False

    def __enter__(self) -> Session:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def transport(self) -> Transport:
        """The board's bytes; another one after a reconnect."""
        return self._driver.transport

    @property
    def lockstep(self) -> bool:
        """Whether time passes only while something waits."""
        return self._driver.transport.lockstep

    @property
    def welcome(self) -> WelcomeMessage:
        """What the board said of itself when it last welcomed this session."""
        if self._engine.welcome is None:
            raise LinkError("the session is not open yet", "call connect() first")
        return self._engine.welcome

    @property
    def connected(self) -> bool:
        """Whether the board answers at present."""
        return self._engine.phase is Phase.OPEN and self._driver.fatal is None

    @property
    def counters(self) -> LinkCounters:
        """All counts since the first welcome."""
        with self._driver.lock:
            return self._engine.counters()

    @property
    def clock(self) -> ClockEstimate | None:
        """Device time to host time; None before the first sample."""
        with self._driver.lock:
            return self._engine.clock.estimate()

    @property
    def events(self) -> tuple[LinkEvent, ...]:
        """The last thousand events of board and link, oldest first."""
        with self._driver.lock:
            return tuple(self._subscribers.events)

    @property
    def latest(self) -> tuple[int, npt.NDArray[np.int32]] | None:
        """Newest tick, counted on over 2^32, and its raw numbers (channels,); None before the first."""
        with self._driver.lock:
            tick, raw = self._engine.account.last, self._engine.latest_raw
            return None if tick is None or raw is None else (tick, raw)

    @property
    def state(self) -> State | None:
        """Supervisor state in the newest sample; None before the first."""
        return self._engine.state

    @property
    def read_interval_s(self) -> float:
        """How long a port collects bytes between two readings [s]; less costs processor time; may be set."""
        return self._driver.read_interval_s

    @read_interval_s.setter
    def read_interval_s(self, interval_s: float) -> None:
        self._driver.read_interval_s = interval_s

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
        driver = self._driver
        driver.handshake_deadline_s = driver.transport.now_s() + self.handshake_timeout_s
        while self._engine.phase is Phase.GREETING:
            driver.check()
            if driver.transport.now_s() >= driver.handshake_deadline_s:
                raise no_welcome(self._engine.parser, driver.transport.url, self.handshake_timeout_s)
            driver.pump(READ_TIMEOUT_S)
        driver.start()
        return self.welcome

    def close(self) -> None:
        """End the session and let go of the port; motors are the business of the caller."""
        self._driver.close()

    def request(self, command: Command, timeout_s: float = COMMAND_TIMEOUT_S) -> Frame:
        """Send a command and wait for its answer; it takes effect exactly once, however often it is sent.

        Parameters
        ----------
        command : Command
            Any message of the declaration that has a reply; its request number is chosen here.
        timeout_s : float
            Longest wait for the answer, retries included [s].

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
        if not self._one_command.acquire(blocking=not self._driver.in_reading_thread):
            raise LinkError(
                "a callback cannot send a command while another command waits for its answer",
                "send it after the callback has returned",
            )
        try:
            self._driver.check()
            pending: Request | None = None
            while pending is None:
                self.wait_for(lambda: not self._engine.preempted, step_s=_LOCKSTEP_REPLY_STEP_S)
                with self._driver.lock:
                    if self._latched and isinstance(command, _START_MOTORS):
                        raise LinkError("a stop cancelled this command", "send the command again")
                    if not self._engine.preempted:
                        pending = self._engine.ask(command, self.transport.now_s(), timeout_s)
            self._driver.send_due()
            asked = pending
            self.wait_for(lambda: asked.done, step_s=_LOCKSTEP_REPLY_STEP_S)
        finally:
            self._one_command.release()
        return asked.answer()

    def command(self, command: Command, timeout_s: float = COMMAND_TIMEOUT_S) -> AckMessage:
        """Send a command that is answered by an ack; see `request`.

        Parameters
        ----------
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

    @property
    def stops(self) -> int:
        """How often `stop_now` was called."""
        return self._engine.stops

    def stop_now(self) -> None:
        """Send stop at once, from any thread, and return without its answer; it is repeated until it has one.

        It waits for no other command: one on its way is given up, and what could start the motors
        is refused until `release_stop`: another thread may be about to send it.

        Raises
        ------
        LinkError
            The session is over.
        """
        with self._driver.lock:
            self._latched = True
            self._engine.kept = None
            self._engine.preempt(StopMessage(0), self.transport.now_s(), COMMAND_TIMEOUT_S)
        self._driver.send_due()
        # After the bytes are out: an error that waits to be told must not come before them.
        self._driver.check()

    def release_stop(self, stops: int) -> bool:
        """Take commands again after `stop_now`.

        Parameters
        ----------
        stops : int
            `stops` when the wish for more was heard.

        Returns
        -------
        bool
            False when another stop has come since: nothing is released.
        """
        with self._driver.lock:
            if self._engine.stops != stops:
                return False
            self._latched = False
            return True

    def permit_streams(self, permitted: Callable[[], bool]) -> None:
        """Have it asked before each setpoint and pair of voltages whether it may go, whoever streams it.

        To the board those that may not are missing: it holds, then lands.

        Parameters
        ----------
        permitted : callable returning bool
            Asked with the link's lock held, tens of times a second: it must not wait.
        """
        with self._driver.lock:
            self._engine.permitted = permitted

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
                    "the board's list of parameters is damaged", "flash the firmware of this release"
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

    def stream(self, message: SetpointMessage | VoltagesMessage | FollowingMessage) -> None:
        """Send a setpoint, a pair of voltages, or what a law follows; not answered, the latest wins.

        At most 200 setpoints and 500 pairs of voltages a second go out; what a later one replaced meanwhile
        is counted as skipped.

        Parameters
        ----------
        message : SetpointMessage, VoltagesMessage or FollowingMessage
            The value.

        Raises
        ------
        LinkError
            The session is over.
        """
        self._driver.check()
        with self._driver.lock:
            self._engine.stream(message)
        self._driver.send_due()

    def keep_alive(self, setpoint: SetpointMessage | None) -> None:
        """Send a setpoint again ten times a second while the board flies on setpoints.

        Parameters
        ----------
        setpoint : SetpointMessage or None
            What to send; None ends it, and the board's failsafe is then the caller's business again.
        """
        with self._driver.lock:
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
        with self._driver.lock:
            last, estimate = self._engine.account.last, self._engine.clock.estimate()
            if last is None or estimate is None:
                raise LinkError("no sample has come from the board yet", "wait a moment, then try again")
            tick = round(estimate.tick_at(self._driver.transport.now_s()))
            return min(max(tick, last), last + _AHEAD_TICKS)

    def ticks_counted_on(self, ticks: Ticks) -> npt.NDArray[np.int64]:
        """Return the tick numbers of samples counted on over 2^32.

        Returns
        -------
        ndarray of int64, shape (n,)
            Device time [tick].
        """
        if len(ticks) == 0:
            return np.empty(0, np.int64)
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
        return self._driver.wait_for(predicate, timeout_s, step_s)

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
        if account.last is None and not self.wait_for(
            lambda: account.last is not None, _FIRST_SAMPLE_TIMEOUT_S
        ):
            raise WaitTimeout("the board sends no samples", "reset it, then connect again")
        restarts, goal = engine.restarts, (account.last or 0) + round(duration_s / TICK_S)

        def passed() -> bool:
            return engine.restarts != restarts or (account.last is not None and account.last >= goal)

        while self.lockstep and not passed():
            self._driver.check()
            left_s = (goal - (account.last or 0)) * TICK_S
            self._driver.pump(min(max(left_s, TICK_S), _LOCKSTEP_STEP_S))
        self.wait_for(passed)
        if engine.restarts != restarts:
            raise LinkLost("the board restarted while the host waited", "check its supply, then arm again")

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
        self._subscribers.on_ticks = (*self._subscribers.on_ticks, callback)
        return lambda: self._subscribers.remove(callback)

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
        self._subscribers.on_event = (*self._subscribers.on_event, callback)
        return lambda: self._subscribers.remove(callback)

    def tell(self, kind: str, text: str, names: tuple[str, ...] = ()) -> None:
        """Have an event of the host's own handed over, in this thread, like those of board and link.

        Parameters
        ----------
        kind, text, names
            As in `heli_host.link.events.LinkEvent`.
        """
        newest = self.latest
        tick = newest[0] if newest is not None else 0
        event = LinkEvent(tick, self.transport.wall_ns(), kind, text, names=names)
        self._subscribers.deliver(EMPTY_TICKS, [event], [])

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
        self._subscribers.on_status = (*self._subscribers.on_status, callback)
        return lambda: self._subscribers.remove(callback)
