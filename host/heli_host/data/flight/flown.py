"""Selection of the rows of a flight in which a control law flew, or in which an axis followed a setpoint."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from heli_host.arrays import Booleans
from heli_host.data.flight.flight import MIN_ROWS, Flight
from heli_host.declaration import Flags
from heli_host.errors import FlightDataError

PHASE_EVENT: Final = "phase"
"""Name of the events with which a flight marks its phases."""
TAKE_OFF: Final = "take-off"
LANDING: Final = "landing"
"""Phases around the plans."""
_OWN: Final = "closed_loop"
_STREAMED: Final = "streamed"
# A tenth of an encoder's count, far above the rounding of a setpoint in the log.
_TOLD_rad: Final = 1.5e-4


def flown_rows(flight: Flight) -> Booleans:
    """Return the rows in which a control law flew: the board's own, an uploaded law, or the host's. Returns
    shape (n,).

    If the flight marks its phases, only rows after the take-off and before the landing count.
    """
    rows = np.ones(len(flight), np.bool_)
    if flight.state is not None:
        rows = _rows_in_state(flight, _OWN) | _rows_in_state(flight, _STREAMED)
    phases = [event for event in flight.events if event.name == PHASE_EVENT]
    flown_s = [event.t_s for event in phases if event.text not in (TAKE_OFF, LANDING)]
    if phases:
        rows &= flight.t_s >= (flown_s[0] if flown_s else np.inf)
    landing_s = [event.t_s for event in phases if event.text == LANDING]
    if landing_s:
        rows &= flight.t_s < landing_s[0]
    return rows


def led_rows(flight: Flight, axis: str) -> Booleans:
    """Return the rows of `flown_rows` in which an axis followed a setpoint. Returns shape (n,).

    Some control laws have no setpoint for an axis, on the host or on the board. The log then contains the
    measured angle as the setpoint. Such rows are left out, because their error of zero means nothing.
    """
    rows = flown_rows(flight)
    setpoint_rad = getattr(flight, f"{axis}_setpoint_rad")
    if setpoint_rad is None:
        return np.zeros(len(flight), np.bool_)
    apart_rad = np.abs(getattr(flight, f"{axis}_rad") - setpoint_rad)
    for rows_of_other_law in (_rows_in_state(flight, _STREAMED), _rows_of_uploaded_law(flight)):
        if rows_of_other_law.any() and apart_rad[rows_of_other_law].max() <= _TOLD_rad:
            rows = rows & ~rows_of_other_law
    return rows


def of_its_law(flight: Flight) -> Flight:
    """Cut a flight to the rows in which an uploaded law flew; if none flew, to the rows of `flown_rows`."""
    is_flown = _rows_of_uploaded_law(flight)
    if not is_flown.any():
        is_flown = flown_rows(flight)
    rows = np.flatnonzero(is_flown)
    if rows.size < MIN_ROWS:
        raise FlightDataError("the log contains no flight of a control law", "give a flight under setpoints")
    cut = flight.between(float(flight.t_s[rows[0]]), float(flight.t_s[rows[-1]]))
    return replace(cut, events=tuple(event for event in cut.events if event.name != PHASE_EVENT))


def _rows_in_state(flight: Flight, name: str) -> Booleans:
    numbers = [number for number, known in flight.state_names.items() if known == name]
    return np.zeros(len(flight), np.bool_) if flight.state is None else np.isin(flight.state, numbers)


def _rows_of_uploaded_law(flight: Flight) -> Booleans:
    if flight.flags is None:
        return np.zeros(len(flight), np.bool_)
    return np.asarray(flight.flags & Flags.LAW, np.bool_)
