"""Conversion of device time to host time, estimated from the arrival times of bytes.

Bytes arrive late, because of the length of a frame, the bursts of a USB bridge, and the load of this
computer; they never arrive early. Therefore the line that maps ticks to host seconds lies below all arrivals
and touches the quickest of them. Among all such lines, the line with the least mean lateness is an edge of
the lower convex hull of the arrivals. A pong also gives the time of its request. Half of the shortest round
trip is subtracted as the transit time from board to host.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from numbers import Real
from typing import NamedTuple

from heli_host.declaration import TICK_US
from heli_host.errors import ParameterError

TICK_S = TICK_US * 1e-6

_BIN_TICKS = 500
_BINS = 120
# Four bins in a row this late mean that the clocks have moved against each other (a simulation was paused, a
# computer slept), not that the line was busy: a full Due line is late by 15 ms at most.
_STEP_S = 0.03
_STEP_BINS = 4

_MIN_TICK_S = 1e-9
"""Shortest tick of a line, a millionth of the real one: faster than any simulation. Arrivals that a busy
computer reads together have the same host time; a slope of 0 could not convert host times to ticks."""


def check_duration(value: float, what: str) -> None:
    """Raise a ParameterError unless `value` is a finite number of seconds, 0 or more."""
    if not (isinstance(value, Real) and 0.0 <= value < math.inf):
        raise ParameterError(f"{what} of {value!r} s is impossible", "give a number of seconds, 0 or more")


class _Point(NamedTuple):
    """An arrival of something that the board sent at or after a tick."""

    tick: int
    host_s: float


@dataclass(frozen=True)
class ClockEstimate:
    """A map between device time and the host's monotonic time."""

    origin_tick: float  # Tick at which the map is anchored
    origin_s: float  # Host time of that tick [s]
    tick_s: float
    """Host seconds that one tick takes [s]: near 0.001, less when a simulation runs faster than real time."""
    jitter_s: float  # Lateness that one in twenty of the recent arrivals exceeds [s]
    round_trip_s: float  # Shortest round trip of a ping [s]; 0 before the first

    @property
    def rate(self) -> float:
        """Device seconds in one host second."""
        return TICK_S / self.tick_s

    @property
    def drift_ppm(self) -> float:
        """How much faster than the host's the device's clock runs, in parts per million of real time."""
        return (self.rate - 1.0) * 1e6

    def host_s_at(self, tick: float) -> float:
        """Return the host time of a tick."""
        return self.origin_s + (tick - self.origin_tick) * self.tick_s

    def tick_at(self, host_s: float) -> float:
        """Return the device time at a host time."""
        return self.origin_tick + (host_s - self.origin_s) / self.tick_s


class ClockFit:
    """Collects arrivals and fits a `ClockEstimate` to them, when asked."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget everything, because the board or the simulation's clock has restarted."""
        # Device time is divided into bins. Of each bin, only its quickest arrival is kept.
        self._bins: deque[_Point] = deque(maxlen=_BINS)
        self._hull: list[_Point] = []  # Lower convex hull of `_bins`
        self._bin_ticks = 0  # Sum of the ticks of `_bins`
        self._quickest_in_bin: _Point | None = None  # Of the newest bin, which is not complete
        self._delays_s: deque[float] = deque(maxlen=200)
        self._round_trip_s: deque[float] = deque(maxlen=60)
        self._estimate: ClockEstimate | None = None
        self._fit_is_old = True

    def observe(self, tick: int, host_s: float) -> None:
        """Take the arrival of something that the board sent at or after a tick."""
        quickest = self._quickest_in_bin
        if quickest is None:
            self._quickest_in_bin, self._fit_is_old = _Point(tick, host_s), True
            return
        estimate = self._estimate
        tick_s = estimate.tick_s if estimate is not None else TICK_S
        if tick // _BIN_TICKS != quickest.tick // _BIN_TICKS:
            # The bin of `quickest` is complete, and another one begins.
            self.estimate()
            self._bins.append(quickest)
            self._forget_before_a_step()
            self._hull = _lower_hull(self._bins)
            self._bin_ticks = sum(point.tick for point in self._bins)
            self._quickest_in_bin, self._fit_is_old = _Point(tick, host_s), True
        elif host_s - quickest.host_s < (tick - quickest.tick) * tick_s:
            self._quickest_in_bin = _Point(tick, host_s)  # it took less time than the quickest
        if estimate is None:
            self._fit_is_old = True
        else:
            delay_s = host_s - estimate.host_s_at(tick)
            self._delays_s.append(delay_s)
            # An arrival on the line or above does not change it; rounding errors are below a microsecond
            # here.
            if delay_s < estimate.round_trip_s / 2.0 - 1e-6:
                self._fit_is_old = True

    def observe_pong(self, sent_s: float, tick: int, host_s: float) -> None:
        """Take the answer to a ping."""
        self._round_trip_s.append(max(host_s - sent_s, 0.0))
        self.observe(tick, host_s)
        self._fit_is_old = True

    def estimate(self) -> ClockEstimate | None:
        """Fit the map to what was seen so far."""
        if self._fit_is_old and self._quickest_in_bin is not None:
            self._estimate = self._fit_line_below_arrivals(self._quickest_in_bin)
            self._fit_is_old = False
        return self._estimate

    def _fit_line_below_arrivals(self, newest: _Point) -> ClockEstimate:
        """Fit the line from device tick to host time that lies below all arrivals with the least mean
        lateness.
        """
        # The line is moved down by the transit time, which is half of the shortest round trip.
        anchor = newest
        tick_s = self._estimate.tick_s if self._estimate is not None else TICK_S
        # Over less than half a bin, the lateness of two arrivals would hide the slope.
        if self._bins and newest.tick - self._bins[0].tick >= _BIN_TICKS // 2:
            # Only the line's value at the mean tick counts for the mean lateness: take the hull's edge there.
            mean_tick = (self._bin_ticks + newest.tick) / (len(self._bins) + 1)
            anchor, end = _hull_edge_at(mean_tick, _lower_hull([newest], self._hull))
            tick_s = max((end.host_s - anchor.host_s) / (end.tick - anchor.tick), _MIN_TICK_S)
        round_trip_s = min(self._round_trip_s, default=0.0)
        delays_s = sorted(self._delays_s)
        jitter_s = delays_s[int(0.95 * len(delays_s))] if delays_s else 0.0
        return ClockEstimate(
            origin_tick=anchor.tick,
            origin_s=anchor.host_s - round_trip_s / 2.0,
            tick_s=tick_s,
            jitter_s=max(jitter_s, 0.0),
            round_trip_s=round_trip_s,
        )

    def _forget_before_a_step(self) -> None:
        """Discard arrivals from before a step of the device clock or of the delay, so that the line follows
        the newer ones.
        """
        bins = self._bins
        if len(bins) <= _STEP_BINS or self._estimate is None:
            return
        is_above_line = [host_s - self._estimate.host_s_at(tick) > _STEP_S for tick, host_s in bins]
        kept_count = len(bins)
        if all(is_above_line[-_STEP_BINS:]):
            kept_count = _STEP_BINS
        elif 4 * sum(is_above_line) > len(is_above_line):
            # The device clock has become faster, so that the old arrivals hold the line too low.
            kept_count = max(len(bins) // 2, _STEP_BINS)
        for _ in range(len(bins) - kept_count):
            bins.popleft()


def _lower_hull(points: Iterable[_Point], before: Sequence[_Point] = ()) -> list[_Point]:
    """Lower convex hull of points in the order of their ticks, behind a hull of earlier ones."""
    hull = list(before)
    for point in points:
        while len(hull) >= 2:
            (tick_0, host_0_s), (tick_1, host_1_s) = hull[-2], hull[-1]
            # The last corner stays if the slope to it is smaller than the slope past it to the point.
            if (host_1_s - host_0_s) * (point.tick - tick_0) < (point.host_s - host_0_s) * (tick_1 - tick_0):
                break
            hull.pop()
        if hull and hull[-1].tick == point.tick:
            hull[-1] = min(hull[-1], point)
        else:
            hull.append(point)
    return hull


def _hull_edge_at(tick: float, hull: Sequence[_Point]) -> tuple[_Point, _Point]:
    """Return the two neighbouring points of a hull that contain a tick between them."""
    for before, after in itertools.pairwise(hull):
        if after.tick >= tick:
            return before, after
    return hull[-2], hull[-1]
