"""A flight as arrays: what every later analysis starts from.

This module and what it imports know nothing of ports, boards or sessions, so that programs which only study
flights (identification, reports) may import it alone.

Convention of time: row ``k`` holds the angles read at ``t_s[k]`` and the voltages that act from ``t_s[k]``
until ``t_s[k + 1]``. The board's telemetry has the same order: in one tick it reads the counts, then computes
the voltages that it holds until the next.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heli_host.errors import FlightDataError

Floats = NDArray[np.float64]
Bytes = NDArray[np.uint8]

REQUIRED_COLUMNS = ("t_s", "front_V", "back_V", "elevation_rad", "pitch_rad", "travel_rad")
"""Columns that a flight cannot do without, in the order in which they are written."""

SETPOINT_COLUMNS = ("elevation_setpoint_rad", "pitch_setpoint_rad", "travel_setpoint_rad")
STATUS_COLUMNS = ("state", "fault", "flags")

MIN_ROWS = 10
"""Fewer rows than this are no flight."""

_MAX_ANGLE_RAD = {"elevation_rad": 1.6, "pitch_rad": 3.2}
"""No arm stands higher than upright, and no short arm turns over; travel may turn many times."""
_MAX_COUNT_RAD = 0.02
"""An encoder with fewer than 314 counts a turn is none; in degrees, 16384 counts are steps of 0.022."""
_LEAST_MOVES = 20
_MAX_RATE_RAD_S = 20.0
"""Over a tenth of a second, in one row of a hundred; the board's own limits are below 10."""
_MAX_VOLTAGE_V = 100.0
_MAX_STEP_S = 0.5
_GAP_RATIO = 1.75


@dataclass(frozen=True)
class FlightEvent:
    """Something that happened in a flight.

    Parameters
    ----------
    t_s : float
        When, on the flight's time axis.
    name : str
        Kind of event: ``state``, ``fault``, ``setpoint_stale``, ``plan``, ``link`` ...
    text : str
        What happened and why, for a person.
    """

    t_s: float
    name: str
    text: str


@dataclass(frozen=True)
class Flight:
    """One flight, evenly sampled, with time first.

    Parameters
    ----------
    t_s : ndarray (n,)
        Time of each row in seconds; strictly rising.
    front_V, back_V : ndarray (n,)
        Motor voltages that act from ``t_s[k]`` until ``t_s[k + 1]``.
    elevation_rad, pitch_rad, travel_rad : ndarray (n,)
        Angles read at ``t_s[k]``. Level is 0; elevation is positive upwards, pitch when the front rotor is
        up, and travel accelerates positive at positive pitch.
    elevation_setpoint_rad, pitch_setpoint_rad, travel_setpoint_rad : ndarray (n,) or None
        Setpoints that the control law used; None when the file has none.
    state, fault, flags : ndarray of uint8 (n,) or None
        The board's supervisor state, fault code and flag bits; None when the file has none.
    state_names, fault_names : Mapping[int, str]
        Names of these numbers, as declared by the board that flew.
    events : tuple of FlightEvent
        In order of time.
    parameters : Mapping[str, float]
        The board's parameters during the flight; empty when unknown.
    plan : str
        Text of the flight plans that were flown; empty when unknown.
    extra : Mapping[str, ndarray (n,)]
        Further columns of a table, by name.
    meta : Mapping[str, str]
        Where the flight comes from: rig, versions, counters, and the notes of its file.

    Raises
    ------
    FlightDataError
        If the arrays differ in length.
    """

    t_s: Floats
    front_V: Floats
    back_V: Floats
    elevation_rad: Floats
    pitch_rad: Floats
    travel_rad: Floats
    elevation_setpoint_rad: Floats | None = None
    pitch_setpoint_rad: Floats | None = None
    travel_setpoint_rad: Floats | None = None
    state: Bytes | None = None
    fault: Bytes | None = None
    flags: Bytes | None = None
    state_names: Mapping[int, str] = field(default_factory=dict)
    fault_names: Mapping[int, str] = field(default_factory=dict)
    events: tuple[FlightEvent, ...] = ()
    parameters: Mapping[str, float] = field(default_factory=dict)
    plan: str = ""
    extra: Mapping[str, Floats] = field(default_factory=dict)
    meta: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, column in self.columns().items():
            if column.shape != self.t_s.shape or column.ndim != 1:
                raise FlightDataError(
                    f"column {name} has shape {column.shape}, t_s has {self.t_s.shape}",
                    "give every column one value a row",
                )

    def __len__(self) -> int:
        return int(self.t_s.size)

    @property
    def duration_s(self) -> float:
        """Time from the first row to the last, in seconds."""
        return float(self.t_s[-1] - self.t_s[0]) if len(self) else 0.0

    @property
    def step_s(self) -> float:
        """Time from one row to the next (median), in seconds."""
        return float(np.median(np.diff(self.t_s))) if len(self) > 1 else 0.0

    @property
    def angles_rad(self) -> Floats:
        """Elevation, pitch and travel side by side, shape (n, 3)."""
        return np.column_stack((self.elevation_rad, self.pitch_rad, self.travel_rad))

    @property
    def setpoints_rad(self) -> Floats | None:
        """Setpoints of elevation, pitch and travel side by side, shape (n, 3); None when there are none."""
        columns = (self.elevation_setpoint_rad, self.pitch_setpoint_rad, self.travel_setpoint_rad)
        known = [column for column in columns if column is not None]
        return np.column_stack(known) if len(known) == len(columns) else None

    @property
    def voltages_V(self) -> Floats:
        """Front and back voltage side by side, shape (n, 2)."""
        return np.column_stack((self.front_V, self.back_V))

    @property
    def gaps(self) -> NDArray[np.intp]:
        """Rows after which time is missing, shape (g,); empty for a flight without losses."""
        return find_gaps(self.t_s)

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return every column that the flight has, by name, required ones first."""
        named: dict[str, NDArray[Any]] = {name: getattr(self, name) for name in REQUIRED_COLUMNS}
        for name in SETPOINT_COLUMNS + STATUS_COLUMNS:
            column = getattr(self, name)
            if column is not None:
                named[name] = column
        named.update(self.extra)
        return named

    def between(self, start_s: float, stop_s: float) -> Flight:
        """Cut a part out, for example without take-off and landing.

        Parameters
        ----------
        start_s, stop_s : float
            First time kept and first time no longer kept, on this flight's axis; the axis itself does not
            change.

        Returns
        -------
        Flight
            The rows with ``start_s <= t_s < stop_s`` and the events among them.

        Raises
        ------
        FlightDataError
            If fewer rows than a flight needs are left.
        """
        keep = (self.t_s >= start_s) & (self.t_s < stop_s)
        if int(keep.sum()) < MIN_ROWS:
            raise FlightDataError(
                f"only {int(keep.sum())} rows between {start_s:g} and {stop_s:g} s",
                f"this flight spans {self.t_s[0]:g} to {self.t_s[-1]:g} s"
                if len(self)
                else "the flight is empty",
            )
        own = set(REQUIRED_COLUMNS + SETPOINT_COLUMNS + STATUS_COLUMNS)
        cut: dict[str, Any] = {name: column[keep] for name, column in self.columns().items() if name in own}
        return replace(
            self,
            **cut,
            extra={name: column[keep] for name, column in self.extra.items()},
            events=tuple(event for event in self.events if start_s <= event.t_s < stop_s),
        )

    @staticmethod
    def read(path: str | Path, *, allow_gaps: bool = False) -> Flight:
        """Read a log or a table.

        Parameters
        ----------
        path : str or Path
            ``.mcap`` (this package's logs, complete or cut short), ``.csv`` or ``.csv.gz`` (at least the
            columns ``t_s, front_V, back_V, elevation_rad, pitch_rad, travel_rad``; lines that start with
            ``#`` are notes).
        allow_gaps : bool
            Accept rows that are missing in between; `Flight.gaps` then tells where.

        Returns
        -------
        Flight

        Raises
        ------
        FlightDataError
            If the table lacks a column, holds something that is not a number, does not rise in time, has a
            gap, is in degrees or milliseconds, or is too short. The message names the file, the column and
            the row.
        LogError
            If the log is not one of this package, or nothing of it can be read.
        """
        path = Path(path)
        name = path.name.lower()
        if name.endswith(".mcap"):
            from heli_host.log.reader import read_log

            flight = read_log(path).flight()
            check(flight, str(path), allow_gaps=allow_gaps)
            return flight
        if name.endswith((".csv", ".csv.gz")):
            from heli_host.log.table import read_csv

            return read_csv(path, allow_gaps=allow_gaps)
        raise FlightDataError(f"{path}: not a flight file", "give a .mcap, .csv or .csv.gz file")

    def write_csv(self, path: str | Path) -> None:
        """Write the flight as a table that `read` takes back.

        Parameters
        ----------
        path : str or Path
            File to write; compressed when it ends in ``.gz``. Notes, parameters, plan and events go into
            ``#`` lines.

        Raises
        ------
        LogWriteError
            If the file cannot be written.
        """
        from heli_host.log.table import write_csv

        write_csv(self, Path(path))


def find_gaps(t_s: Floats) -> NDArray[np.intp]:
    """Return the rows after which time is missing.

    Parameters
    ----------
    t_s : ndarray (n,)
        Rising times in seconds.

    Returns
    -------
    ndarray (g,)
        Row ``k`` is listed when ``t_s[k + 1] - t_s[k]`` exceeds 1.75 median steps.
    """
    if t_s.size < 3:
        return np.zeros(0, np.intp)
    step_s = np.diff(t_s)
    return np.flatnonzero(step_s > _GAP_RATIO * float(np.median(step_s)))


def data_row(row: int) -> str:
    """Name a row in a message.

    Parameters
    ----------
    row : int
        Row, counted from 0.

    Returns
    -------
    str
        ``"data row 1"`` for row 0.
    """
    return f"data row {row + 1}"


def check(
    flight: Flight, source: str, *, allow_gaps: bool = False, where: Callable[[int], str] = data_row
) -> None:
    """Refuse a flight that no analysis could trust.

    Parameters
    ----------
    flight : Flight
        The flight to check.
    source : str
        File name for the message.
    allow_gaps : bool
        Accept missing rows.
    where : callable
        Names a row, counted from 0, in a message.

    Raises
    ------
    FlightDataError
        If it is too short, not finite, not rising in time, has gaps, or is in other units.
    """
    if len(flight) < MIN_ROWS:
        raise FlightDataError(
            f"{source}: t_s has only {len(flight)} rows",
            f"a flight needs at least {MIN_ROWS}; record a longer one",
        )
    for name, column in flight.columns().items():
        if name in flight.extra or column.dtype.kind != "f":
            continue
        bad = np.flatnonzero(~np.isfinite(column))
        if bad.size:
            raise FlightDataError(
                f"{source}: {name} is {column[bad[0]]} in {where(int(bad[0]))} ({bad.size} such rows)",
                "remove these rows, or the part of the flight around them",
            )
    _check_time(flight.t_s, source, allow_gaps, where)
    _check_units(flight, source, where)


def _check_time(t_s: Floats, source: str, allow_gaps: bool, where: Callable[[int], str]) -> None:
    step_s = np.diff(t_s)
    back = np.flatnonzero(step_s <= 0.0)
    if back.size:
        row = int(back[0]) + 1
        raise FlightDataError(
            f"{source}: t_s does not rise in {where(row)}: {t_s[row]:.9g} after {t_s[row - 1]:.9g} s",
            "sort the rows by time and remove doubled ones",
        )
    typical_s = float(np.median(step_s))
    if typical_s > _MAX_STEP_S:
        raise FlightDataError(
            f"{source}: t_s rises by {typical_s:g} a row, as in {where(1)}, which looks like milliseconds or "
            "samples",
            "give t_s in seconds",
        )
    gaps = find_gaps(t_s)
    if gaps.size and not allow_gaps:
        row = int(gaps[0]) + 1
        raise FlightDataError(
            f"{source}: t_s jumps by {step_s[row - 1]:.6g} s in {where(row)}, a step is "
            f"{typical_s:.6g} s ({gaps.size} gaps)",
            "cut the flight there, or read it with allow_gaps=True",
        )


def _check_units(flight: Flight, source: str, where: Callable[[int], str]) -> None:
    degrees = "looks like degrees", "multiply the angles by pi/180"
    for name, most in _MAX_ANGLE_RAD.items():
        column = getattr(flight, name)
        row = int(np.argmax(np.abs(column)))
        if abs(column[row]) > most:
            raise FlightDataError(
                f"{source}: {name} is {column[row]:.4g} in {where(row)}, which {degrees[0]}", degrees[1]
            )
        row, rate_rad_s = _usual_highest_rate(column, flight.step_s)
        if rate_rad_s > _MAX_RATE_RAD_S:
            raise FlightDataError(
                f"{source}: {name} moves by {rate_rad_s:.3g} a second in {where(row)}, which {degrees[0]}",
                degrees[1],
            )
    for name in ("elevation_rad", "pitch_rad", "travel_rad"):
        moves = np.abs(np.diff(getattr(flight, name)))
        rows = np.flatnonzero(moves > 0.0)
        if rows.size >= _LEAST_MOVES and float(moves[rows].min()) > _MAX_COUNT_RAD:
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


def _usual_highest_rate(angle_rad: Floats, step_s: float) -> tuple[int, float]:
    """A row and the rate there over a tenth of a second that one row in a hundred exceeds."""
    reach = max(1, round(0.1 / step_s))
    if angle_rad.size <= reach:
        return 0, 0.0
    rates = np.abs(angle_rad[reach:] - angle_rad[:-reach]) / (reach * step_s)
    rank = int(0.99 * (rates.size - 1))
    row = int(np.argpartition(rates, rank)[rank])
    return row, float(rates[row])
