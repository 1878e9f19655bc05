"""A flight as arrays, and the checks that it must pass; see the README in this folder."""

from heli_host.data.flight.check import check
from heli_host.data.flight.flight import (
    ANGLE_COLUMNS,
    OWN_COLUMNS,
    REQUIRED_COLUMNS,
    SETPOINT_COLUMNS,
    STATUS_COLUMNS,
    Flight,
    FlightEvent,
)
from heli_host.data.views import broken_at_gaps, find_gaps

__all__ = [
    "ANGLE_COLUMNS",
    "OWN_COLUMNS",
    "REQUIRED_COLUMNS",
    "SETPOINT_COLUMNS",
    "STATUS_COLUMNS",
    "Flight",
    "FlightEvent",
    "broken_at_gaps",
    "check",
    "find_gaps",
]
