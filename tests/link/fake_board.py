"""A small board that speaks the declaration, and lines to reach it by: simulated, and a pseudo-terminal.

It flies nothing: its angles are a known function of the tick, so that a test can distinguish a right
sample from a wrong one. Its frames are built by the slow witness of `host_reference`.
"""

from __future__ import annotations

import contextlib
import os
import select
import threading
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

from heli_host import declaration as link
from heli_host.declaration import Channel, Flags, MessageId, Result, State
from heli_host.errors import LinkLost, PortError
from heli_host.link.frames import Frame, FrameParser

from tests.channels.groups import COUNTS, SETPOINTS, VOLTAGES, row_of
from tests.link import host_reference as reference

BATCH_TICKS = 20
ILLEGAL_TRAVEL = 11
"""Illegal transitions of the travel encoder in each status."""
Damage = Callable[[bytes], bytes]

_NEXT_STATE = {
    MessageId.ARM: State.ARMED,
    MessageId.STOP: State.IDLE,
    MessageId.CONTROL: State.CLOSED_LOOP,
    MessageId.STREAM: State.STREAMED,
    MessageId.LAND: State.IDLE,
    MessageId.CLEAR_FAULT: State.IDLE,
}


def truth(tick: int, state: int = State.IDLE) -> list[int]:
    """The one sample that this board may send at a tick."""
    wave = (tick * 37) % 2001 - 1000
    counts = zip(COUNTS, (wave, -wave, tick % 977), strict=True)
    setpoints = zip(SETPOINTS, (wave * 9, tick % 50, -tick % 999), strict=True)
    volts = zip(VOLTAGES, (tick % 300, tick % 301), strict=True)
    status = ((Channel.STATE, state), (Channel.FLAGS, Flags.LINK_ALIVE))
    return row_of(dict([*counts, *setpoints, *volts, *status]))


class FakeBoard:
    """Answers commands exactly once, and sends telemetry and status while a session is open."""

    def __init__(self) -> None:
        self.tick = 0
        self.state = State.IDLE
        self.boot_id = 1
        self.link_hash = link.LINK_HASH
        self.link_version = (1, 0)
        self.params = [spec.default for spec in link.PARAMS]
        self.answers_hello = True
        self.open = False
        self.executed: list[bytes] = []
        # Results, details and values with which it refuses commands, by message.
        self.refusals: dict[int, tuple[Result, int, float]] = {}
        self.lose_replies = 0
        self.repeat_replies = 0
        self.silent = False
        # Each frame of the host, with the tick of its arrival.
        self.heard: list[tuple[int, Frame]] = []
        self._parser = FrameParser()
        self._seq = 0
        self._session: int | None = None
        # A repeated command gets the answer that it got.
        self._last_command: bytes | None = None
        self._last_answer = b""
        self._batch: list[list[int]] = []
        self._out = bytearray()

    def reboot(self) -> None:
        """Start again, as after a reset."""
        self.tick, self.boot_id, self.state = 0, self.boot_id + 1, State.IDLE
        self.open, self._session, self._last_command, self._seq = False, None, None, 0
        self._batch.clear()
        self.event(link.Event.BOOT, int(link.Reset.WATCHDOG), self.boot_id)

    def change_state(self, state: State, *, tell: bool = True) -> None:
        """Be in another state from the next tick on; its event may be lost."""
        self.state = state
        if tell:
            self.send(
                link.EventMessage(
                    tick=self.tick + 1, kind=link.Event.STATE, detail=state, cause=link.Trigger.ARM, value=0.0
                )
            )

    def event(self, kind: int, detail: int = 0, value: float = 0.0) -> None:
        """Report something."""
        self.send(link.EventMessage(tick=self.tick, kind=kind, detail=detail, cause=0, value=value))

    def send(self, message: object, tail: bytes = b"") -> None:
        """Send a message of the declaration."""
        payload = message.pack() + tail  # type: ignore[attr-defined]
        self._seq = (self._seq + 1) % 256
        self._out += reference.frame(message.ID, self._seq, payload)  # type: ignore[attr-defined]

    def feed(self, data: bytes) -> None:
        """Take bytes from the host."""
        for frame in self._parser.feed(data):
            self.heard.append((self.tick, frame))
            self._take(frame)

    def advance(self, ticks: int) -> bytes:
        """Let milliseconds pass; return what was sent meanwhile."""
        for _ in range(ticks):
            self.tick += 1
            if not self.open:
                self._batch.clear()
                continue
            self._batch.append(truth(self.tick, self.state))
            if len(self._batch) == BATCH_TICKS:
                self._seq = (self._seq + 1) % 256
                payload = reference.telemetry_payload(self.tick - BATCH_TICKS + 1, self._batch)
                self._out += reference.frame(MessageId.TELEMETRY, self._seq, payload)
                self._batch.clear()
            if self.tick % 1000 == 0:
                self.send(self._status(0))
        out = b"" if self.silent else bytes(self._out)
        self._out.clear()
        return out

    def _status(self, request: int) -> link.StatusMessage:
        # Each counter is another number, so that a host that mixes two of them shows it.
        return link.StatusMessage(
            request=request,
            tick=self.tick,
            frames_ok=1,
            frames_bad=2,
            frames_lost=3,
            duplicates=4,
            stale_streams=5,
            ticks_dropped=6,
            overruns=7,
            tick_max_us=8,
            illegal_elevation=9,
            illegal_pitch=10,
            illegal_travel=ILLEGAL_TRAVEL,
            setpoint_rate_Hz=12,
        )

    def _take(self, frame: Frame) -> None:
        if frame.id == MessageId.HELLO:
            self._hello(link.HelloMessage.unpack(frame.payload))
        elif frame.id in (MessageId.SETPOINT, MessageId.VOLTAGES):
            return
        elif not self.open:
            self.send(
                link.AckMessage(
                    request=frame.payload[0],
                    command=frame.id,
                    result=Result.NO_HANDSHAKE,
                    detail=0,
                    value=0.0,
                )
            )
        elif frame.id == MessageId.PING:
            ping = link.PingMessage.unpack(frame.payload)
            self.send(link.PongMessage(ping.request, ping.host_us, self.tick))
        elif frame.id == MessageId.STATUS_READ:
            self.send(self._status(frame.payload[0]))
        elif frame.id == MessageId.PARAMS_READ:
            read = link.ParamsReadMessage.unpack(frame.payload)
            values = self.params[read.first : read.first + 32]
            tail = b"".join(reference.f32(value) for value in values)
            self.send(link.ParamsMessage(read.request, read.first, len(values)), tail)
        else:
            self._execute_once(frame)

    def _hello(self, hello: link.HelloMessage) -> None:
        if not self.answers_hello:
            return
        self.open = hello.link_hash == self.link_hash
        if hello.session != self._session:
            self._session, self._last_command = hello.session, None
        result = Result.OK if self.open else Result.HASH_MISMATCH
        self.send(
            link.WelcomeMessage(
                request=hello.request,
                result=result,
                link_hash=self.link_hash,
                link_major=self.link_version[0],
                link_minor=self.link_version[1],
                firmware_major=0,
                firmware_minor=1,
                firmware_patch=2,
                board=0,
                reset=2,
                boot_fault=0,
                boot_id=self.boot_id,
                tick=self.tick,
                params_source=0,
            )
        )

    def _execute_once(self, frame: Frame) -> None:
        command = bytes([frame.id]) + frame.payload
        if self._last_command != command:
            self._last_command, self._last_answer = command, self._execute(frame)
        if self.lose_replies:
            self.lose_replies -= 1
            return
        for _ in range(1 + self.repeat_replies):
            self._seq = (self._seq + 1) % 256
            self._out += reference.frame(MessageId.ACK, self._seq, self._last_answer)

    def _execute(self, frame: Frame) -> bytes:
        request = frame.payload[0]
        if frame.id in self.refusals:
            result, detail, value = self.refusals[frame.id]
            return link.AckMessage(request, frame.id, result, detail, value).pack()
        self.executed.append(bytes([frame.id]) + frame.payload[1:])
        value = 0.0
        if frame.id == MessageId.PARAM_SET:
            message = link.ParamSetMessage.unpack(frame.payload)
            self.params[message.index] = value = message.value
        if frame.id in _NEXT_STATE:
            self.state = _NEXT_STATE[MessageId(frame.id)]
        return link.AckMessage(
            request=request, command=frame.id, result=Result.OK, detail=0, value=value
        ).pack()


class FakeLine:
    """A lockstep transport to a fake board; simulated time passes in `read`."""

    lockstep = True

    def __init__(
        self, board: FakeBoard, to_host: Damage | None = None, to_board: Damage | None = None
    ) -> None:
        self.url = "fake://"
        self.board = board
        self.out_at_s: tuple[float, float] = (1e9, 1e9)
        self.written = bytearray()
        self._to_host = to_host or bytes
        self._to_board = to_board or bytes
        self._now_ticks = 0
        self._closed = False

    @property
    def unplugged(self) -> bool:
        """Whether the cable is out now."""
        return self.out_at_s[0] <= self.now_s() < self.out_at_s[1]

    def damage_to_host(self, to_host: Damage) -> None:
        """Do this to every reading from now on."""
        self._to_host = to_host

    def read(self, timeout_s: float) -> bytes:
        """Let time pass."""
        self._check()
        self.board.feed(self._to_board(bytes(self.written)))
        self.written.clear()
        return self._to_host(self._pass(max(1, round(1e3 * timeout_s))))

    def write(self, data: bytes) -> None:
        """Take bytes for the board."""
        self._check()
        self.written += data

    def now_s(self) -> float:
        """Simulated time."""
        return self._now_ticks * 1e-3

    def wall_ns(self) -> int:
        """Simulated date."""
        return self._now_ticks * 1_000_000

    def close(self) -> None:
        """Close."""
        self._closed = True

    def reopen(self) -> FakeLine:
        """Look for the board again; takes 0.1 s when it is not there."""
        if self.unplugged:
            self._pass(100)
            raise PortError("the cable is out", "plug it in")
        self._closed = False
        return self

    def _pass(self, ticks: int) -> bytes:
        self._now_ticks += ticks
        return self.board.advance(ticks)

    def _check(self) -> None:
        if self._closed or self.unplugged:
            raise LinkLost("the cable was pulled out", "plug it in")


class PtyBoard:
    """A fake board behind a pseudo-terminal, in real time; its path stays when it is plugged in again."""

    def __init__(self, board: FakeBoard, folder: Path) -> None:
        self.board = board
        self.path = folder / "board"
        self._plugged = threading.Event()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._plugged.set()
        self._thread.start()
        while not self.path.exists():
            time.sleep(0.001)

    def unplug(self) -> None:
        """Pull the cable; the port vanishes."""
        self._plugged.clear()
        while self.path.exists():
            time.sleep(0.001)

    def plug_in(self) -> None:
        """Put it back, as another terminal under the same name."""
        self._plugged.set()

    def close(self) -> None:
        """End it."""
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._stop.is_set():
            if self._plugged.wait(0.01):
                with self._terminal() as master:
                    self._serve(master)
            else:
                self.board.advance(10)

    @contextlib.contextmanager
    def _terminal(self) -> Iterator[int]:
        master, slave = os.openpty()
        tty.setraw(slave)
        self.path.symlink_to(os.ttyname(slave))
        try:
            yield master
        finally:
            self.path.unlink()
            os.close(slave)
            os.close(master)

    def _serve(self, master: int) -> None:
        began_s, began_tick = time.monotonic(), self.board.tick
        while self._plugged.is_set() and not self._stop.is_set():
            if select.select([master], [], [], 0.004)[0]:
                self.board.feed(os.read(master, 4096))
            due = round((time.monotonic() - began_s) * 1e3) - (self.board.tick - began_tick)
            if due < 0:
                began_s, began_tick = time.monotonic(), self.board.tick
            os.write(master, self.board.advance(max(due, 0)))


def ticks_of_received(board: FakeBoard, message_id: MessageId) -> list[int]:
    """Ticks at which the board heard a message."""
    return [tick for tick, frame in board.heard if frame.id == message_id]
