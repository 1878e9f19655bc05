"""The end of every flight: the arm comes down, or the motors go off."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from heli_host.declaration import Channel, State, Trigger
from heli_host.errors import fault_text
from heli_host.flight.flown import LANDING
from heli_host.fly.ticks import newest_tick, wait_ticks
from heli_host.link.clock import TICK_S

if TYPE_CHECKING:
    from heli_host.fly.flight_monitor import FlightMonitor
    from heli_host.fly.progress import ProgressReports
    from heli_host.fly.recorder import Recorder
    from heli_host.fly.route_stream import RouteStream
    from heli_host.vehicle import Vehicle

NOT_LANDED: Final = "it did not land"
"""How the outcome of a flight begins whose board did not land in time."""
_LOOK_S = 0.05
# The log ends at rest: these rows show the encoders' offsets and noise.
_AFTER_TICKS = 200
_DOWN = (State.IDLE, State.FAULT)
_REQUESTED = (Trigger.LAND, Trigger.STOP)


class Landing:
    """Brings the arm down, in the thread of `heli_host.fly.pilot.Pilot.fly`, which handles its errors.

    Parameters
    ----------
    heli : Vehicle
        Board that flies.
    stream : RouteStream
        Time of the flight, for reports. It has ended: the board descends by itself.
    recorder : Recorder
        Records the beginning of the landing.
    monitor : FlightMonitor
        Knows how the flight ended.
    reports : ProgressReports
        Gets the progress of the landing.
    """

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
        """Land, or wait for the end that the board reached by itself.

        Parameters
        ----------
        is_completed : bool
            Whether the route was flown to its end.

        Returns
        -------
        str
            Text of the error; empty without one.
        """
        if not self._session.connected and not self._monitor.was_closed:
            return ""
        trouble = ""
        if self._monitor.restarted():
            # An idle board needs no landing, although a sample with this state may not have arrived yet.
            pass
        elif self._session.state is State.ARMED:
            self._heli.stop()
        elif self._session.state not in _DOWN:
            trouble = self._land_and_wait()
        wait_ticks(self._session, _AFTER_TICKS)
        newest = self._session.latest
        if is_completed and not trouble and newest is not None:
            # The board may have landed by itself, if the host was suspended between the end of the plan and
            # the landing.
            _, channels = newest
            was_requested = channels[Channel.TRIGGER] in _REQUESTED
            if channels[Channel.STATE] in _DOWN and not was_requested:
                return self._monitor.why_down()
            return ""
        return trouble

    def _land_and_wait(self) -> str:
        """Land, wait until the motors are off, and return the reason if that failed; an empty text otherwise.
        A board that does not land in time is stopped.
        """
        begin_tick = newest_tick(self._session)
        emergency = self._session.state is State.EMERGENCY_LANDING
        if self._session.state is not State.LANDING and not emergency:
            self._heli.land(wait=False)
        self._recorder.mark_phase(begin_tick, LANDING)
        timeout_s = self._heli.params["landing_timeout_s"] + 3.0
        until_tick = newest_tick(self._session) + round(timeout_s / TICK_S)
        while self._session.state not in _DOWN:
            if newest_tick(self._session) >= until_tick:
                self._heli.stop()
                return f"{NOT_LANDED} within {timeout_s:g} s; motors stopped"
            self._reports.report_landing(self._stream.t_s)
            self._session.wait_for(lambda: self._session.state in _DOWN, _LOOK_S)
        if self._session.state is not State.FAULT or emergency:
            return ""
        return f"fault {fault_text(self._monitor.fault())}"
