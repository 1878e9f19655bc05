"""Serves a simulated board on ports. Clocks decide how much simulated time may pass."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import secrets
import select
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Sequence
from ipaddress import ip_address
from pathlib import Path
from typing import Any, Final, Protocol
from urllib.parse import parse_qsl, urlsplit

from typing_extensions import override

from heli_sim.errors import EndpointError, OptionError, SimError
from heli_sim.sil.fault_console import FaultConsole
from heli_sim.sil.options import DUE, SilOptions, parse_options
from heli_sim.sil.ports import Endpoint, Rfc2217Endpoint, TcpEndpoint
from heli_sim.sil.world import SilWorld

# A tick is one control step of the board, 1 ms of simulated time. A slice is the ticks that are simulated in
# one call.
_SLICE_WALL_s: Final = 0.004
"""Host time between two slices [s]. Each wake-up costs about 60 us of processor time. The bridge of a real
Due also delivers its bytes about every 4 ms."""
_MIN_SLICE_TICKS: Final = 4
_MAX_SLICE_TICKS: Final = 20
_MAX_BEHIND_s: Final = 0.5
"""Largest delay that is caught up, in host time [s]. After a longer sleep or overload of the machine,
simulated time continues from the present tick."""


class Clock(Protocol):
    """Decides how many ticks of 1 ms to simulate now. Host times are those of any monotonic clock."""

    follows_host: bool
    """Whether bytes from the host allow more simulated time, so that the server should wait for them."""

    def ticks_due(self, now_s: float, tick: int) -> int:
        """Return the number of ticks to simulate now; 0 if it is too early."""
        ...

    def wait_s(self, now_s: float, tick: int) -> float:
        """Return the host time [s] until `ticks_due` can return more than 0, from the same `now_s` and
        `tick`.
        """
        ...

    def heard(self, now_s: float, tick: int) -> None:
        """Record that bytes came from the host at host time `now_s`, after `tick` simulated ticks."""
        ...


class TimedClock(Clock):
    """Real time, or `speed` times as fast. A late slice does not delay the next one."""

    follows_host = False

    def __init__(self, speed: float = 1.0) -> None:
        self._ticks_per_s = 1e3 * speed
        self._slice_ticks = max(
            _MIN_SLICE_TICKS, min(_MAX_SLICE_TICKS, round(_SLICE_WALL_s * self._ticks_per_s))
        )
        self._start: tuple[float, int] | None = None
        self.slipped_s = 0.0
        """Time given up because the machine could not keep the pace, s."""

    @override
    def ticks_due(self, now_s: float, tick: int) -> int:
        start_s, start_tick = self._schedule_start(now_s, tick)
        behind_ticks = (now_s - start_s) * self._ticks_per_s - (tick - start_tick)
        if behind_ticks > _MAX_BEHIND_s * self._ticks_per_s + self._slice_ticks:
            self.slipped_s += behind_ticks / self._ticks_per_s
            self._start = (now_s, tick)
        return self._slice_ticks if behind_ticks >= self._slice_ticks else 0

    @override
    def wait_s(self, now_s: float, tick: int) -> float:
        start_s, start_tick = self._schedule_start(now_s, tick)
        return max(0.0, start_s + (tick - start_tick + self._slice_ticks) / self._ticks_per_s - now_s)

    @override
    def heard(self, now_s: float, tick: int) -> None:
        pass

    def _schedule_start(self, now_s: float, tick: int) -> tuple[float, int]:
        """Return host time and tick at which the schedule started: those of the first call."""
        if self._start is None:
            self._start = (now_s, tick)
        return self._start


class LockstepClock(Clock):
    """As fast as the host keeps up, but not slower than real time."""

    # Simulated time runs at most `window_ms` ahead of the last byte from the host, so that a host that
    # streams setpoints by the board's clock is not overrun. If the host is silent or slow, time passes as on
    # hardware, and the failsafe acts.

    follows_host = True

    def __init__(self, window_ms: int = 40) -> None:
        self._window_ticks = window_ms
        self._last_heard: tuple[float, int] | None = None

    @override
    def ticks_due(self, now_s: float, tick: int) -> int:
        ahead_ticks = self._allowed_tick(now_s, tick) - tick
        return min(int(ahead_ticks), _MAX_SLICE_TICKS) if ahead_ticks >= _MIN_SLICE_TICKS else 0

    @override
    def wait_s(self, now_s: float, tick: int) -> float:
        return max(0.0, 1e-3 * (tick + _MIN_SLICE_TICKS - self._allowed_tick(now_s, tick)))

    @override
    def heard(self, now_s: float, tick: int) -> None:
        self._last_heard = (now_s, tick)

    def _allowed_tick(self, now_s: float, tick: int) -> float:
        """Return the tick up to which time may run: the window after the last byte, and real time since."""
        if self._last_heard is None:
            self._last_heard = (now_s, tick)
        heard_s, heard_tick = self._last_heard
        return heard_tick + self._window_ticks + 1e3 * (now_s - heard_s)


def make_clock(speed: float | None) -> Clock:
    """Make a clock that passes `speed` simulated seconds per second, or as fast as the host keeps up if
    `speed` is None. Its schedule starts with the first call of `ticks_due`.
    """
    return LockstepClock() if speed is None else TimedClock(speed)


class SilServer:
    """Moves bytes between a port and a simulated world, and advances the world by its clock."""

    def __init__(
        self, endpoint: Endpoint, world: SilWorld, clock: Clock, now_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._endpoint = endpoint
        self._world = world
        self._clock = clock
        self._now_s = now_s
        reset_on_open = world.options.reset_on_open
        self._reset_on_open = reset_on_open if reset_on_open is not None else world.options.board == DUE
        self._plugged = True
        self._received = b""

    def turn(self) -> float:
        """Move the available bytes and simulate the time that is due, without waiting."""
        # Returns the seconds until the next call is needed; 0 means immediately.
        endpoint, world, now_s = self._endpoint, self._world, self._now_s()
        self._follow_cable()
        received = endpoint.receive()
        if received:
            self._received += received
            self._clock.heard(now_s, world.tick)
        for change in endpoint.take_lines():
            if self._reset_on_open:
                world.control_lines(dtr=change.dtr, baud=change.baud)
        ticks = self._clock.ticks_due(now_s, world.tick)
        if ticks == 0:
            return self._clock.wait_s(now_s, world.tick)
        endpoint.send(b"")
        world.host_reading = endpoint.ready
        sent = world.advance(ticks, self._received)
        self._received = b""
        if sent:
            endpoint.send(sent)
        return self._clock.wait_s(now_s, world.tick)

    def watched(self) -> list[int]:
        """File descriptors to wait for: the port if simulated time follows the host, otherwise none."""
        fd = self._endpoint.fileno()
        return [fd] if self._clock.follows_host and fd >= 0 else []

    def _follow_cable(self) -> None:
        """Plug or unplug the port when the simulated cable is plugged or unplugged."""
        if self._world.unplugged == self._plugged:
            self._plugged = not self._plugged
            if self._plugged:
                self._endpoint.plug()
            else:
                self._endpoint.unplug()
                self._received = b""


def serve(
    endpoint: Endpoint,
    world: SilWorld,
    clock: Clock,
    stop_fd: int | None = None,
    console: FaultConsole | None = None,
) -> None:
    """Serve a world, with a `console` for faults if given, until `stop_fd` is ready to read."""
    server = SilServer(endpoint, world, clock)
    stops = [] if stop_fd is None else [stop_fd]
    while True:
        wait_s = server.turn()
        # Checking for a stop costs little compared with a turn, so it is done even with a wait of 0 s.
        console_fds = console.watched() if console is not None else []
        ready, _, _ = select.select(stops + server.watched() + console_fds, [], [], wait_s)
        if stop_fd in ready:
            return
        if console is not None:
            console.listen(ready)


def run_server(
    options: SilOptions,
    *,
    pty: str | Path | None = None,
    tcp: str | None = None,
    rfc2217: str | None = None,
    stop_fd: int | None = None,
    words_fd: int | None = None,
    answer: Callable[[str], None] = print,
    on_ready: Callable[[str], None] = lambda url: None,
) -> dict[str, int]:
    """Build a world and serve it until `stop_fd`, SIGINT, SIGTERM, SIGHUP or an error ends it. Return the
    counters of the link (see `SilWorld.counters`) and the simulated ticks.
    """
    # The port is the first given of `rfc2217`, `tcp` and `pty`, otherwise a pseudo-terminal without a link.
    # Faults are typed into `words_fd`, and `answer` takes the replies.
    # The default of these two would leave the link to the terminal behind.
    if threading.current_thread() is threading.main_thread():
        for name in ("SIGTERM", "SIGHUP"):
            if (number := getattr(signal, name, None)) is not None:
                signal.signal(number, signal.default_int_handler)
    world = SilWorld(options, boot_seed=secrets.randbits(64))
    console = FaultConsole(world, words_fd, answer) if words_fd is not None else None
    endpoint: Endpoint
    if rfc2217 is not None:
        endpoint = Rfc2217Endpoint(*_host_and_port(rfc2217))
    elif tcp is not None:
        endpoint = TcpEndpoint(*_host_and_port(tcp))
    else:
        endpoint = _pseudo_terminal(pty)
    try:
        on_ready(endpoint.url)
        serve(endpoint, world, make_clock(options.speed), stop_fd, console)
    except KeyboardInterrupt:
        pass
    finally:
        endpoint.close()
    return {**world.counters(), "ticks": world.tick}


def _pseudo_terminal(path: str | Path | None) -> Endpoint:
    """Open a pseudo-terminal with a link `path` to it; raise EndpointError if the system has none."""
    # Windows has no pseudo-terminals and no module termios.
    try:
        from heli_sim.sil.pty import PtyEndpoint
    except ImportError:
        raise EndpointError(
            "this system has no pseudo-terminals", "serve TCP: --tcp 127.0.0.1:5000, and connect to socket://"
        ) from None
    return PtyEndpoint(path)


def end_of_input() -> int:
    """Return a file descriptor that becomes readable when standard input ends."""
    # Windows can wait for sockets only. There, a thread reads the input and then closes one of two sockets.
    if os.name == "posix":
        return sys.stdin.fileno()
    watched, writer = socket.socketpair()

    def read() -> None:
        with contextlib.suppress(OSError, ValueError):
            while sys.stdin.buffer.read(4096):
                pass
        writer.close()

    threading.Thread(target=read, name="end of input", daemon=True).start()
    return watched.detach()


def is_local(url: str) -> bool:
    """Whether only programs on this machine can reach a port."""
    host = urlsplit(url).hostname
    if host is None or host == "localhost":
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return False


def _host_and_port(text: str) -> tuple[str, int]:
    """Split ``HOST:PORT``; without a host, the address is that of this machine."""
    host, _, port = text.rpartition(":")
    if not port.isdigit():
        raise OptionError(f"'{text}' is not an address", "write HOST:PORT")
    return host or "127.0.0.1", int(port)


def _print_json_line(**values: Any) -> None:
    """Print `values` as one line of JSON for the process that started this one."""
    # That process may have ended.
    with contextlib.suppress(BrokenPipeError):
        sys.stdout.write(json.dumps(values) + "\n")
        sys.stdout.flush()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the server as a separate program."""
    # The first line of its standard output is ``{"url": ...}`` once the port can be opened, the last one
    # ``{"counters": ...}``.
    parser = argparse.ArgumentParser(prog="heli_sim.sil.server", description="Serve a simulated board.")
    parser.add_argument("--pty", help="symbolic link to make to the pseudo-terminal")
    parser.add_argument("--tcp", help="HOST:PORT to listen on instead")
    parser.add_argument("--rfc2217", help="the same, with the control lines")
    parser.add_argument("--options", default="", help="rig=makki2024&seed=1&speed=max&...")
    parser.add_argument("--watch-stdin", action="store_true", help="stop when standard input ends")
    parsed = parser.parse_args(arguments)
    try:
        options = parse_options(dict(parse_qsl(parsed.options, keep_blank_values=True)))
        counters = run_server(
            options,
            pty=parsed.pty,
            tcp=parsed.tcp,
            rfc2217=parsed.rfc2217,
            stop_fd=end_of_input() if parsed.watch_stdin else None,
            on_ready=lambda url: _print_json_line(url=url),
        )
    except KeyboardInterrupt:
        return 0
    except SimError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    _print_json_line(counters=counters)
    return 0


if __name__ == "__main__":
    sys.exit(main())
