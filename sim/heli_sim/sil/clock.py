"""How much simulated time may pass. Callers pass in the present time; nothing in this module reads a
clock.
"""

from __future__ import annotations

from typing import Final, Protocol

from typing_extensions import override

# A wake-up costs about 60 us of processor time whatever it simulates; 4 ms is also the rhythm in which the
# bridge of a real Due hands over its bytes.
_SLICE_WALL_s: Final = 0.004
_SLICE_TICKS: Final = (4, 20)
# A machine that slept or was overloaded for longer than this goes on from where it is.
_MAX_BEHIND_s: Final = 0.5


class Clock(Protocol):
    """Decides how many milliseconds to simulate now."""

    follows_host: bool
    """Whether bytes from the host let time go on, so that waiting for them is worth while."""

    def due(self, now_s: float, tick: int) -> int:
        """Milliseconds to simulate at `now_s` of any monotonic clock, after `tick` simulated so far; 0 to
        wait.
        """
        ...

    def wait_s(self, now_s: float, tick: int) -> float:
        """Seconds until `due` can return more than 0, from the same `now_s` and `tick`."""
        ...

    def heard(self, now_s: float, tick: int) -> None:
        """Record that bytes came from the host at `now_s`, after `tick` simulated milliseconds."""
        ...


class TimedClock(Clock):
    """Real time, or `speed` times as fast, on an absolute schedule: a late slice does not delay the
    next one.
    """

    follows_host = False

    def __init__(self, speed: float = 1.0) -> None:
        self._ticks_per_s = 1e3 * speed
        least, most = _SLICE_TICKS
        self._slice = max(least, min(most, round(_SLICE_WALL_s * self._ticks_per_s)))
        self._start: tuple[float, int] | None = None
        self.slipped_s = 0.0
        """Time given up because the machine could not keep the pace, s."""

    @override
    def due(self, now_s: float, tick: int) -> int:
        start_s, start_tick = self._anchor(now_s, tick)
        behind = (now_s - start_s) * self._ticks_per_s - (tick - start_tick)
        if behind > _MAX_BEHIND_s * self._ticks_per_s + self._slice:
            self.slipped_s += behind / self._ticks_per_s
            self._start = (now_s, tick)
        return self._slice if behind >= self._slice else 0

    @override
    def wait_s(self, now_s: float, tick: int) -> float:
        start_s, start_tick = self._anchor(now_s, tick)
        return max(0.0, start_s + (tick - start_tick + self._slice) / self._ticks_per_s - now_s)

    @override
    def heard(self, now_s: float, tick: int) -> None:
        pass

    def _anchor(self, now_s: float, tick: int) -> tuple[float, int]:
        if self._start is None:
            self._start = (now_s, tick)
        return self._start


class LockstepClock(Clock):
    """As fast as the host keeps up.

    Simulated time runs at most `window_ms` ahead of the last byte that came from the host, so a host that
    streams setpoints by the board's clock is never overrun. It never runs slower than real time either: a
    host that is silent, slow or dead sees what it would see with hardware, and the failsafe acts.

    Parameters
    ----------
    window_ms : int
        How far ahead, ms. Two periods of a 50 Hz stream, so that host and board can work at the same time.
    """

    follows_host = True

    def __init__(self, window_ms: int = 40) -> None:
        self._window = window_ms
        self._heard: tuple[float, int] | None = None

    @override
    def due(self, now_s: float, tick: int) -> int:
        least, most = _SLICE_TICKS
        allowed = self._allowed(now_s, tick) - tick
        return min(int(allowed), most) if allowed >= least else 0

    @override
    def wait_s(self, now_s: float, tick: int) -> float:
        return max(0.0, 1e-3 * (tick + _SLICE_TICKS[0] - self._allowed(now_s, tick)))

    @override
    def heard(self, now_s: float, tick: int) -> None:
        self._heard = (now_s, tick)

    def _allowed(self, now_s: float, tick: int) -> float:
        if self._heard is None:
            self._heard = (now_s, tick)
        heard_s, heard_tick = self._heard
        return heard_tick + self._window + 1e3 * (now_s - heard_s)


def make_clock(speed: float | None) -> Clock:
    """Make a clock that passes `speed` simulated seconds per second, or as fast as the host keeps up if
    `speed` is None. Its schedule starts with the first call of `due`.
    """
    return LockstepClock() if speed is None else TimedClock(speed)
