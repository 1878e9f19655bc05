"""Checks of a finished flight against its rig, by other installed packages.

This package contains no models. A package that does offers a function in the entry-point group
``heli_host.flight_checks``, which takes a flight and the name or file of its rig and returns findings.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from heli_host.errors import HeliError
from heli_host.plugins import plugins

if TYPE_CHECKING:
    from heli_host.data.flight import Flight

ENTRY_POINT_GROUP: Final = "heli_host.flight_checks"


@dataclass(frozen=True)
class FlightFinding:
    """Something of a finished flight that contradicts its rig."""

    name: str  # Which number, such as ``travel_encoder_scale``
    value: float | None
    """value, standard_error: Its estimate from the flight; None if the check itself failed."""
    standard_error: float | None
    text: str  # For a person


FlightCheck = Callable[["Flight", str], Sequence[FlightFinding]]


def check_flight(flight: Flight, rig: str) -> tuple[FlightFinding, ...]:
    """Check a flight against its rig."""
    findings: list[FlightFinding] = []
    for entry in plugins(ENTRY_POINT_GROUP):
        # A check that cannot be made must not cost the summary of a flight.
        try:
            check: FlightCheck = entry.load()
            findings += check(flight, rig)
        except (HeliError, ArithmeticError, ValueError):
            continue
        except Exception as error:  # noqa: BLE001 - the check of another package may raise anything
            text = f"the check '{entry.name}' of {entry.value} failed: {type(error).__name__}: {error}"
            findings.append(FlightFinding(entry.name, None, None, text))
    return tuple(findings)
