"""Cut a log to the rows that a control law flew, so that flights of different laws can be compared."""

from __future__ import annotations

from pathlib import Path

from heli_host.data.flight import Flight
from heli_host.data.log.reader import read_flight
from heli_host.data.response import of_its_law
from heli_host.errors import FlightDataError


def flight_of_law(path: Path) -> Flight:
    """Read a log, and cut it to the rows that a control law flew.

    A law that was uploaded over the link has priority; otherwise, the rows of a controller on the host or of
    the board's own control law are returned.
    """
    flight = read_flight(path, allow_gaps=True)
    if flight.setpoints_rad is None:
        raise FlightDataError(
            f"{path} contains no flight with setpoints", "give a log of a flight with a control law"
        )
    try:
        return of_its_law(flight)
    except FlightDataError as error:
        raise FlightDataError(f"{path}: {error.cause}", error.remedy) from error
