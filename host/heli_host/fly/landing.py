"""The end of every flight of plans: the arm comes down, and the log goes on until it rests."""

from __future__ import annotations

from typing import TYPE_CHECKING

from heli_host.data.flight.flown import LANDING
from heli_host.declaration import Channel, State, Trigger
from heli_host.fly.ticks import newest_tick, wait_ticks

if TYPE_CHECKING:
    from heli_host.board.vehicle import Vehicle
    from heli_host.fly.flight_monitor import FlightMonitor
    from heli_host.fly.progress import ProgressReports
    from heli_host.fly.recorder import Recorder
    from heli_host.fly.route_stream import RouteStream

# The log ends at rest: these rows show the encoders' offsets and noise.
_AFTER_TICKS = 200
_DOWN = (State.IDLE, State.FAULT)
_REQUESTED = (Trigger.LAND, Trigger.STOP)


class Landing:
    """Brings the arm down, in the thread of `heli_host.fly.pilot.Pilot.fly`, which handles its errors."""

    def __init__(
        self,
        heli: Vehicle,
        stream: RouteStream,
        recorder: Recorder,
        monitor: FlightMonitor,
        reports: ProgressReports,
    ) -> None:
        self._heli = heli
        self._session = heli.session
        self._stream = stream
        self._recorder = recorder
        self._monitor = monitor
        self._reports = reports

    def land(self, *, is_completed: bool) -> str:
        """Land, or wait for the end that the board reached by itself."""
        if not self._session.connected and not self._monitor.was_closed:
            return ""
        # An idle board needs no landing, although a sample with this state may not have arrived yet.
        has_flown = self._monitor.was_closed or self._session.state not in _DOWN
        trouble = ""
        if has_flown and not self._monitor.restarted():
            trouble = self._heli.bring_down(
                lambda: self._recorder.mark_phase(newest_tick(self._session), LANDING),
                lambda: self._reports.report_landing(self._stream.t_s),
            )
        else:
            wait_ticks(self._session, _AFTER_TICKS)
        newest = self._session.latest
        if is_completed and not trouble and newest is not None and not self._monitor.restarted():
            # The board may have landed by itself, if the host was suspended between the end of the plan and
            # the landing.
            _, channels = newest
            was_requested = channels[Channel.TRIGGER] in _REQUESTED
            if channels[Channel.STATE] in _DOWN and not was_requested:
                return self._monitor.why_down()
        return trouble
