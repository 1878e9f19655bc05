"""Conversion of a table to flights by a profile."""

from __future__ import annotations

import difflib
import itertools
from pathlib import Path
from typing import Any

import numpy as np

from heli_host.arrays import Floats
from heli_host.errors import FlightDataError
from heli_host.flight import Flight
from heli_host.flight.flight import MIN_ROWS
from heli_host.tables.profile import MOTORS, Angle, Part, Profile, Voltage
from heli_host.tables.table import Table
from heli_host.tables.units import COUNT, TIME_UNITS

UNEVEN = 0.02
"""Share of the median step by which steps may vary, as a standard deviation, before rows are brought to even
times. Beyond, encoders' counts are interpolated; below, nothing is changed."""
TRAVEL = "travel"
WORD = 65536.0
"""Counts after which an encoder's counter of 16 bits begins again."""
MAX_MISSING = 5.0
"""Steps without a row beyond which a flight ends and another begins; fewer missing rows are filled in."""
_GAP_STEPS = 1.75
"""Step in median steps from which rows are missing: one missing row doubles the step, and clocks jitter."""
_JUMP_DEG = 8.0
_JUMP_DEG_S = 600.0
"""A step of an angle above both limits ends a flight: the encoder was set to zero, or two logs were
joined. Set by
judgement: no such arm turns by 600 deg/s, and 8 deg is above the noise of every encoder. Lower limits cut
fast logs at a lost row; higher ones keep the jump, which no model explains."""


def flights_of(table: Table, profile: Profile) -> list[Flight]:
    """Make flights of a table: one, or several where the profile leaves something in the middle out.

    Raises
    ------
    FlightDataError
        When a column is missing, or too little is left.
    """
    table = table.aligned()
    t_s = times_of(table, profile)
    angles = {axis: _angle(table, entry, t_s, axis == TRAVEL) for axis, entry in profile.angles.items()}
    setpoints = {axis: _angle(table, entry, t_s, axis == TRAVEL) for axis, entry in profile.setpoints.items()}
    voltages = {name: _voltage(table, voltage, t_s) for name, voltage in profile.voltages.items()}
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
    held = {f"{name}_V": voltages[name] for name in MOTORS}
    keep = np.isfinite(t_s)
    for values in (*series.values(), *held.values()):
        keep &= np.isfinite(values)
    # A time twice is a row twice; a time that falls begins another flight.
    keep[keep] &= np.concatenate(([True], np.diff(t_s[keep]) != 0.0)) if keep.any() else True
    if int(keep.sum()) < MIN_ROWS:
        raise FlightDataError(
            f"{table.source}: only {int(keep.sum())} rows with all of time, angles and voltages",
            "check the profile's columns",
        )
    t_s = t_s[keep]
    series = {name: values[keep] for name, values in series.items()}
    held = {name: values[keep] for name, values in held.items()}
    if profile.act == "before":
        held = {name: np.concatenate((values[1:], values[-1:])) for name, values in held.items()}
    part = profile.parts.get(Path(table.source).name, Part())
    notes = {"imported from": Path(table.source).name}
    if part.group:
        notes["group"] = part.group
    if table.notes:
        notes["notes of the file"] = " / ".join(table.notes.split("\n"))
    flights = []
    jumps = _jumps(t_s, series)
    for start, stop in _pieces(t_s, part, [*jumps], table.source):
        even_s, even, even_held = _even(
            t_s[start:stop],
            {name: values[start:stop] for name, values in series.items()},
            {name: values[start:stop] for name, values in held.items()},
        )
        named: dict[str, Any] = {**even_held, **even}
        why = {"cut": jumps[start]} if start in jumps else {}
        flights.append(
            Flight(t_s=even_s, meta={**notes, **why, **_filled(t_s[start:stop], len(even_s))}, **named)
        )
    return flights


def _jumps(t_s: Floats, series: dict[str, Floats]) -> dict[int, str]:
    """Rows at which an angle jumps further than an arm can turn, with the reason in words."""
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


def _filled(t_s: Floats, count: int) -> dict[str, str]:
    """Note of the rows that were filled in, if there are any."""
    steps_s = np.diff(t_s)
    step_s = float(np.median(steps_s))
    gaps = np.flatnonzero(steps_s >= _GAP_STEPS * step_s)
    if not gaps.size or count == t_s.size:
        return {}
    widest = gaps[np.argmax(steps_s[gaps])]
    return {
        "filled": f"{count - t_s.size} missing rows in {gaps.size} gaps, the longest "
        f"{steps_s[widest]:.3f} s at {t_s[widest]:.3f} s"
    }


def times_of(table: Table, profile: Profile) -> Floats:
    """Times of a table's rows, s, shape (n,); they begin at what the file says, less whole days."""
    if not profile.time:
        return np.arange(len(table)) / profile.rate_Hz
    values = _column(table, profile.time)
    first = values[np.isfinite(values)][:1]
    far = first.size and abs(float(first[0])) * TIME_UNITS[profile.time_unit] > 1e5
    # Seconds since 1970 would lose microseconds in a printed table.
    result: Floats = (values - (first[0] if far else 0.0)) * TIME_UNITS[profile.time_unit]
    return result


def _column(table: Table, name: str) -> Floats:
    """Return the values of a column; an error suggests a name that is similar."""
    if name not in table.columns:
        close = difflib.get_close_matches(name, table.columns, n=1)
        hint = f"did you mean '{close[0]}'? " if close else ""
        raise FlightDataError(
            f"{table.source}: unknown column '{name}'",
            f"{hint}it has {', '.join(list(table.columns)[:12])}",
        )
    return table.columns[name].values


def _angle(table: Table, angle: Angle, t_s: Floats, travels: bool) -> Floats:
    """Return an angle [rad], shape (n,), from its column: unit, sign, offset, wrapped words and turns. Only
    an axis that `travels` may turn all the way round.
    """
    raw = _earlier(_column(table, angle.column), t_s, angle.delay_s)
    known = np.isfinite(raw)
    turned: Floats = np.full(raw.shape, np.nan)
    values = raw[known]
    if angle.unit == COUNT and values.size and float(np.abs(np.diff(values)).max(initial=0.0)) > 0.9 * WORD:
        # A word of 16 bits that ran over. Its first value is one of either sign, whichever is nearer to 0.
        values = np.unwrap(values, period=WORD)
        values = values - WORD * np.round(values[0] / WORD)
    # No arm turns by half a turn between two rows: such a jump is an angle that was wrapped.
    rad = np.unwrap(angle.sign * angle.rad * values)
    turned[known] = rad + np.radians(angle.offset_deg)
    if not travels and rad.size:
        # Neither of these turns all the way round: whole turns are where a counter began.
        turned[known] -= 2.0 * np.pi * np.round(np.median(turned[known]) / (2.0 * np.pi))
    return turned


def _voltage(table: Table, voltage: Voltage, t_s: Floats) -> Floats:
    raw = _earlier(_column(table, voltage.column), t_s, voltage.delay_s)
    result: Floats = voltage.sign * voltage.volts * raw + voltage.offset_V
    return result


def _earlier(values: Floats, t_s: Floats, delay_s: float) -> Floats:
    """Take a delay out, in whole rows: what the column says now was so `delay_s` ago. Rows that it then has
    nothing for are nan.
    """
    step_s = float(np.nanmedian(np.diff(t_s)))
    rows = round(delay_s / step_s) if step_s > 0.0 else 0
    if not rows:
        return values
    moved = np.full(values.shape, np.nan)
    if rows > 0:
        moved[:-rows] = values[rows:]
    else:
        moved[-rows:] = values[:rows]
    return moved


def _even(
    t_s: Floats, series: dict[str, Floats], held: dict[str, Floats]
) -> tuple[Floats, dict[str, Floats], dict[str, Floats]]:
    """Bring rows of an uneven clock to even times: angles on straight lines, voltages held."""
    steps_s = np.diff(t_s)
    step_s = float(np.median(steps_s))
    ordinary = steps_s[steps_s < _GAP_STEPS * step_s]
    strays = float(np.std(ordinary)) > UNEVEN * step_s
    # Times in whole milliseconds are even ones that were rounded.
    mean_s = float(ordinary.mean())
    rounded = np.abs(t_s - t_s[0] - mean_s * np.arange(t_s.size)).max() < 1.5 * step_s
    if not strays and len(ordinary) == len(steps_s):
        return t_s, series, held
    if rounded and len(ordinary) == len(steps_s):
        return t_s[0] + mean_s * np.arange(t_s.size), series, held
    step_s = mean_s
    even_s = t_s[0] + step_s * np.arange(int((t_s[-1] - t_s[0]) / step_s) + 1)
    last = np.clip(np.searchsorted(t_s, even_s + 1e-9, side="right") - 1, 0, None)
    return (
        even_s,
        {name: np.interp(even_s, t_s, values) for name, values in series.items()},
        {name: values[last] for name, values in held.items()},
    )


def _pieces(t_s: Floats, part: Part, jumps: list[int], source: str) -> list[tuple[int, int]]:
    """Rows that are left: first and last plus one of each stretch; no stretch contains one of `jumps`."""
    keep = np.ones(t_s.size, bool)
    for start_s, stop_s in part.leave_out_s:
        keep &= (t_s < start_s) | (t_s >= stop_s)
    steps_s = np.diff(t_s)
    breaks = np.flatnonzero((steps_s > MAX_MISSING * np.median(steps_s)) | (steps_s < 0.0)) + 1
    breaks = np.union1d(breaks, jumps)
    edges = np.flatnonzero(np.diff(np.concatenate(([0], keep.astype(int), [0]))))
    stretches = [
        (int(a), int(b))
        for start, stop in zip(edges[::2], edges[1::2], strict=True)
        for a, b in itertools.pairwise([start, *breaks[(breaks > start) & (breaks < stop)], stop])
        if b - a >= MIN_ROWS
    ]
    if not stretches:
        raise FlightDataError(
            f"{source}: the profile leaves out all rows from {t_s[0]:g} to {t_s[-1]:g} s",
            "shorten leave_out_s in the profile",
        )
    return stretches
