"""The rows of a log during which a law flew: flights of different laws are compared on these rows."""

from __future__ import annotations

from pathlib import Path

from heli_host.errors import FlightDataError
from heli_host.flight import Flight
from heli_host.flight.flown import of_its_law
from heli_host.log.flight_file import read_flight


def flight_of_law(path: Path) -> Flight:
    """Read a log and cut it to what a law flew: one that came over the link where one did, else the host's or
    the board's own.

    Parameters
    ----------
    path : Path
        Log or table of a flight with setpoints.

    Raises
    ------
    FlightDataError
        No law flew in it, or nothing led it.
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
