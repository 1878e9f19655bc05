"""Checks that a flight must pass before an analysis: long enough, finite, even in time, in SI units."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from heli_host.arrays import Floats
from heli_host.data.flight.flight import MIN_ROWS, Flight
from heli_host.data.views import find_gaps
from heli_host.declaration import AXES
from heli_host.errors import FlightDataError

_MAX_ANGLE_RAD = {"elevation_rad": 1.6, "pitch_rad": 3.2}
"""Largest possible angles: the arm cannot pass the vertical, and the short arm cannot turn over."""
_MAX_COUNT_RAD = 0.02
"""Largest plausible step of an encoder: 314 counts per turn. In degrees, even 16384 counts step by 0.022."""
_MIN_MOVES = 20
_MAX_RATE_RAD_S = 20.0
"""Over a tenth of a second, in one row of a hundred; the board's own limits are below 10."""
_MAX_VOLTAGE_V = 100.0
_MIN_ROWS_JOINED = 100
"""Rows before and after a fall of time from which it counts as the begin of another flight. Fewer: a single
bad time is taken for one. More: short flights that were joined are not recognised."""
_MAX_STEP_S = 0.5


def data_row(row: int) -> str:
    """Name a `row`, counted from 0, in a message."""
    return f"data row {row + 1}"


def check(
    flight: Flight, source: str, *, allow_gaps: bool = False, where: Callable[[int], str] = data_row
) -> None:
    """Refuse a flight that no analysis could trust."""
    if len(flight) < MIN_ROWS:
        raise FlightDataError(
            f"{source}: t_s has only {len(flight)} rows",
            f"record a flight of at least {MIN_ROWS} rows",
        )
    for name, column in flight.columns().items():
        if name in flight.extra or column.dtype.kind != "f":
            continue
        bad_rows = np.flatnonzero(~np.isfinite(column))
        if bad_rows.size:
            raise FlightDataError(
                f"{source}: {name} is {column[bad_rows[0]]} in {where(int(bad_rows[0]))} "
                f"({bad_rows.size} such rows)",
                "remove these rows, or the part of the flight around them",
            )
    # Differences of huge numbers overflow to infinity; the checks then refuse them as too large.
    with np.errstate(over="ignore", invalid="ignore"):
        _check_time(flight.t_s, source, allow_gaps, where)
        _check_units(flight, source, where)


def _check_time(t_s: Floats, source: str, allow_gaps: bool, where: Callable[[int], str]) -> None:
    """Refuse times that do not increase, are in another unit than seconds, or have gaps. `where` names a row
    of the file.
    """
    step_s = np.diff(t_s)
    falling_rows = np.flatnonzero(step_s <= 0.0)
    if falling_rows.size:
        row = int(falling_rows[0]) + 1
        begins_again = len(falling_rows) == 1 and t_s[row] - t_s[0] < 0.5 * (t_s[row - 1] - t_s[0])
        if begins_again and min(row, len(t_s) - row) >= _MIN_ROWS_JOINED:
            raise FlightDataError(
                f"{source} holds two flights that were joined: t_s falls from {t_s[row - 1]:.9g} to "
                f"{t_s[row]:.9g} s in {where(row)}",
                "give each flight as a file of its own",
            )
        raise FlightDataError(
            f"{source}: t_s does not increase in {where(row)}: {t_s[row]:.9g} after {t_s[row - 1]:.9g} s",
            "sort the rows by time, and remove duplicates",
        )
    typical_s = float(np.median(step_s))
    if typical_s > _MAX_STEP_S:
        raise FlightDataError(
            f"{source}: t_s increases by {typical_s:g} per row, as in {where(1)}, which looks like "
            "milliseconds or samples",
            "give t_s in seconds",
        )
    gaps = find_gaps(t_s)
    if gaps.size and not allow_gaps:
        row = int(gaps[0]) + 1
        raise FlightDataError(
            f"{source}: t_s jumps by {step_s[row - 1]:.6g} s in {where(row)}, a step is "
            f"{typical_s:.6g} s ({gaps.size} gaps)",
            "cut the flight there, or skip the missing rows by --allow-gaps (in Python allow_gaps=True)",
        )


def _check_units(flight: Flight, source: str, where: Callable[[int], str]) -> None:
    """Refuse angles that are probably in degrees, by their size, rate or encoder step, and voltages that are
    probably not in volts. `where` names a row of the file.
    """
    degrees = "looks like degrees", "multiply the angles by pi/180"
    for name, max_angle_rad in _MAX_ANGLE_RAD.items():
        column = getattr(flight, name)
        row = int(np.argmax(np.abs(column)))
        if abs(column[row]) > max_angle_rad:
            raise FlightDataError(
                f"{source}: {name} is {column[row]:.4g} in {where(row)}, which {degrees[0]}", degrees[1]
            )
        row, rate_rad_s = _rate_exceeded_by_1_percent(column, flight.step_s)
        if rate_rad_s > _MAX_RATE_RAD_S:
            raise FlightDataError(
                f"{source}: {name} moves by {rate_rad_s:.3g} per second in {where(row)}, which {degrees[0]}",
                degrees[1],
            )
    for name in (f"{axis}_rad" for axis in AXES):
        moves = np.abs(np.diff(getattr(flight, name)))
        rows = np.flatnonzero(moves > 0.0)
        if rows.size >= _MIN_MOVES and float(moves[rows].min()) > _MAX_COUNT_RAD:
            raise FlightDataError(
                f"{source}: {name} moves in steps of {moves[rows].min():.4g} (the first in "
                f"{where(int(rows[0]) + 1)}), which {degrees[0]}",
                degrees[1],
            )
    for name in ("front_V", "back_V"):
        column = getattr(flight, name)
        row = int(np.argmax(np.abs(column)))
        if abs(column[row]) > _MAX_VOLTAGE_V:
            raise FlightDataError(
                f"{source}: {name} is {column[row]:.4g} in {where(row)}, which looks like millivolts or a "
                "duty",
                "give volts",
            )


def _rate_exceeded_by_1_percent(angle_rad: Floats, step_s: float) -> tuple[int, float]:
    """Return the rate over 0.1 s that only one row in a hundred exceeds, and a row with this rate."""
    reach = max(1, round(0.1 / step_s))
    if angle_rad.size <= reach:
        return 0, 0.0
    rates = np.abs(angle_rad[reach:] - angle_rad[:-reach]) / (reach * step_s)
    rank = int(0.99 * (rates.size - 1))
    row = int(np.argpartition(rates, rank)[rank])
    return row, float(rates[row])
