"""A flight as arrays, and the checks that it must pass; see the README in this folder."""

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
