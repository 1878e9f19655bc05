"""Conversion of a table to flights by a profile."""

from __future__ import annotations

import difflib
import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from heli_host.data.arrays import Booleans, Floats
from heli_host.data.flight import MIN_ROWS, Flight
from heli_host.data.tables.profile import MOTORS, Angle, Part, Profile, Voltage
from heli_host.data.tables.rows import (
    equal_runs,
    is_active,
    runs_of,
    settle_blank_cells,
    spikes,
    substitutes,
    timed_rows,
    without_unread_rows,
)
from heli_host.data.tables.table import COUNT, SHARES, VOLTAGE_UNITS, RowChange, Table, split_unit
from heli_host.declaration import AXES
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
_ROUNDED_STEPS = 1.5
"""Distance from even times, in median steps, below which times were only rounded, by up to a step."""
_JUMP_DEG = 8.0
_JUMP_DEG_S = 600.0
"""A step of an angle above both limits ends a flight, because the encoder was set to zero or two logs were
joined.

The limits were set by judgement: no such arm turns by 600 deg/s, and 8 deg is above the noise of every
encoder. Lower limits would cut fast logs at a lost row; higher limits would keep jumps, which no model
explains.
"""
_SPIKE_RATIO: Final = 5.0
"""Size of a voltage, as a multiple of its 99 % quantile, from which a single row is damaged. Commands before
their limit are at most some three times as large as usual."""
_MAX_SPIKE_ROWS: Final = 2
"""Largest number of neighbouring rows with such voltages that count as damaged."""
_STAND_S: Final = 0.3
_ONE_STAND_S: Final = 0.5
_LAST_STAND_S: Final = 1.0
_LONG_STAND_S: Final = 2.0
_FROZEN_S: Final = 1.0
_STAND_RATIO: Final = 4.0
"""Shortest part [s] in which a failed link repeats angles: two or all with a jump, one angle with a jump, at
the file's end angles that moved just before, and there all, or one that stays this much longer than before;
and all columns without a jump. A hovering simulation without disturbances may repeat its counts for a second.
"""
_STAND_JUMPS: Final = 2.0
_STAND_STEPS: Final = 3.0
_TABLE_STEPS: Final = 10.0
_STAND_NEIGHBOURS: Final = 3
"""Step after such a part, as a multiple of the largest of its neighbours on both sides, and of a typical step
of the file: in the air, and near the lowest elevation, where the table may be. An arm that rests for a moment
leaves its rest with a step that is smaller than the next ones."""
_MOVING_SHARE: Final = 0.5
"""Share of its mean speed with which an angle moves when its link fails for good; an arm that settles is
slower. Set by judgement: a higher share misses links that fail near a turning point."""
_MOVING_STEPS: Final = 8
_MOVING_ROWS: Final = 0.75
"""Changes of an angle in `_STAND_S` from which on the arm moves, at most this share of the rows. A simulated
hover without disturbances has up to 4."""
_COUNT_SHARE: Final = 0.05
"""Share of the steps of an angle with the same size from which on it is a count of the encoder."""
_OFF_TABLE_DEG: Final = 2.0
_ALOFT_DEG: Final = 5.0
"""Height above the lowest elevation from which the arm does not rest on the table, and from which it is
surely in the air [deg]; the table is about 25 deg below level."""
_HOVER_SHARE: Final = 0.8
"""Share of the median sum of the voltages from which the arm does not rest at the end of a file. Set by
judgement: a landed arm has motors that idle or are off."""
_OFF_SHARE: Final = 0.02
"""Share of the largest voltage below which the motors are off."""


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


@dataclass(frozen=True)
class Conversion:
    """Flights of a file, and all rows that were changed on the way."""

    flights: tuple[Flight, ...]  # In the order of the file
    changes: tuple[RowChange, ...]  # Rows that were left out, filled in or moved
    file_rows: int  # Rows of the file, before all changes

    @property
    def unexplained_rows(self) -> int:
        """Rows of the flights that neither the file nor a change explains; 0 if all changes are counted."""
        flown = sum(len(flight) for flight in self.flights)
        return flown - self.file_rows - sum(change.added for change in self.changes)


def flights_of(table: Table, profile: Profile) -> list[Flight]:
    """Convert a table to flights: one, or several if gaps, jumps or the profile divide it."""
    return list(convert(table, profile).flights)


def convert(table: Table, profile: Profile) -> Conversion:
    """Convert a table to flights, and count every row that is left out, filled in or moved."""
    table, t_s = _settled(table, profile)
    # A change adds rows, or leaves some out, which is a negative number.
    file_rows = len(table) - sum(change.added for change in table.changes)
    rows = _read_rows(table, profile, t_s)
    if profile.mirrored:
        rows = _mirrored(rows)
    rows, changes = _complete_rows(rows, table, profile)
    if profile.act == "before":
        # The voltages of a row acted before it, so those of the next row act from this row on.
        rows = _with_voltages_of_next_row(rows)
    part = profile.parts.get(Path(table.source).name, Part())
    reason_by_row = _find_jumps(rows)
    flights: list[Flight] = []
    resampled: list[_Resampling] = []
    stretches, lost = _usable_stretches(rows.t_s, part, list(reason_by_row), table.source)
    for stretch in stretches:
        recorded = rows.selected(stretch)
        even = _evenly_sampled(recorded)
        resampled.append(_Resampling(recorded.t_s, even.t_s))
        notes = _notes_of_file(table, part) | _cut_note(rows.t_s, stretch.start, reason_by_row)
        notes |= _gap_note(recorded.t_s, len(even.t_s))
        voltages_V = {f"{motor}_V": volts for motor, volts in even.voltages_V.items()}
        columns: dict[str, Any] = {**voltages_V, **even.angles_rad}
        flights.append(Flight(t_s=even.t_s, meta=notes, **columns))
    changes = [*table.changes, *changes, *lost, *_resampling_changes(resampled)]
    if changes:
        text = "; ".join(change.sentence() for change in changes)
        flights = [replace(flight, meta={**flight.meta, "rows of the file": text}) for flight in flights]
    return Conversion(tuple(flights), tuple(changes), file_rows)


def _settled(table: Table, profile: Profile) -> tuple[Table, Floats]:
    """Return the rows with times [s] and all columns of a profile, in order, with what was done to them."""
    angles = frozenset(angle.column for angle in profile.angles.values())
    setpoints = frozenset(angle.column for angle in profile.setpoints.values())
    beside = [(v.sign_column, v.supply_column * (v.unit in SHARES)) for v in profile.voltages.values()]
    voltages = frozenset(voltage.column for voltage in profile.voltages.values())
    voltages |= frozenset(itertools.chain(*beside)) - {""}
    for name in (*angles, *setpoints, *voltages):
        _values_of_column(table, name)
    used = {*angles, *setpoints, *voltages}
    table = table.aligned(angles | setpoints)
    # Without a clock, the number of a row is its time, so that no row may go before.
    table = without_unread_rows(table, used, profile.time) if profile.time else table
    table, t_s = _timed(table, profile)
    table, t_s = settle_blank_cells(table, t_s, voltages, angles | setpoints, MAX_MISSING)
    if len(table) < MIN_ROWS:
        raise _too_few_rows(table, profile)
    return _without_spikes(table, t_s, profile)


def _timed(table: Table, profile: Profile) -> tuple[Table, Floats]:
    """Return the rows of a table in the order of their times, with these times [s], shape (n,).

    They keep the start of the file, except that large times, such as seconds since 1970, start at 0.
    """
    if not profile.time:
        return table, table.even_times(profile.rate_Hz)
    _values_of_column(table, profile.time)
    timed = timed_rows(table, profile.time, profile.time_unit)
    # A printed table would lose the microseconds of seconds since 1970.
    is_epoch = abs(float(timed.t_s[0])) > 1e5
    return timed.table, timed.t_s - (timed.t_s[0] if is_epoch else 0.0)


def times_of(table: Table, profile: Profile) -> Floats:
    """Return the times of a table's rows [s] after their repair, shape (n,)."""
    return _timed(table, profile)[1]


def _too_few_rows(table: Table, profile: Profile) -> FlightDataError:
    """Describe a table without enough complete rows, with what was left out."""
    reasons = "; ".join(change.sentence() for change in table.changes) or "the file is too short"
    entries: list[Angle | Voltage] = [*profile.angles.values(), *profile.voltages.values()]
    return FlightDataError(
        f"{table.source}: fewer than {MIN_ROWS} rows have a time and a number in "
        f"{', '.join(repr(entry.column) for entry in entries)} ({reasons})",
        "correct the columns in the profile, or the named rows of the file",
    )


def _without_spikes(table: Table, t_s: Floats, profile: Profile) -> tuple[Table, Floats]:
    """Leave out rows in which a value jumps away and back, as damaged digits do; no arm moves like that."""
    spikes_of_column: list[tuple[str, Booleans]] = []
    for angle in profile.angles.values():
        angle_rad = angle.rad * table.columns[angle.column].values
        # An angle may wrap at a turn, and a counter at the end of its range.
        wrap_rad = WORD * angle.rad if angle.unit == COUNT else 2.0 * np.pi
        is_away = _far_spikes(angle_rad, t_s, wrap_rad) | spikes(angle_rad)
        spikes_of_column.append((angle.column, is_away))
    for voltage in profile.voltages.values():
        is_away = _voltage_spikes(table.columns[voltage.column].values)
        spikes_of_column.append((voltage.column, is_away))
    is_spike = np.logical_or.reduce([is_away for _, is_away in spikes_of_column])
    if not is_spike.any():
        return table, t_s
    names = [column for column, is_away in spikes_of_column if is_away.any()]
    first_s = float(t_s[int(np.argmax(is_spike))])
    change = RowChange(
        "left out",
        int(is_spike.sum()),
        f"with a value in {' or '.join(map(repr, names))} that jumps and returns (first at {first_s:.3f} s)",
    )
    kept = np.flatnonzero(~is_spike)
    return table.selected(kept, [change]), t_s[kept]


def _voltage_spikes(values: Floats) -> Booleans:
    """Mark rows with a voltage far above the others, or with a substitute for one. Returns shape (n,)."""
    sizes = np.abs(values)
    is_large = sizes > _SPIKE_RATIO * max(float(np.quantile(sizes, 0.99)), 1e-12)
    is_spike = is_large.copy()
    for start, stop in runs_of(is_large):
        # More of them are a real step of the voltage, not damaged digits.
        if stop - start > _MAX_SPIKE_ROWS:
            is_spike[start:stop] = False
    return is_spike | substitutes(values)


def _far_spikes(angle_rad: Floats, t_s: Floats, wrap_rad: float) -> Booleans:
    """Mark single rows, or two in a row, at which an angle jumps away and back. Shapes: `t_s` (n,); returns
    (n,).
    """
    result = np.zeros(angle_rad.size, bool)
    for width in (1, 2):
        if angle_rad.size < width + 2:
            continue
        before, after = angle_rad[: -width - 1], angle_rad[width + 1 :]
        limit_rad = np.radians(np.maximum(_JUMP_DEG, _JUMP_DEG_S * np.abs(np.diff(t_s)[: before.size])))
        away = angle_rad[1:-width] - before
        # At a wrap, an angle may jump to and fro by a turn.
        is_wrap = np.abs(away - wrap_rad * np.round(away / wrap_rad)) < limit_rad
        last = angle_rad[width:-1]
        jumps = (np.abs(away) > limit_rad) & (np.abs(after - last) > limit_rad) & ~is_wrap
        jumps &= np.abs(after - before) < 0.5 * limit_rad
        for offset in range(1, width + 1):
            result[offset : offset + jumps.size] |= jumps
    return result


def _read_rows(table: Table, profile: Profile, t_s: Floats) -> _Rows:
    """Return times, angles, setpoints and voltages of all rows; values that a delay shifts away are nan.

    Shapes: `t_s` (n,).
    """
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


def _complete_rows(rows: _Rows, table: Table, profile: Profile) -> tuple[_Rows, list[RowChange]]:
    """Return the rows whose values are all measured, and the reasons for which others are left out."""
    changes = []
    columns = np.array([rows.t_s, *rows.angles_rad.values(), *rows.voltages_V.values()])
    is_complete = np.asarray(np.isfinite(columns).all(axis=0))
    if not is_complete.all():
        lost = int((~is_complete).sum())
        changes.append(RowChange("left out", lost, "at an end, because a column was moved by its delay"))
    rows = rows.selected(is_complete)
    stands = _standing(replace(rows, t_s=_without_falls(rows.t_s)))
    if stands.any():
        changes.append(_standing_change(rows.t_s, stands))
    rows = rows.selected(~stands)
    if rows.t_s.size < MIN_ROWS:
        raise _too_few_rows(replace(table, changes=(*table.changes, *changes)), profile)
    return rows, changes


def _without_falls(t_s: Floats) -> Floats:
    """Continue times by a typical step where the clock starts again. Shapes: `t_s` (n,); returns (n,)."""
    steps_s = np.diff(t_s)
    if not (steps_s < 0.0).any():
        return t_s
    steps_s = np.where(steps_s < 0.0, float(np.median(steps_s)), steps_s)
    return np.concatenate((t_s[:1], t_s[0] + np.cumsum(steps_s)))


@dataclass(frozen=True)
class _Motion:
    """Angles and voltages of n rows, in which a failed link shows as parts that stand still."""

    t_s: Floats  # (n,)
    angles_rad: Floats  # (n, 3)
    volts: Floats  # (n, 2)
    step_rad: Floats  # (n - 1, 3): Size of each step of the angles; 0 across a gap
    typical_rad: Floats  # (3,): Typical size of these steps; infinite for an angle that never moves

    @classmethod
    def of(cls, rows: _Rows) -> _Motion:
        """Measure the steps of the angles of a table's rows."""
        angles = np.column_stack([rows.angles_rad[f"{axis}_rad"] for axis in AXES])
        steps_s = np.diff(rows.t_s)
        # Across a gap, an arm in motion jumps, too.
        is_gap = steps_s > MAX_MISSING * np.median(steps_s)
        step_rad = np.where(is_gap[:, None], 0.0, np.abs(np.diff(angles, axis=0)))
        typical_rad = [_typical_step_rad(steps[steps > 0.0]) for steps in step_rad.T]
        volts = np.column_stack(list(rows.voltages_V.values()))
        return cls(rows.t_s, angles, volts, step_rad, np.array(typical_rad))

    @cached_property
    def lowest_rad(self) -> float:
        """Lowest elevation: that of the table in most files."""
        return float(self.angles_rad[:, 0].min(initial=np.inf))

    def largest_usual_step_rad(self, start: int, stop: int) -> Floats:
        """Return the size (3,) above which a step into or out of the rows `start` to `stop` is a jump."""
        height_deg = float(np.degrees(self.angles_rad[start, 0] - self.lowest_rad))
        # An arm on its table stands still, too, but leaves it without a large step.
        typical_steps = _STAND_STEPS if height_deg > _OFF_TABLE_DEG else _TABLE_STEPS
        entry = max(start - 1, 0)
        before = self.step_rad[max(entry - _STAND_NEIGHBOURS, 0) : entry]
        neighbours = np.concatenate((before, self.step_rad[stop : stop + _STAND_NEIGHBOURS]))
        largest: Floats = np.maximum(
            _STAND_JUMPS * neighbours.max(axis=0, initial=0.0), typical_steps * self.typical_rad
        )
        return largest

    def ends_still(self, axes: Sequence[int], start: int, others_s: Floats) -> bool:
        """Whether the link failed at the row `start` for good: `axes` stand still in flight until the end.

        `others_s` are the lengths of the earlier parts in which they stand still, shape (k,).
        """
        t_s, angles = self.t_s, self.angles_rad
        length_s = t_s[-1] - t_s[start]
        if length_s <= _LAST_STAND_S:
            return False
        sums_V = np.abs(self.volts.sum(axis=1))
        is_aloft = angles[start:, 0].min() > self.lowest_rad + np.radians(_ALOFT_DEG)
        if not is_aloft and not sums_V[start:].mean() > _HOVER_SHARE * float(np.median(sums_V)):
            return False
        is_long = len(axes) == len(AXES) or (others_s.size and length_s > _STAND_RATIO * others_s.max())
        if length_s > _LONG_STAND_S and is_long:
            return True
        moved_rad = np.abs(angles[start] - angles[np.searchsorted(t_s, t_s[start] - _STAND_S)])
        duration_s = max(float(np.ptp(t_s)), _STAND_S)
        usual_rad = _MOVING_SHARE * _STAND_S * self.step_rad.sum(axis=0) / duration_s
        return bool((moved_rad > np.maximum(_STAND_JUMPS * self.typical_rad, usual_rad))[list(axes)].any())


def _typical_step_rad(steps_rad: Floats) -> float:
    """Return the typical size of the steps of an angle, at least the most frequent one: where rows were
    filled in, steps are smaller than a count of the encoder, which is no jump. Shapes: `steps_rad` (n,).
    """
    if not steps_rad.size:
        return np.inf
    sizes, counts = np.unique(np.round(steps_rad, 5), return_counts=True)
    is_count = bool(counts.max() > _COUNT_SHARE * steps_rad.size)
    return max(float(np.median(steps_rad)), float(sizes[counts.argmax()]) * is_count)


class _End(NamedTuple):
    """An end of a part that stands still."""

    step: int  # Row of `step_rad` with the step into or out of the part
    row: int  # First or last row of the part
    beyond: int  # Its neighbour outside the part


def _standing(rows: _Rows) -> Booleans:
    """Mark rows that a failed link repeats: an angle stays in the air, although the motors work.

    After such a part, the angle jumps to where the arm has gone meanwhile; if the link reports 0, it jumps
    before the part, too. If the voltages freeze with the angles, a jump is not necessary. At the end of a
    file, a long part in flight counts without a jump. A rig may hover still for a moment.
    """
    motion = _Motion.of(rows)
    t_s, angles, volts = motion.t_s, motion.angles_rad, motion.volts
    is_repeated = np.zeros(t_s.size, bool)
    largest_V = np.abs(volts).max(initial=0.0)
    # How long each angle stays the same around each row, shape (n, 3).
    rests_s = np.column_stack([_rests_s(t_s, values) for values in angles.T])
    # The surest parts first, in which all three angles stand still: they decide about parts beside them.
    for axes in ([0, 1, 2], [0, 1], [0, 2], [1, 2], [0], [1], [2]):
        shortest_s = _STAND_S if len(axes) > 1 else _ONE_STAND_S
        runs = np.array(equal_runs(t_s, angles[:, axes]), int).reshape(-1, 2)
        starts, stops = runs.T
        lengths_s = t_s[stops - 1] - t_s[starts]
        # Most runs are two rows in the air, so the long ones are chosen first, and the longest is the first.
        is_long = lengths_s >= shortest_s
        runs, stops, lengths_s = runs[is_long], stops[is_long], lengths_s[is_long]
        for start, stop in runs[np.argsort(-lengths_s, kind="stable")].tolist():
            is_driven = np.abs(volts[start:stop]).max() >= _OFF_SHARE * largest_V
            # A link that reports 0 in all columns reports motors that are off.
            if not is_driven and len(axes) < len(AXES):
                continue
            enters, leaves = _has_jumps(motion, rests_s, is_repeated, axes, slice(start, stop))
            if is_driven:
                # Lengths of the earlier parts in which these angles stand still.
                others_s = lengths_s[stops < stop]
                fails = enters or leaves or (stop == t_s.size and motion.ends_still(axes, start, others_s))
            else:
                fails = enters and leaves
            if fails:
                # Without a jump into the part, its first row was measured.
                is_repeated[start if enters else start + 1 : stop] = True
    return is_repeated | _frozen(motion)


def _has_jumps(
    motion: _Motion, rests_s: Floats, is_repeated: Booleans, axes: list[int], part: slice
) -> tuple[bool, bool]:
    """Whether one of the angles `axes` jumps into a `part` that stands still, and whether one jumps out of
    it, without jumps of a neighbour that stands still itself. Shapes: `rests_s` (n, 3), `is_repeated` (n,).
    """
    start, stop = part.start, part.stop
    limit_rad = motion.largest_usual_step_rad(start, stop)
    ends = (
        _End(step=start - 1, row=start, beyond=max(start - 1, 0)),
        _End(step=stop - 1, row=stop - 1, beyond=min(stop, motion.t_s.size - 1)),
    )
    # A slice, because it is empty at the first and the last row of the file: no jump.
    jumps = [(motion.step_rad[end.step : end.step + 1] > limit_rad)[:, axes] for end in ends]
    # With jumps at both ends, as around zeros of a failed link, both belong to the part, even if a neighbour
    # stands still for longer, as an arm at rest does.
    has_both = all(jump.any() for jump in jumps)
    belong_to_part = []
    for end, jump in zip(ends, jumps, strict=True):
        # Of two parts beside a jump, the longer one is that of the failed link.
        is_longer = rests_s[end.row, axes] >= rests_s[end.beyond, axes]
        belongs_to_part = bool((jump & (is_longer | has_both)).any())
        # If the neighbour was marked before, the jump is its own, and no sign of a second failure.
        belong_to_part.append(belongs_to_part and not is_repeated[end.beyond])
    enters, leaves = belong_to_part
    return enters, leaves


def _rests_s(t_s: Floats, values: Floats) -> Floats:
    """Return, for each row, how long its value stays the same around it [s]. Shapes: `t_s` (n,), `values`
    (n,); returns (n,).
    """
    result = np.zeros(t_s.size)
    for start, stop in equal_runs(t_s, values[:, None]):
        result[start:stop] = t_s[stop - 1] - t_s[start]
    return result


def _frozen(motion: _Motion) -> Booleans:
    """Mark rows in the air that repeat all angles and voltages, although they change until then, and again
    after that. Under feedback, voltages settle before they stand still. Returns shape (n,).
    """
    t_s, volts, step_rad = motion.t_s, motion.volts, motion.step_rad
    result = np.zeros(t_s.size, bool)
    steps_V = np.diff(volts, axis=0)
    aloft_rad = motion.lowest_rad + np.radians(_OFF_TABLE_DEG)
    for start, stop in equal_runs(t_s, np.column_stack((motion.angles_rad, volts))):
        if t_s[stop - 1] - t_s[start] < _FROZEN_S or motion.angles_rad[start, 0] < aloft_rad:
            continue
        first, last = np.searchsorted(t_s, (t_s[start] - _STAND_S, t_s[stop - 1] + _STAND_S)).tolist()
        sides = slice(first, max(start - 1, first)), slice(stop, last)
        result[start + 1 : stop] = all(
            _moves(step_rad[side])
            and all(is_active(part, whole) for part, whole in zip(steps_V[side].T, steps_V.T, strict=True))
            for side in sides
        )
    return result


def _moves(steps_rad: Floats) -> bool:
    """Whether an angle changes often. Without disturbances, counts and duties of a hover may stay the same
    for seconds, between single counts. Shapes: `steps_rad` (n, 3).
    """
    changes = (steps_rad > 0.0).sum(axis=0).max()
    return bool(changes >= min(_MOVING_STEPS, _MOVING_ROWS * len(steps_rad)))


def _standing_change(t_s: Floats, stands: Booleans) -> RowChange:
    """Describe rows that a failed link repeats."""
    spans = [f"{t_s[start - 1]:.3f} to {t_s[stop - 1]:.3f} s" for start, stop in runs_of(stands)]
    more = f" and {len(spans) - 4} other parts" if len(spans) > 4 else ""
    return RowChange(
        "left out",
        int(stands.sum()),
        f"in which angles stand still although the motors work ({', '.join(spans[:4])}{more})",
        is_standing=True,
    )


def _with_voltages_of_next_row(rows: _Rows) -> _Rows:
    """Give each row the voltages of the next one, if the table has in each row those that acted until it."""
    return replace(
        rows, voltages_V={motor: np.append(volts[1:], volts[-1]) for motor, volts in rows.voltages_V.items()}
    )


def _notes_of_file(table: Table, part: Part) -> dict[str, str]:
    """Return the notes that all flights of a file have in common."""
    notes = {"imported from": Path(table.source).name}
    if part.group:
        notes["group"] = part.group
    if table.notes:
        notes["notes of the file"] = " / ".join(table.notes.split("\n"))
    return notes


@dataclass(frozen=True)
class _Resampling:
    """Rows of a flight before and after they were brought to even times."""

    t_s: Floats  # (n,): Times of the rows of the file
    even_s: Floats  # (k,): Times of the rows of the flight

    @property
    def gaps_s(self) -> Floats:
        """Gaps in which rows are missing [s]."""
        steps_s = np.diff(self.t_s)
        return steps_s[steps_s >= _GAP_STEPS * np.median(steps_s)]

    @property
    def missing(self) -> int:
        """How many rows are missing in the gaps."""
        return int(np.round(self.gaps_s / np.median(np.diff(self.t_s)) - 1.0).sum())

    @property
    def is_uneven(self) -> bool:
        """Whether rows were moved, and not only filled in."""
        return self.even_s.size != self.t_s.size + self.missing or (
            not self.missing and not np.array_equal(self.even_s, self.t_s)
        )


def _resampling_changes(parts: list[_Resampling]) -> list[RowChange]:
    """Describe the rows that even times added to the flights, or took from them."""
    missing, gaps = sum(part.missing for part in parts), sum(part.gaps_s.size for part in parts)
    changes = [RowChange("filled", missing, f"that were missing in {gaps} gaps")] if missing else []
    uneven = [part for part in parts if part.is_uneven]
    if uneven:
        rows = sum(part.t_s.size + part.missing for part in uneven)
        even = sum(part.even_s.size for part in uneven)
        rate_Hz = 1.0 / float(np.mean(np.diff(uneven[0].even_s)))
        text = f"{rows} rows at uneven times to {even} rows at {rate_Hz:.6g} Hz"
        changes.append(RowChange("resampled", even - rows, text))
    return changes


def _cut_note(t_s: Floats, row: int, jumps: dict[int, str]) -> dict[str, str]:
    """Return a note about why a flight begins at a `row`; empty for the first row of the file."""
    if row == 0:
        return {}
    before_s, after_s = t_s[row - 1], t_s[row]
    if after_s < before_s:
        return {"cut": f"the time falls from {before_s:.3f} to {after_s:.3f} s"}
    return {"cut": jumps.get(row, f"rows are missing from {before_s:.3f} to {after_s:.3f} s")}


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


def _values_of_column(table: Table, name: str) -> Floats:
    """Return the values of a column; an error suggests a name that is similar."""
    if name in table.unread:
        raise FlightDataError(
            f"{table.source}: the column '{name}' has cells that are not numbers, such as "
            f"'{table.unread[name]}'",
            "write its numbers in one notation",
        )
    if name not in table.columns:
        raise unknown_column(table.source, name, table.columns)
    return table.columns[name].values


def unknown_column(source: str, name: str, columns: Iterable[str]) -> FlightDataError:
    """Return the error of a column that is not among those of a file; it suggests a name that is similar."""
    names = list(columns)
    close = difflib.get_close_matches(name, names, n=1)
    hint = f"did you mean '{close[0]}'? " if close else ""
    return FlightDataError(f"{source}: unknown column '{name}'", f"{hint}it has {', '.join(names[:12])}")


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
    """Return a voltage [V], shape (n,), from its column: apply supply, delay, unit, sign and offset."""
    values = _values_of_column(table, voltage.column)
    if voltage.sign_column:
        values = with_direction(values, _values_of_column(table, voltage.sign_column))
    if voltage.supply_column and voltage.unit in SHARES:
        values = values * _supply_V_of(table, voltage.supply_column) / voltage.supply_V
    delay_free = _without_delay(values, t_s, voltage.delay_s)
    result: Floats = voltage.sign * voltage.volts * delay_free + voltage.offset_V
    return result


def with_direction(values: Floats, direction: Floats) -> Floats:
    """Give the sizes of a voltage the sign of its `direction`, if this column has two values.

    The rotors have to carry the arm, so the direction with the larger voltages is forwards.
    """
    kinds = np.unique(direction[np.isfinite(direction)])
    if kinds.size != 2:
        return values
    forwards = max(kinds, key=lambda kind: float(np.nansum(np.abs(values[direction == kind]))))
    result: Floats = np.where(direction == forwards, np.abs(values), -np.abs(values))
    return result


def _supply_V_of(table: Table, name: str) -> Floats:
    """Return the supply voltage of each row [V], shape (n,); rows without a value have the last one."""
    values = _values_of_column(table, name)
    known = np.flatnonzero(np.isfinite(values))
    if not known.size:
        raise FlightDataError(
            f"{table.source}: the supply column '{name}' is empty", "state supply_V instead"
        )
    last = known[np.clip(np.searchsorted(known, np.arange(values.size), side="right") - 1, 0, None)]
    unit = table.columns[name].unit or split_unit(name)[1]
    result: Floats = values[last] * VOLTAGE_UNITS.get(unit, 1.0)
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
    has_gaps = len(regular_steps_s) < len(steps_s)
    if not has_gaps:
        if float(np.std(steps_s)) <= UNEVEN * step_s:
            return rows
        even_s = t_s[0] + mean_s * np.arange(t_s.size)
        # Times that were rounded, for example to whole milliseconds, count as even.
        if np.abs(t_s - even_s).max() < _ROUNDED_STEPS * step_s:
            return replace(rows, t_s=even_s)
    even_s = t_s[0] + mean_s * np.arange(int((t_s[-1] - t_s[0]) / mean_s) + 1)
    # A nanosecond more, so that rounding does not choose the row before an equal time.
    last_row = np.clip(np.searchsorted(t_s, even_s + 1e-9, side="right") - 1, 0, None)
    return _Rows(
        t_s=even_s,
        angles_rad={name: np.interp(even_s, t_s, values) for name, values in rows.angles_rad.items()},
        voltages_V={motor: volts[last_row] for motor, volts in rows.voltages_V.items()},
    )


def _usable_stretches(
    t_s: Floats, part: Part, jumps: list[int], source: str
) -> tuple[list[slice], list[RowChange]]:
    """Divide the rows at gaps, falling times and `jumps`, without the times that the profile excludes.

    Returns the stretches, and the reasons for which rows are in none of them.
    """
    is_included = np.ones(t_s.size, bool)
    for start_s, stop_s in part.leave_out_s:
        is_included &= (t_s < start_s) | (t_s >= stop_s)
    steps_s = np.diff(t_s)
    is_break = (steps_s > MAX_MISSING * np.median(steps_s)) | (steps_s < 0.0)
    breaks = np.union1d(np.flatnonzero(is_break) + 1, np.array(jumps, np.int64))
    spans: list[slice] = []
    for start, stop in runs_of(is_included):
        inner = breaks[(breaks > start) & (breaks < stop)].tolist()
        spans += [slice(first, end) for first, end in itertools.pairwise([start, *inner, stop])]
    stretches = [span for span in spans if span.stop - span.start >= MIN_ROWS]
    short = [span for span in spans if span.stop - span.start < MIN_ROWS]
    changes = []
    if not is_included.all():
        changes.append(RowChange("left out", int((~is_included).sum()), "that the profile leaves out"))
    if short:
        changes.append(
            RowChange(
                "left out",
                sum(span.stop - span.start for span in short),
                f"in {len(short)} parts of fewer than {MIN_ROWS} rows between gaps or jumps "
                f"(first at {t_s[short[0].start]:.3f} s)",
            )
        )
    if not stretches and part.leave_out_s:
        raise FlightDataError(
            f"{source}: the profile leaves out all rows from {t_s[0]:g} to {t_s[-1]:g} s",
            "shorten leave_out_s in the profile",
        )
    if not stretches:
        raise FlightDataError(
            f"{source}: no part has {MIN_ROWS} rows without a gap or a jump ({changes[-1].sentence()})",
            "correct the columns and the unit of the time in the profile",
        )
    return stretches, changes
