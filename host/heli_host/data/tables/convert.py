"""Conversion of a table to flights by a profile."""

from __future__ import annotations

import difflib
import itertools
from pathlib import Path
from typing import Any

import numpy as np

from heli_host.data.arrays import Floats
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


def flights_of(table: Table, profile: Profile) -> list[Flight]:
    """Convert a table to flights: one, or several if gaps, jumps or the profile divide it."""
    table = table.aligned()
    t_s = times_of(table, profile)
    angles = {
        axis: _angle_rad_of(table, entry, t_s, axis == TRAVEL) for axis, entry in profile.angles.items()
    }
    setpoints = {
        axis: _angle_rad_of(table, entry, t_s, axis == TRAVEL) for axis, entry in profile.setpoints.items()
    }
    voltages = {name: _voltage_V_of(table, voltage, t_s) for name, voltage in profile.voltages.items()}
    if "sum" in voltages:
        total, difference = voltages["sum"], voltages["difference"]
        voltages = {"front": 0.5 * (total + difference), "back": 0.5 * (total - difference)}
    if profile.clip_V:
        voltages = {name: np.clip(volts, *profile.clip_V) for name, volts in voltages.items()}
    series = {f"{axis}_rad": values for axis, values in angles.items()}
    series |= {f"{axis}_setpoint_rad": values for axis, values in setpoints.items()}
    if profile.mirrored:
        voltages = {"front": voltages["back"], "back": voltages["front"]}
        series = {
            name: values if name.startswith("elevation") else -values for name, values in series.items()
        }
    voltage_columns = {f"{name}_V": voltages[name] for name in MOTORS}
    is_complete = np.isfinite(t_s)
    for values in (*series.values(), *voltage_columns.values()):
        is_complete &= np.isfinite(values)
    # A repeated time is a repeated row. A time that falls begins another flight, see `_usable_stretches`.
    is_complete[is_complete] &= (
        np.concatenate(([True], np.diff(t_s[is_complete]) != 0.0)) if is_complete.any() else True
    )
    if int(is_complete.sum()) < MIN_ROWS:
        raise FlightDataError(
            f"{table.source}: only {int(is_complete.sum())} rows with all of time, angles and voltages",
            "check the profile's columns",
        )
    t_s = t_s[is_complete]
    series = {name: values[is_complete] for name, values in series.items()}
    voltage_columns = {name: values[is_complete] for name, values in voltage_columns.items()}
    if profile.act == "before":
        voltage_columns = {
            name: np.concatenate((values[1:], values[-1:])) for name, values in voltage_columns.items()
        }
    part = profile.parts.get(Path(table.source).name, Part())
    notes = {"imported from": Path(table.source).name}
    if part.group:
        notes["group"] = part.group
    if table.notes:
        notes["notes of the file"] = " / ".join(table.notes.split("\n"))
    flights = []
    jumps = _find_jumps(t_s, series)
    for start, stop in _usable_stretches(t_s, part, [*jumps], table.source):
        even_s, even_series, even_voltages = _evenly_sampled(
            t_s[start:stop],
            {name: values[start:stop] for name, values in series.items()},
            {name: values[start:stop] for name, values in voltage_columns.items()},
        )
        columns: dict[str, Any] = {**even_voltages, **even_series}
        cut_note = {"cut": jumps[start]} if start in jumps else {}
        flights.append(
            Flight(
                t_s=even_s, meta={**notes, **cut_note, **_gap_note(t_s[start:stop], len(even_s))}, **columns
            )
        )
    return flights


def _find_jumps(t_s: Floats, series: dict[str, Floats]) -> dict[int, str]:
    """Return the rows at which an angle jumps farther than an arm can turn, with the reason as text."""
    limit_deg = np.maximum(_JUMP_DEG, _JUMP_DEG_S * np.diff(t_s))
    jumps: dict[int, str] = {}
    for name, values in series.items():
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


def _evenly_sampled(
    t_s: Floats, series: dict[str, Floats], voltage_columns: dict[str, Floats]
) -> tuple[Floats, dict[str, Floats], dict[str, Floats]]:
    """Resample rows to even times if their steps vary; return times, angles and voltages.

    Angles are interpolated linearly. A voltage holds its value until the next row.
    """
    steps_s = np.diff(t_s)
    step_s = float(np.median(steps_s))
    regular_steps_s = steps_s[steps_s < _GAP_STEPS * step_s]
    is_uneven = float(np.std(regular_steps_s)) > UNEVEN * step_s
    # Times that were rounded, for example to whole milliseconds, count as even.
    mean_s = float(regular_steps_s.mean())
    is_rounded = np.abs(t_s - t_s[0] - mean_s * np.arange(t_s.size)).max() < 1.5 * step_s
    if not is_uneven and len(regular_steps_s) == len(steps_s):
        return t_s, series, voltage_columns
    if is_rounded and len(regular_steps_s) == len(steps_s):
        return t_s[0] + mean_s * np.arange(t_s.size), series, voltage_columns
    step_s = mean_s
    even_s = t_s[0] + step_s * np.arange(int((t_s[-1] - t_s[0]) / step_s) + 1)
    last = np.clip(np.searchsorted(t_s, even_s + 1e-9, side="right") - 1, 0, None)
    return (
        even_s,
        {name: np.interp(even_s, t_s, values) for name, values in series.items()},
        {name: values[last] for name, values in voltage_columns.items()},
    )


def _usable_stretches(t_s: Floats, part: Part, jumps: list[int], source: str) -> list[tuple[int, int]]:
    """Divide the rows at gaps, falling times and `jumps`, without the times that the profile excludes.

    Returns the first row of each stretch, and the row after its last.
    """
    is_included = np.ones(t_s.size, bool)
    for start_s, stop_s in part.leave_out_s:
        is_included &= (t_s < start_s) | (t_s >= stop_s)
    steps_s = np.diff(t_s)
    breaks = np.flatnonzero((steps_s > MAX_MISSING * np.median(steps_s)) | (steps_s < 0.0)) + 1
    breaks = np.union1d(breaks, jumps)
    edges = np.flatnonzero(np.diff(np.concatenate(([0], is_included.astype(int), [0]))))
    stretches = [
        (int(first), int(after_last))
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
