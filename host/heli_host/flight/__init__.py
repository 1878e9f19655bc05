"""A flight as arrays, and what makes one trustworthy; see the README beside this file."""

from heli_host.flight.check import check
from heli_host.flight.flight import (
    ANGLE_COLUMNS,
    OWN_COLUMNS,
    REQUIRED_COLUMNS,
    SETPOINT_COLUMNS,
    STATUS_COLUMNS,
    Flight,
    FlightEvent,
    find_gaps,
)

__all__ = [
    "ANGLE_COLUMNS",
    "OWN_COLUMNS",
    "REQUIRED_COLUMNS",
    "SETPOINT_COLUMNS",
    "STATUS_COLUMNS",
    "Flight",
    "FlightEvent",
    "check",
    "find_gaps",
]
