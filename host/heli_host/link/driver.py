"""Moves bytes between transport and protocol: in a thread over a port, in the waiting call in lockstep."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable

from heli_host.declaration import StopMessage
from heli_host.errors import HeliError, LinkError, LinkLost
from heli_host.link.engine import Engine, Received
from heli_host.link.subscribers import Subscribers
from heli_host.link.transport import READ_INTERVAL_S, Transport, set_read_interval

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
        self.fatal: HeliError | None = None
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
        error = self._subscribers.take_error() or self.fatal
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
            while not self._stop.is_set() and self.fatal is None:
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
            if self.fatal is None:
                self.fatal = error
            self._changed.notify_all()
