"""Sends the setpoints of a route: from the callback that brings samples, and by the clock if none come."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

import numpy as np

from heli_host.data.flight.flown import TAKE_OFF
from heli_host.declaration import AXES, SetpointMessage
from heli_host.fly.route import Piece, Route
from heli_host.fly.ticks import newest_tick
from heli_host.link.clock import TICK_S

if TYPE_CHECKING:
    from heli_host.board.vehicle import Vehicle
    from heli_host.fly.recorder import Recorder
    from heli_host.fly.tracking import TrackingMonitor
    from heli_host.link.telemetry import Ticks

INTERVAL_TICKS = 20
"""Device time between two setpoints: 50 a second."""
LEAD_TICKS = 100
"""Device time from now to the tick at which a setpoint is to be reached. The board ramps towards it, so that
the motion continues even if the next frame is late by this time."""

_LONGEST_LEAD_TICKS = 400
_STALL_TICKS = 60


class RouteStream:
    """Setpoints of one flight.

    It owns whether setpoints are sent at present, and its lock makes `end` final: no setpoint leaves after it
    has returned. `take_ticks` runs in the session's reading thread, all other methods in that of
    `heli_host.fly.pilot.Pilot.fly`. In lockstep both are the same thread.
    """

    def __init__(self, heli: Vehicle, route: Route, recorder: Recorder, tracking: TrackingMonitor) -> None:
        self.start_tick = 0
        self._heli = heli
        self._session = heli.session
        self._route = route
        self._recorder = recorder
        self._tracking = tracking
        self._lock = threading.Lock()
        self._streaming = False
        self._sent_tick = 0
        self._coming_ends = list(route.pieces)
        self._coming_phases = _first_piece_of_phases(route)
        # The take-off lasts until the first phase of another name begins.
        take_off_s = next(
            (piece.start_s for piece in self._coming_phases if piece.phase != TAKE_OFF),
            route.duration_s,
        )
        self._take_off_ticks = round(take_off_s / TICK_S)

    @property
    def taken_off_tick(self) -> int:
        """Tick at which the first plan begins."""
        return self.start_tick + self._take_off_ticks

    @property
    def end_tick(self) -> int:
        """Tick at which the route ends."""
        return self.start_tick + round(self._route.duration_s / TICK_S)

    @property
    def t_s(self) -> float:
        """Device time since the loops were closed [s]."""
        return (newest_tick(self._session) - self.start_tick) * TICK_S

    def tick_of(self, piece: Piece) -> int:
        """Return the tick at which a piece of the route begins."""
        return self.start_tick + round(piece.start_s / TICK_S)

    def _end_tick_of(self, piece: Piece) -> int:
        return self.start_tick + round((piece.start_s + piece.duration_s) / TICK_S)

    def warm_up(self) -> None:
        """Evaluate the route once. The first evaluation takes 20 ms, most of it numpy's; at 50x real time
        that is a second of flight.
        """
        self._setpoint_rad_at(newest_tick(self._session))

    def begin(self) -> None:
        """Send setpoints from the newest tick on."""
        with self._lock:
            self.start_tick = newest_tick(self._session)
            self._sent_tick = self.start_tick - INTERVAL_TICKS
            self._streaming = True

    def end(self) -> None:
        """Send no more setpoints."""
        with self._lock:
            self._streaming = False

    def take_ticks(self, ticks: Ticks) -> None:
        """Follow the route on the device time of new samples."""
        tick = newest_tick(self._session)
        with self._lock:
            if not self._streaming:
                return
            self._tracking.take(ticks, self.taken_off_tick)
            while self._coming_ends and tick >= self._end_tick_of(self._coming_ends[0]):
                ended_piece = self._coming_ends.pop(0)
                self._tracking.take_end(
                    ticks, self._end_tick_of(ended_piece), ended_piece, not self._coming_ends
                )
            while self._coming_phases and tick >= self.tick_of(self._coming_phases[0]):
                begun_piece = self._coming_phases.pop(0)
                self._recorder.mark_phase(self.tick_of(begun_piece), begun_piece.phase)
            if tick >= self._sent_tick + INTERVAL_TICKS:
                self._send_setpoint_due_after(tick)

    def bridge_a_stall(self) -> None:
        """Send setpoints on the estimated device time while no samples arrive, so that a pause of telemetry
        does not cause a landing.
        """
        if not self._session.connected:
            return
        tick = self._session.device_tick()
        with self._lock:
            if self._streaming and tick >= self._sent_tick + _STALL_TICKS:
                self._send_setpoint_due_after(tick)

    def _send_setpoint_due_after(self, tick: int) -> None:
        """Stream the setpoint that is due some ticks after `tick`, so that it arrives in time."""
        # Where samples come in larger portions than setpoints are due, the lead covers the time to the next
        # one.
        lead_ticks = min(max(LEAD_TICKS, tick - self._sent_tick + INTERVAL_TICKS), _LONGEST_LEAD_TICKS)
        at_tick = tick + lead_ticks
        message = SetpointMessage(at_tick & 0xFFFFFFFF, **self._setpoint_rad_at(at_tick))
        self._sent_tick = tick
        self._session.stream(message)
        self._session.keep_alive(message if self._heli.keep_alive else None)

    def _setpoint_rad_at(self, tick: int) -> dict[str, float]:
        t_s = np.array([(tick - self.start_tick) * TICK_S])
        angles_rad: list[float] = np.radians(self._route.evaluate(t_s)[0]).tolist()
        return {f"{axis}_rad": angle_rad for axis, angle_rad in zip(AXES, angles_rad, strict=True)}


def _first_piece_of_phases(route: Route) -> list[Piece]:
    """Return the first piece of every phase, in order."""
    firsts: list[Piece] = []
    for piece in route.pieces:
        if not firsts or firsts[-1].phase != piece.phase:
            firsts.append(piece)
    return firsts
