"""Clocks decide how much simulated time may pass: in real time, or as fast as the host keeps up.

Callers pass in the present time, so that a test can run without waiting.
"""

from __future__ import annotations

from typing import Final, Protocol

from typing_extensions import override

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
    """As fast as the host keeps up, but not slower than real time.

    Simulated time runs at most `window_ms` ahead of the last byte from the host, so that a host that streams
    setpoints by the board's clock is not overrun. If the host is silent or slow, time passes as on hardware,
    and the failsafe acts.
    """

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
