"""A flight as arrays: the input of every analysis.

This package imports no module for ports, boards, sessions or files. Therefore programs that only analyse
flights (identification, reports) may import it alone. `heli_host.data.log` reads and writes flights.

Convention of time: row ``k`` holds the angles read at ``t_s[k]`` and the voltages that act from ``t_s[k]``
until ``t_s[k + 1]``. The board's telemetry has the same order: in one tick it reads the counts, then computes
the voltages that it holds until the next.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heli_host.arrays import Floats
from heli_host.data.views import AngleViews, find_gaps, shares
from heli_host.declaration import AXES
from heli_host.errors import FlightDataError

Bytes = NDArray[np.uint8]

ANGLE_COLUMNS = tuple(f"{axis}_rad" for axis in AXES)
REQUIRED_COLUMNS = ("t_s", "front_V", "back_V", *ANGLE_COLUMNS)
"""Columns that a flight cannot do without, in the order in which they are written."""

SETPOINT_COLUMNS = tuple(f"{axis}_setpoint_rad" for axis in AXES)
STATUS_COLUMNS = ("state", "fault", "flags")
OWN_COLUMNS = (*REQUIRED_COLUMNS, *SETPOINT_COLUMNS, *STATUS_COLUMNS)
"""Columns that are attributes of a flight; all others are in its ``extra``."""

MIN_ROWS = 10
"""Fewer rows than this are no flight."""


@dataclass(frozen=True)
class FlightEvent:
    """Something that happened in a flight."""

    t_s: float  # When, on the flight's time axis
    name: str  # Kind of event: ``state``, ``fault``, ``setpoint_stale``, ``plan``, ``link`` ..
    text: str  # Description of the event and its cause, in words


@dataclass(frozen=True, repr=False)
class Flight(AngleViews):
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
    parameters : Mapping[str, float]
        The board's parameters during the flight; empty when unknown.
    plan : str
        Text of the flight plans that were flown; empty when unknown.
    extra : Mapping[str, ndarray (n,)]
        Further columns of a table, or channels of a log, by name.
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
                    "give every column one value per row",
                )

    def __len__(self) -> int:
        return int(self.t_s.size)

    def __repr__(self) -> str:
        if not len(self):
            return "<Flight: no rows>"
        rate_Hz = 1.0 / self.step_s if self.step_s else 0.0
        parts = [f"{self.duration_s:.1f} s, {len(self)} rows at {rate_Hz:.4g} Hz"]
        parts += [f"{len(self.gaps)} gaps"] if len(self.gaps) else []
        parts += [f"rig {self.meta['rig']}"] if self.meta.get("rig") else []
        parts += [shares(self.state, self.state_names)] if self.state is not None else []
        return f"<Flight: {'; '.join(parts)}>"

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
        """Elevation, pitch and travel side by side, shape (n, axes)."""
        return np.column_stack([getattr(self, name) for name in ANGLE_COLUMNS])

    @property
    def setpoints_rad(self) -> Floats | None:
        """Setpoints side by side as in `angles_rad`, shape (n, axes); None when there are none."""
        columns = [getattr(self, name) for name in SETPOINT_COLUMNS]
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
        """Cut out the rows with ``start_s <= t_s < stop_s`` and the events among them, for example without
        take-off and landing.

        Parameters
        ----------
        start_s, stop_s : float
            First time kept and first time no longer kept, on this flight's axis; the axis itself does not
            change.

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
        named = self.columns().items()
        cut: dict[str, Any] = {name: column[keep] for name, column in named if name in OWN_COLUMNS}
        return replace(
            self,
            **cut,
            extra={name: column[keep] for name, column in self.extra.items()},
            events=tuple(event for event in self.events if start_s <= event.t_s < stop_s),
        )
