"""Progress of a flight, for the caller's callback."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from heli_host.data.flight.flown import LANDING

if TYPE_CHECKING:
    from heli_host.board.samples import Sample
    from heli_host.board.vehicle import Vehicle
    from heli_host.fly.route import Route
    from heli_host.link.accounting import LinkCounters


@dataclass(frozen=True)
class Progress:
    """Progress of a flight.

    Parameters
    ----------
    t_s : float
        Device time since the loops were closed, in seconds.
    left_s : float or None
        Device time left until the landing; None during it.
    phase : str
        ``take-off``, the name of a plan, or ``landing``.
    """

    t_s: float
    left_s: float | None
    phase: str
    sample: Sample
    counters: LinkCounters


class ProgressReports:
    """Calls the callback of a flight's caller, in the thread of `heli_host.fly.pilot.Pilot.fly`."""

    def __init__(self, heli: Vehicle, route: Route, callback: Callable[[Progress], None] | None) -> None:
        self.error: Exception | None = None
        self._heli = heli
        self._route = route
        self._callback = callback

    def report(self, t_s: float) -> None:
        """Report the progress of the route. An error of the callback is raised."""
        if self._callback is None:
            return
        piece = self._route.piece_at(t_s)
        self._call(t_s, LANDING if piece is None else piece.phase, self._route.duration_s - t_s)

    def report_landing(self, t_s: float) -> None:
        """Report the progress of the landing. An error of the callback is kept until the arm is down."""
        try:
            self._call(t_s, LANDING, None)
        except Exception as error:  # noqa: BLE001 - the caller's own callback may raise anything
            self.error, self._callback = error, None

    def _call(self, t_s: float, phase: str, left_s: float | None) -> None:
        # A board that has restarted has sent no sample yet.
        if self._callback is not None and self._heli.session.latest is not None:
            self._callback(Progress(t_s, left_s, phase, self._heli.latest, self._heli.session.counters))
