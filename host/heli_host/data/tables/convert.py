"""Conversion of a table to flights by a profile."""

from __future__ import annotations

import difflib
import itertools
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from heli_host.data.arrays import Booleans, Floats
from heli_host.data.flight import MIN_ROWS, Flight
from heli_host.data.tables.profile import MOTORS, Angle, Part, Profile, Voltage
from heli_host.data.tables.table import COUNT, TIME_UNITS, Table
from heli_host.errors import FlightDataError

UNEVEN = 0.02
"""Largest standard deviation of the time steps, as a share of the median step, with which the rows are used
unchanged. If steps vary more, the rows are interpolated to even times."""
TRAVEL = "travel"
WORD = 65536.0
"""Counts after which an encoder's counter of 16 bits starts again."""
MAX_MISSING = 5.0
"""Longest gap, in median steps, that is filled in. After a longer gap, another flight begins."""
_GAP_STEPS = 1.75
"""Step, in median steps, from which a row is missing: one missing row doubles the step, and clocks jitter."""
_JUMP_DEG = 8.0
_JUMP_DEG_S = 600.0
"""A step of an angle above both limits ends a flight, because the encoder was set to zero or two logs were
joined.

The limits were set by judgement: no such arm turns by 600 deg/s, and 8 deg is above the noise of every
encoder. Lower limits would cut fast logs at a lost row; higher limits would keep jumps, which no model
explains.
"""


@dataclass(frozen=True)
class _Rows:
    """Consecutive rows of a table, as a flight names its columns."""

    t_s: Floats  # (n,): Times
    angles_rad: dict[str, Floats]  # (n,): Angles and setpoints by the name of the column, such as `pitch_rad`
    voltages_V: dict[str, Floats]  # (n,): Voltages of the motors `front` and `back`

    def selected(self, rows: slice | Booleans) -> _Rows:
        """Return only some of the rows."""
        return _Rows(
            self.t_s[rows],
            {name: values[rows] for name, values in self.angles_rad.items()},
            {motor: volts[rows] for motor, volts in self.voltages_V.items()},
        )


def flights_of(table: Table, profile: Profile) -> list[Flight]:
    """Convert a table to flights: one, or several if gaps, jumps or the profile divide it."""
    table = table.aligned()
    rows = _read_rows(table, profile)
    if profile.mirrored:
        rows = _mirrored(rows)
    rows = _complete_rows(rows, table.source)
    if profile.act == "before":
        rows = _with_voltages_of_next_row(rows)
    part = profile.parts.get(Path(table.source).name, Part())
    jumps = _find_jumps(rows)
    flights = []
    for stretch in _usable_stretches(rows.t_s, part, [*jumps], table.source):
        recorded = rows.selected(stretch)
        even = _evenly_sampled(recorded)
        notes = _notes_of_file(table, part)
        if stretch.start in jumps:
            notes["cut"] = jumps[stretch.start]
        notes |= _gap_note(recorded.t_s, len(even.t_s))
        voltages_V = {f"{motor}_V": volts for motor, volts in even.voltages_V.items()}
        columns: dict[str, Any] = {**voltages_V, **even.angles_rad}
        flights.append(Flight(t_s=even.t_s, meta=notes, **columns))
    return flights


def _read_rows(table: Table, profile: Profile) -> _Rows:
    """Return times, angles, setpoints and voltages of all rows; values that the table lacks are nan."""
    t_s = times_of(table, profile)
    angles_rad = {
        f"{axis}{suffix}": _angle_rad_of(table, angle, t_s, axis == TRAVEL)
        for suffix, angles in (("_rad", profile.angles), ("_setpoint_rad", profile.setpoints))
        for axis, angle in angles.items()
    }
    voltages_V = {name: _voltage_V_of(table, voltage, t_s) for name, voltage in profile.voltages.items()}
    if "sum" in voltages_V:
        sum_V, difference_V = voltages_V["sum"], voltages_V["difference"]
        voltages_V = {"front": 0.5 * (sum_V + difference_V), "back": 0.5 * (sum_V - difference_V)}
    if profile.clip_V:
        voltages_V = {motor: np.clip(volts, *profile.clip_V) for motor, volts in voltages_V.items()}
    return _Rows(t_s, angles_rad, {motor: voltages_V[motor] for motor in MOTORS})


def _mirrored(rows: _Rows) -> _Rows:
    """Exchange the motors, and change the signs of pitch and travel."""
    return _Rows(
        rows.t_s,
        {
            name: values if name.startswith("elevation") else -values
            for name, values in rows.angles_rad.items()
        },
        {"front": rows.voltages_V["back"], "back": rows.voltages_V["front"]},
    )


def _complete_rows(rows: _Rows, source: str) -> _Rows:
    """Return the rows that have time, all angles and both voltages; a row that repeats a time is dropped.

    A time that falls begins another flight, see `_usable_stretches`.
    """
    columns = np.array([rows.t_s, *rows.angles_rad.values(), *rows.voltages_V.values()])
    complete = rows.selected(np.asarray(np.isfinite(columns).all(axis=0)))
    complete = complete.selected(np.diff(complete.t_s, prepend=np.nan) != 0.0)
    count = complete.t_s.size
    if count < MIN_ROWS:
        raise FlightDataError(
            f"{source}: only {count} rows with all of time, angles and voltages",
            "check the profile's columns",
        )
    return complete


def _with_voltages_of_next_row(rows: _Rows) -> _Rows:
    """Give each row the voltages of the next one, if the table has in each row those that acted until it."""
    return replace(
        rows,
        voltages_V={motor: np.append(volts[1:], volts[-1]) for motor, volts in rows.voltages_V.items()},
    )


def _notes_of_file(table: Table, part: Part) -> dict[str, str]:
    """Return the notes that all flights of a file have in common."""
    notes = {"imported from": Path(table.source).name}
    if part.group:
        notes["group"] = part.group
    if table.notes:
        notes["notes of the file"] = " / ".join(table.notes.split("\n"))
    return notes


def _find_jumps(rows: _Rows) -> dict[int, str]:
    """Return the rows at which an angle jumps farther than an arm can turn, with the reason as text."""
    t_s = rows.t_s
    limit_deg = np.maximum(_JUMP_DEG, _JUMP_DEG_S * np.diff(t_s))
    jumps: dict[int, str] = {}
    for name, values in rows.angles_rad.items():
        if name.endswith("_setpoint_rad"):
            continue
        steps_deg = np.degrees(np.diff(values))
        for row in np.flatnonzero(np.abs(steps_deg) > limit_deg):
            axis = name.removesuffix("_rad")
            jumps[int(row) + 1] = f"{axis} jumps by {steps_deg[row]:.1f} deg at {t_s[row + 1]:.3f} s"
    return jumps


def _gap_note(t_s: Floats, count: int) -> dict[str, str]:
    """Return a note about the missing rows that were filled in; empty if none was. Shapes: `t_s` (n,)."""
    steps_s = np.diff(t_s)
    step_s = float(np.median(steps_s))
    gaps = np.flatnonzero(steps_s >= _GAP_STEPS * step_s)
    if not gaps.size or count == t_s.size:
        return {}
    longest = gaps[np.argmax(steps_s[gaps])]
    return {
        "filled": f"{count - t_s.size} missing rows in {gaps.size} gaps, the longest "
        f"{steps_s[longest]:.3f} s at {t_s[longest]:.3f} s"
    }


def times_of(table: Table, profile: Profile) -> Floats:
    """Return the times of a table's rows in s, shape (n,).

    They keep the start of the file, except that large times, such as seconds since 1970, start at 0.
    """
    if not profile.time:
        return np.arange(len(table)) / profile.rate_Hz
    values = _values_of_column(table, profile.time)
    first = values[np.isfinite(values)][:1]
    is_epoch = first.size and abs(float(first[0])) * TIME_UNITS[profile.time_unit] > 1e5
    # A printed table would lose the microseconds of seconds since 1970.
    result: Floats = (values - (first[0] if is_epoch else 0.0)) * TIME_UNITS[profile.time_unit]
    return result


def _values_of_column(table: Table, name: str) -> Floats:
    """Return the values of a column; an error suggests a name that is similar."""
    if name not in table.columns:
        close = difflib.get_close_matches(name, table.columns, n=1)
        hint = f"did you mean '{close[0]}'? " if close else ""
        raise FlightDataError(
            f"{table.source}: unknown column '{name}'",
            f"{hint}it has {', '.join(list(table.columns)[:12])}",
        )
    return table.columns[name].values


def _angle_rad_of(table: Table, angle: Angle, t_s: Floats, turns_freely: bool) -> Floats:
    """Return an angle [rad], shape (n,), from its column: apply delay, unit, sign and offset, and unwrap it.
    Shapes: `t_s` (n,).
    """
    delay_free = _without_delay(_values_of_column(table, angle.column), t_s, angle.delay_s)
    is_known = np.isfinite(delay_free)
    angle_rad: Floats = np.full(delay_free.shape, np.nan)
    values = delay_free[is_known]
    if angle.unit == COUNT and values.size and float(np.abs(np.diff(values)).max(initial=0.0)) > 0.9 * WORD:
        # The 16-bit counter overflowed. Its first value counts as positive or negative, whichever is nearer
        # to 0.
        values = np.unwrap(values, period=WORD)
        values = values - WORD * np.round(values[0] / WORD)
    # No arm turns by half a turn between two rows, so such a jump means that the angle was wrapped.
    unwrapped_rad = np.unwrap(angle.sign * angle.rad * values)
    angle_rad[is_known] = unwrapped_rad + np.radians(angle.offset_deg)
    if not turns_freely and unwrapped_rad.size:
        # Elevation and pitch cannot turn all the way round, so whole turns come from the start of a counter.
        angle_rad[is_known] -= 2.0 * np.pi * np.round(np.median(angle_rad[is_known]) / (2.0 * np.pi))
    return angle_rad


def _voltage_V_of(table: Table, voltage: Voltage, t_s: Floats) -> Floats:
    """Return a voltage [V], shape (n,), from its column: apply delay, unit, sign and offset."""
    delay_free = _without_delay(_values_of_column(table, voltage.column), t_s, voltage.delay_s)
    result: Floats = voltage.sign * voltage.volts * delay_free + voltage.offset_V
    return result


def _without_delay(values: Floats, t_s: Floats, delay_s: float) -> Floats:
    """Shift a column by whole rows, because it was logged `delay_s` late; rows without a value become nan."""
    step_s = float(np.nanmedian(np.diff(t_s)))
    rows = round(delay_s / step_s) if step_s > 0.0 else 0
    if not rows:
        return values
    shifted = np.full(values.shape, np.nan)
    if rows > 0:
        shifted[:-rows] = values[rows:]
    else:
        shifted[-rows:] = values[:rows]
    return shifted


def _evenly_sampled(rows: _Rows) -> _Rows:
    """Resample rows to even times if their steps vary.

    Angles are interpolated linearly. A voltage holds its value until the next row.
    """
    t_s = rows.t_s
    steps_s = np.diff(t_s)
    step_s = float(np.median(steps_s))
    regular_steps_s = steps_s[steps_s < _GAP_STEPS * step_s]
    mean_s = float(regular_steps_s.mean())
    if len(regular_steps_s) == len(steps_s):
        if float(np.std(steps_s)) <= UNEVEN * step_s:
            return rows
        rounded_s = t_s[0] + mean_s * np.arange(t_s.size)
        # Times that were rounded, for example to whole milliseconds, count as even.
        if np.abs(t_s - rounded_s).max() < 1.5 * step_s:
            return replace(rows, t_s=rounded_s)
    even_s = t_s[0] + mean_s * np.arange(int((t_s[-1] - t_s[0]) / mean_s) + 1)
    last_row = np.clip(np.searchsorted(t_s, even_s + 1e-9, side="right") - 1, 0, None)
    return _Rows(
        even_s,
        {name: np.interp(even_s, t_s, values) for name, values in rows.angles_rad.items()},
        {motor: volts[last_row] for motor, volts in rows.voltages_V.items()},
    )


def _usable_stretches(t_s: Floats, part: Part, jumps: list[int], source: str) -> list[slice]:
    """Divide the rows at gaps, falling times and `jumps`, without the times that the profile excludes."""
    is_included = np.ones(t_s.size, bool)
    for start_s, stop_s in part.leave_out_s:
        is_included &= (t_s < start_s) | (t_s >= stop_s)
    steps_s = np.diff(t_s)
    breaks = np.flatnonzero((steps_s > MAX_MISSING * np.median(steps_s)) | (steps_s < 0.0)) + 1
    breaks = np.union1d(breaks, jumps)
    edges = np.flatnonzero(np.diff(np.concatenate(([0], is_included.astype(int), [0]))))
    stretches = [
        slice(int(first), int(after_last))
        for start, stop in zip(edges[::2], edges[1::2], strict=True)
        for first, after_last in itertools.pairwise(
            [start, *breaks[(breaks > start) & (breaks < stop)], stop]
        )
        if after_last - first >= MIN_ROWS
    ]
    if not stretches:
        raise FlightDataError(
            f"{source}: the profile leaves out all rows from {t_s[0]:g} to {t_s[-1]:g} s",
            "shorten leave_out_s in the profile",
        )
    return stretches
