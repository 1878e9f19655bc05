"""Rows of a table on one clock: order, repeated times, overflows, blank cells; every change is counted."""

from __future__ import annotations

import bisect
import itertools
from collections.abc import Collection
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

import numpy as np

from heli_host.data.arrays import Booleans, Floats, Integers
from heli_host.data.tables.table import TIME_UNITS, RowChange, Table, interpolated_angle
from heli_host.errors import FlightDataError

NO_CLOCK: Final = "give a column of times, or the sampling rate with --rate"
"""Fix of a file without usable times."""
_MIN_TIMES: Final = 10
"""Smallest number of times of a table."""
_MIN_TIME_SHARE: Final = 0.5
"""Smallest share of rows with a time. With fewer, the column is not the clock of the rows."""
_REVERSED_SHARE: Final = 0.9
"""Share of falling steps from which the newest row is the first: other clocks fall in less than half of their
steps."""
_MODULI: Final = (2.0**16, 2.0**31, 2.0**32, 2.0**32 / 1e3, 2.0**32 / 1e6, 2.0**16 / 1e3)
"""Numbers at which counters start again: 16, 31 and 32 bits, and microseconds shown in ms or s."""
_SHOWN_S: Final = (60.0, 3600.0, 86400.0)
"""Times at which a clock face starts again [s]. They count only if the file begins at another time, because a
flight of a minute may be followed by another one."""
_EDGE_STEPS: Final = 6.0
"""Largest distance from the end of a counter's range, in typical steps, at which it overflows. A gap that is
filled may lie there; a larger number takes a restart of the program for an overflow."""
_MIN_OVERFLOWS: Final = 3
"""Smallest number of equal falls of a counter with an unknown range."""
_GLITCH_STEPS: Final = 20.0
"""Distance of a time from its neighbours, in typical steps, from which it is examined alone. Packets of a
network arrive up to some ten rows late."""
_HOLE_STEPS: Final = 1.5
"""Step, in typical steps, from which a row is missing there, so that a displaced row fits."""
_COARSE_SHARE: Final = 0.3
"""Share of steps without a change of the time from which a clock is coarse: rows then share times."""
_MAX_MISFITS: Final = 3
"""Largest number of neighbouring rows that count as damaged. Set by judgement: more rows whose times fit
nowhere are the begin of another recording."""
_MAX_CLUSTER: Final = 2000
"""Longest disorder that is examined row by row. A network does not delay a row by more."""
_MAX_CONFLICTS: Final = 0.02
"""Largest share of rows that share a time by damage. Damaged lines are rarer in logs that people use."""
_COPY_SHARE: Final = 0.9
"""Share of the rows with a repeated time that equal the row before, from which they are copies of it."""
_MIN_HIDDEN_ROWS: Final = 2.0
"""Rows by which a step of a coarse clock must be short for rows to be missing; one less is rounding."""
_STALL_ROWS: Final = 10
_STALL_SHARE: Final = 4.0
"""Fewest rows with one time, and their number as a multiple of what 95 % of the times have, from which on the
clock stood still. The steps of a coarse clock differ by a row."""
_MAX_UNREAD: Final = 0.03
"""Largest share of rows with an unreadable cell that count as damaged; slower signals leave more blank."""
_SPIKE_STEPS: Final = 8.0
"""Step to and from a spike, as a multiple of the 95 % quantile of all steps: damage of 2 % of the rows makes
4 % of the steps large. Measured columns have up to 4 times their 99 % quantile."""
_MAX_SPIKES: Final = 0.02
"""Largest share of spikes; a column with more is a signal that switches."""
_MIN_SUBSTITUTES: Final = 5
"""Smallest number of spikes with the same number, from which on a program writes it instead of a value."""
_MAX_SUBSTITUTES: Final = 0.2
_FAR_RANGES: Final = 2.0
_FAR_RATIO: Final = 5.0
"""Largest share of such rows, their distance from all other values as a multiple of their range, and their
size over the largest of these values."""
_SAME_RATE_SHARE: Final = 0.9
"""Share of the fastest column's rows in which a column of the same rate has a number at least."""
_NEAR_ROWS: Final = 8
"""Rows before and after a pair in which the rig has to move for the pair to count as evidence."""

_ACTIVE_SHARE: Final = 0.5
_ACTIVE_SIZE: Final = 0.3
"""Number and median size of the steps of a part, as shares of the usual ones, from which on the column has
not settled. Set by judgement."""


@dataclass(frozen=True)
class TimedRows:
    """Rows of a table in the order of their times."""

    table: Table  # The rows, with all changes so far
    t_s: Floats  # (n,): Times [s]; they rise, and fall only where a clock starts again
    uncertain_s: float = 0.0  # Largest error of a time, because a coarse clock hides where rows are missing


def without_unread_rows(table: Table, columns: Collection[str], time: str) -> Table:
    """Leave out the rows in which a column that has numbers nearly everywhere has none.

    A line that is damaged in one cell may have a damaged time, too, and a clock is repaired by all its times.
    If only other columns than `columns` lack a number, a row is left out if its time is out of order.
    """
    has_number = {name: np.isfinite(column.values) for name, column in table.columns.items() if name != time}
    lacking = {name: ~cells for name, cells in has_number.items() if 1.0 - _MAX_UNREAD <= cells.mean() < 1.0}
    nothing = np.zeros(len(table), bool)
    unread = np.logical_or.reduce([nothing, *lacking.values()])
    if not unread.any() or unread.mean() > _MAX_UNREAD:
        return table
    lacks_used = np.logical_or.reduce([nothing, *(lacking[name] for name in columns if name in lacking)])
    if time in table.columns:
        times = table.columns[time].values
        # If the newest row is the first, the times fall.
        times = -times if float(np.nanmean(np.sign(np.diff(times)))) < 0.0 else times
        whole = np.flatnonzero(~unread)
        # The nearest whole row before each row, and the nearest from it on.
        place = np.searchsorted(whole, np.arange(unread.size))
        before, after = whole[np.clip(place - 1, 0, None)], whole[np.clip(place, None, whole.size - 1)]
        is_in_order = (times >= times[before]) & (times <= times[after])
        unread &= lacks_used | ~is_in_order
    else:
        unread &= lacks_used
    if not unread.any():
        return table
    names = " or ".join(f"'{name}'" for name, cells in lacking.items() if (cells & unread).any())
    reason = f"without a number in {names} (first: row {int(np.argmax(unread)) + 1})"
    return table.selected(np.flatnonzero(~unread), [RowChange("left out", int(unread.sum()), reason)])


def timed_rows(table: Table, column: str, unit: str) -> TimedRows:
    """Put the rows of an aligned `table` in the order of the times in a `column`, and repair these times.

    All changes are added to those of the table. A FlightDataError states why a column is no clock.
    """
    values = table.columns[column].values
    has_time = np.isfinite(values)
    if has_time.sum() < max(_MIN_TIMES, _MIN_TIME_SHARE * values.size):
        first = int(np.argmin(has_time)) + 1
        raise FlightDataError(
            f"{table.source}: the time '{column}' is a number in only {int(has_time.sum())} of {values.size} "
            f"rows (the first without one is row {first})",
            NO_CLOCK,
        )
    clock = _Clock(column, TIME_UNITS[unit], rows=np.flatnonzero(has_time), times=values[has_time])
    if not clock.step:
        raise FlightDataError(
            f"{table.source}: the time '{column}' is {values[has_time][0]:g} in all {values.size} rows",
            NO_CLOCK,
        )
    if not has_time.all():
        clock.leave_out(np.flatnonzero(~has_time), f"without a time in '{column}'")
    clock.turn_round()
    clock.continue_counter()
    clock.sort()
    ordered = table.selected(clock.rows, clock.changes)
    return _with_unique_times(ordered, clock.times, clock.cuts, column, TIME_UNITS[unit])


class _Clock:
    """Times of a column while they are put in order; `rows` are their rows in the table."""

    def __init__(self, column: str, unit_s: float, rows: Integers, times: Floats) -> None:
        self.column, self.unit_s, self.rows, self.times = column, unit_s, rows, times
        self.changes: list[RowChange] = []
        self.cuts: list[int] = []  # Rows at which the clock starts again
        self.step = _typical_step(times)

    def leave_out(self, rows: Integers, reason: str) -> None:
        """Note that `rows` of the table are left out."""
        first = int(rows.min()) + 1
        self.changes.append(RowChange("left out", rows.size, f"{reason} (first: row {first})"))

    def turn_round(self) -> None:
        """Turn a table round whose newest row is the first."""
        steps = np.diff(self.times)
        moving = steps[steps != 0.0]
        if float(np.mean(moving < 0.0)) > _REVERSED_SHARE:
            self.rows, self.times = self.rows[::-1], self.times[::-1]
            self.changes.append(
                RowChange(
                    "reordered", self.rows.size, f"because '{self.column}' falls: the newest came first"
                )
            )

    def continue_counter(self) -> None:
        """Continue a counter that starts again at the end of its range."""
        usable = np.flatnonzero(~self._is_far())
        times = self.times[usable]
        steps = np.diff(times)
        period = self._period(times)
        if not period:
            return
        # A step of minus nearly a period becomes a small one. Rows that are exchanged at the overflow also
        # rise by nearly a period, and become small steps back.
        continued_steps = np.mod(steps + 0.25 * period, period) - 0.25 * period
        continued_times = times[0] + np.concatenate(([0.0], np.cumsum(continued_steps)))
        overflows_before = np.round((continued_times - times) / period)
        # A time that is far from its neighbours gets the overflows of the usable row before it.
        usable_before = np.searchsorted(usable, np.arange(self.times.size), side="right") - 1
        self.times = self.times + period * overflows_before[np.clip(usable_before, 0, None)]
        self.step = _typical_step(self.times)
        overflows = round(float((continued_steps - steps).sum()) / period)
        count = "once" if overflows == 1 else f"{overflows} times"
        first_moved = int(usable[np.argmax(steps < -0.5 * period) + 1])
        self.changes.append(
            RowChange(
                "retimed",
                self.rows.size - first_moved,
                f"because the counter '{self.column}' overflows at {period:.10g}, {count} "
                f"(first: row {int(self.rows[first_moved]) + 1})",
            )
        )

    def _period(self, times: Floats) -> float:
        """Return the number at which the counter of these times starts again; 0 if no counter overflows."""
        steps = np.diff(times)
        if not (steps < 0.0).any():
            return 0.0
        span, lowest = float(np.ptp(times)), float(times.min())
        begins_at_zero = times[0] < _EDGE_STEPS * self.step
        shown = [] if begins_at_zero else [face_s / self.unit_s for face_s in _SHOWN_S]
        for period in (*_MODULI, *shown):
            slack = min(_EDGE_STEPS * self.step, 0.25 * period)
            falls = np.flatnonzero(steps < -0.5 * period)
            is_within_range = span <= period + slack
            if not falls.size or not is_within_range or period < 2.0 * self.step:
                continue
            # Unsigned counters begin at 0, signed ones at minus half of their range.
            begin = 0.0 if lowest >= -slack else -0.5 * period
            # An overflow goes from the end of the range to its begin; most falls have to be overflows.
            is_overflow = times[falls] > begin + period - slack - self.step
            is_overflow &= times[falls + 1] < begin + slack + self.step
            if is_overflow.mean() > 0.5:
                return float(period)
        # A counter with another range: nearly all falls are equal.
        falls = np.flatnonzero(steps < -_GLITCH_STEPS * self.step)
        if falls.size < _MIN_OVERFLOWS:
            return 0.0
        sizes = -steps[falls] + self.step
        period = float(np.median(sizes))
        is_equal = np.abs(sizes - period) < _EDGE_STEPS * self.step
        if is_equal.mean() <= 0.9 or span >= period + _EDGE_STEPS * self.step:
            return 0.0
        # A counter counts to a whole number, which the median may miss by a fraction of a step.
        return float(round(period)) if abs(period - round(period)) < 0.5 * self.step else period

    def sort(self) -> None:
        """Sort the rows by time within each recording, and leave out rows whose times fit nowhere."""
        if not (np.diff(self.times) < 0.0).any():
            return
        self._pull_out_glitches()
        order: list[Integers] = []
        misfits: list[Integers] = []
        moved = falls = start = 0
        while start < self.times.size:
            segment = self._sorted_segment(start)
            order.append(segment.rows)
            misfits.append(segment.misfits)
            moved += segment.moved
            falls += segment.falls
            if segment.restart < self.times.size:
                # Counted in the rows that are kept.
                self.cuts.append(sum(rows.size for rows in order))
            start = segment.restart
        kept, bad = np.concatenate(order), np.concatenate(misfits)
        if moved:
            self.changes.append(
                RowChange("reordered", moved, f"at {falls} falls of '{self.column}': sorted by time")
            )
        if bad.size:
            self.leave_out(self.rows[bad], f"whose '{self.column}' is out of order and fits nowhere")
        self.rows, self.times = self.rows[kept], self.times[kept]

    def _is_far(self) -> Booleans:
        """Mark single times that are far from their neighbours."""
        windows = np.lib.stride_tricks.sliding_window_view(np.pad(self.times, 2, mode="reflect"), 5)
        result: Booleans = np.abs(self.times - np.median(windows, axis=1)) > _GLITCH_STEPS * self.step
        return result

    def _pull_out_glitches(self) -> None:
        """Move single times that are far from their neighbours to the place where they fit, if any."""
        times = self.times
        is_far = self._is_far()
        if not is_far.any():
            return
        rest, rest_rows = times[~is_far], self.rows[~is_far]
        # Only among sorted times, a time has a place.
        is_sorted = not (np.diff(rest) < 0.0).any()
        damaged: list[int] = []
        moved: list[tuple[int, float, int]] = []  # place in `rest`, time, row
        for index in np.flatnonzero(is_far):
            time, row = float(times[index]), int(self.rows[index])
            place = int(np.searchsorted(rest, time))
            is_inside = is_sorted and 0 < place < rest.size
            # A row is missing there, and this one is not a copy of a neighbour.
            if (
                is_inside
                and rest[place] - rest[place - 1] > _HOLE_STEPS * self.step
                and min(time - rest[place - 1], rest[place] - time) > 0.5 * self.step
            ):
                moved.append((place, time, row))
            else:
                damaged.append(row)
        if damaged:
            self.leave_out(np.array(damaged), f"whose '{self.column}' is far from its neighbours")
        if moved:
            places, moved_times, moved_rows = zip(*sorted(moved), strict=True)
            rest = np.insert(rest, places, moved_times)
            rest_rows = np.insert(rest_rows, places, moved_rows)
            self.changes.append(
                RowChange("reordered", len(moved), f"that came late: sorted by '{self.column}'")
            )
        self.rows, self.times = rest_rows, rest

    def _sorted_segment(self, start: int) -> _SortedSegment:
        """Sort the rows from `start` on until the clock starts again."""
        times = self.times
        kept: list[Integers] = []
        misfits: list[int] = []
        moved = sorted_falls = 0
        position = start  # Rows before it are settled.
        highest = np.maximum.accumulate(times[start:])
        for fall in np.flatnonzero(np.diff(times[start:]) < 0.0) + 1 + start:
            if fall <= position and position > start:
                continue  # within a disorder that is settled
            first, last = self._disorder(position, int(fall), highest, start)
            cluster = self._fit(np.arange(first, last))
            if cluster is None:
                # The clock starts again at the deepest fall.
                restart = first + 1 + int(np.argmin(np.diff(times[first:last])))
                segment = np.concatenate([*kept, np.arange(position, restart)])
                # The rows before the restart may be in disorder themselves.
                segment = segment[np.argsort(times[segment], kind="stable")]
                return _SortedSegment(restart, segment, np.array(misfits, int), moved, sorted_falls)
            kept += [np.arange(position, first), cluster.rows]
            misfits += cluster.misfits.tolist()
            in_file_order = np.sort(cluster.rows)
            moved += int((in_file_order != cluster.rows).sum())
            sorted_falls += int((np.diff(times[in_file_order]) < 0.0).sum())
            position = last
        kept.append(np.arange(position, times.size))
        return _SortedSegment(times.size, np.concatenate(kept), np.array(misfits, int), moved, sorted_falls)

    def _disorder(self, position: int, fall: int, highest: Floats, start: int) -> tuple[int, int]:
        """Return the first row and the row after the last of the disorder around a `fall`."""
        # The disorder grows at its end by rows that are earlier than one before it, and at its beginning by
        # rows that are later than one in it, until neither adds a row.
        times = self.times
        first, last = fall - 1, fall + 1
        while True:
            top = float(highest[last - 1 - start])
            below = np.flatnonzero(times[last : last + _MAX_CLUSTER] < top)
            end = last + int(below[-1]) + 1 if below.size else last
            rising = np.maximum.accumulate(times[position:end])
            begin = position + int(np.searchsorted(rising, float(times[first:end].min()), "right"))
            begin = min(begin, first)
            if (begin, end) == (first, last) or end - begin > _MAX_CLUSTER:
                return begin, end
            first, last = begin, end

    def _fit(self, cluster: Integers) -> _SortedCluster | None:
        """Sort the rows of a `cluster` by time; return None if the clock starts again there."""
        if cluster.size > _MAX_CLUSTER:
            return None
        times = self.times[cluster]
        order = np.argsort(times, kind="stable")
        # If the sorted times are distinct, and hardly any is missing, these are the rows of one recording.
        are_distinct = (np.diff(times[order]) > 0.5 * self.step).all()
        if are_distinct and float(np.ptp(times)) / self.step < 2.0 * cluster.size + _EDGE_STEPS:
            return _SortedCluster(cluster[order], misfits=np.zeros(0, int))
        # Most rows are in order; each displaced row has to fit between two of them.
        backbone = longest_rise(times)
        is_displaced = np.ones(times.size, bool)
        is_displaced[backbone] = False
        rising = times[backbone]
        is_coarse = rising.size > 1 and float(np.mean(np.diff(rising) == 0.0)) > _COARSE_SHARE
        kept: list[int] = backbone.tolist()
        misfits: list[int] = []
        repeats = 0
        for index in np.flatnonzero(is_displaced).tolist():
            place = int(np.searchsorted(rising, times[index]))
            is_inside = 0 < place < rising.size
            is_hole = is_inside and rising[place] - rising[place - 1] > _HOLE_STEPS * self.step
            is_repeated = place < rising.size and rising[place] == times[index]
            if is_repeated and not is_coarse:
                repeats += 1
            if is_hole or is_coarse or is_repeated:
                kept.append(index)
            else:
                misfits.append(index)
        # A few rows with the times of others may be late copies; many are those of a clock that was set back.
        if len(misfits) > _MAX_MISFITS or repeats > _MAX_MISFITS:
            return None
        kept_rows = np.sort(np.array(kept, np.int64))
        by_time = kept_rows[np.argsort(times[kept_rows], kind="stable")]
        return _SortedCluster(cluster[by_time], cluster[np.array(misfits, np.int64)])


class _SortedCluster(NamedTuple):
    """Neighbouring rows in disorder, sorted by time."""

    rows: Integers
    misfits: Integers  # Rows whose times fit nowhere


class _SortedSegment(NamedTuple):
    """Rows between two starts of a clock, sorted by time."""

    restart: int  # Row at which the clock starts again; the number of rows if it does not
    rows: Integers
    misfits: Integers  # Rows whose times fit nowhere
    moved: int  # Number of rows that were moved
    falls: int  # Number of falls of the time that were sorted


def _typical_step(times: Floats) -> float:
    """Return the median of the steps that are not 0, in the direction in which most of them go."""
    steps = np.diff(times)
    steps = steps[steps != 0.0]
    if not steps.size:
        return 0.0
    is_falling = float(np.mean(steps < 0.0)) > _REVERSED_SHARE
    return float(np.median(-steps[steps < 0.0] if is_falling else steps[steps > 0.0]))


def longest_rise(times: Floats) -> Integers:
    """Return the positions of a longest part of `times` that never falls."""
    tops: list[float] = []
    top_at: list[int] = []
    previous = np.full(times.size, -1)
    for index, time in enumerate(times.tolist()):
        place = bisect.bisect_right(tops, time)
        if place == len(tops):
            tops.append(time)
            top_at.append(index)
        else:
            tops[place], top_at[place] = time, index
        previous[index] = top_at[place - 1] if place else -1
    positions = []
    index = top_at[-1]
    while index >= 0:
        positions.append(index)
        index = int(previous[index])
    return np.array(positions[::-1], np.int64)


def _with_unique_times(table: Table, times: Floats, cuts: list[int], column: str, unit_s: float) -> TimedRows:
    """Leave out copies of rows, merge rows that complete each other, and count on times that repeat."""
    other_names = [name for name in table.columns if name != column]
    other_values = [table.columns[name].values for name in other_names]
    cells = np.column_stack(other_values) if other_values else np.zeros((times.size, 1))  # (n, columns)
    is_kept = np.ones(times.size, bool)
    repairs = _TimeRepairs()
    retimed: list[Floats] = []
    recordings: list[tuple[Floats, Floats]] = []
    for start, stop in itertools.pairwise([0, *cuts, times.size]):
        part_times, part_cells = times[start:stop], cells[start:stop]
        if any(_is_same_part(part_times, part_cells, *recording) for recording in recordings):
            is_kept[start:stop] = False
            repairs.twice += stop - start
            continue
        recordings.append((part_times, part_cells))
        is_merged = _merge_complements(part_times, part_cells)
        is_copy = np.zeros(part_times.size, bool)
        is_copy[~is_merged] = _copies(part_times[~is_merged], part_cells[~is_merged])
        is_used = ~(is_copy | is_merged)
        is_rival = _conflicts(part_times[is_used])
        if is_rival.any():
            first_rival = float(part_times[is_used][int(np.argmax(is_rival))])
            repairs.first_rival = repairs.first_rival or first_rival
            is_used[np.flatnonzero(is_used)[is_rival]] = False
        is_kept[start:stop] = is_used
        used_times = part_times[is_used]
        running_times, stalled, lost, stall = _without_stalls(used_times, unit_s)
        even_times, coarse, note = _counted_on(running_times, unit_s)
        retimed.append(even_times)
        repairs.copies += int(is_copy.sum())
        repairs.merged += int(is_merged.sum())
        repairs.rivals += int(is_rival.sum())
        repairs.stalled += stalled
        repairs.coarse += coarse
        repairs.stalls += [stall] if stall else []
        repairs.notes += [note] if note and note not in repairs.notes else []
        repairs.uncertain = max(repairs.uncertain, lost, _hidden_time(used_times))
    changes = repairs.changes(column)
    if repairs.merged:
        filled = {
            name: replace(table.columns[name], values=values)
            for name, values in zip(other_names, cells.T, strict=True)
        }
        table = replace(table, columns={**table.columns, **filled})
    table = table.selected(np.flatnonzero(is_kept), changes) if changes else table
    return TimedRows(table, np.concatenate(retimed) * unit_s, repairs.uncertain * unit_s)


@dataclass
class _TimeRepairs:
    """Numbers of rows whose times repeat, by what was done to them, and texts about it."""

    twice: int = 0  # Rows of a recording that the file contains twice
    copies: int = 0
    rivals: int = 0  # Rows that contradict another one with the same time
    merged: int = 0
    stalled: int = 0  # Rows after a clock that stood still
    coarse: int = 0
    first_rival: float = 0.0  # Time of the first of the `rivals`
    stalls: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)  # How the rows of a coarse clock were counted on
    uncertain: float = 0.0  # Largest error of a time, in the unit of the times

    def changes(self, column: str) -> list[RowChange]:
        """Describe the repairs of the times in a `column`."""
        stalls, notes = "; ".join(self.stalls), "; ".join(self.notes)
        coarse = f"that repeat the time of the row before, because '{column}' is coarse: {notes}"
        rival = f"that contradict another with the same '{column}' (first: {self.first_rival:g})"
        changes = [
            RowChange("left out", self.twice, "of a recording that the file contains twice"),
            RowChange("left out", self.copies, f"that repeat rows before them, with the same '{column}'"),
            RowChange("left out", self.rivals, rival),
            RowChange(
                "merged", self.merged, f"into the row with the same '{column}', whose blank cells they fill"
            ),
            RowChange("retimed", self.stalled, f"after '{column}' stood still: {stalls}"),
            RowChange("retimed", self.coarse, coarse),
        ]
        return [change for change in changes if change.rows]


def _is_same_part(times: Floats, part: Floats, other_times: Floats, other: Floats) -> bool:
    """Whether a recording equals another one that the file contains, row by row."""
    return part.shape == other.shape and bool(
        np.array_equal(np.diff(times), np.diff(other_times)) and np.array_equal(part, other, equal_nan=True)
    )


def _merge_complements(times: Floats, part: Floats) -> Booleans:
    """Fill blank cells of a row from the next rows with the same time, in place; mark those next rows.

    Two messages with one time stamp give such rows: each has the cells that the other lacks.
    """
    merged = np.zeros(times.size, bool)
    blank = np.isnan(part)
    if not blank.any():
        return merged
    target = 0
    for row in (np.flatnonzero(np.diff(times) == 0.0) + 1).tolist():
        if times[row] != times[target]:
            target = row - 1
        if not (blank[row] | blank[target]).all() or blank[row].all():
            target = row
            continue
        part[target] = np.where(blank[target], part[row], part[target])
        blank[target] = np.isnan(part[target])
        merged[row] = True
    return merged


def _copies(times: Floats, part: Floats) -> Booleans:
    """Mark rows that a program wrote twice: they equal the row before, time included.

    On a coarse clock, rows share a time too, and rest makes them equal. Therefore only pairs count that are
    near rows that differ: there the rig moves.
    """
    is_copy = np.zeros(times.size, bool)
    # One element per pair of neighbouring rows, shape (n - 1,).
    same_time = np.diff(times) == 0.0
    if not same_time.any():
        return is_copy
    equal = ((part[1:] == part[:-1]) | (np.isnan(part[1:]) & np.isnan(part[:-1]))).all(axis=1)
    changes_before = np.concatenate(([0], np.cumsum(~equal)))
    pair = np.arange(same_time.size)
    near_start = np.maximum(pair - _NEAR_ROWS, 0)
    near_stop = np.minimum(pair + _NEAR_ROWS, same_time.size)
    changes_near = changes_before[near_stop] - changes_before[near_start]
    is_evidence = same_time & (changes_near >= _NEAR_ROWS // 2)
    is_evidence = is_evidence if is_evidence.any() else same_time
    if float(equal[is_evidence].mean()) >= _COPY_SHARE:
        is_copy[1:] = equal & same_time
        return is_copy
    # Where all other rows nearby differ, rows do not repeat by chance.
    exceptions = equal & same_time & (changes_near >= 2 * _NEAR_ROWS - 2)
    if exceptions.mean() < _MAX_CONFLICTS:
        is_copy[1:] = exceptions
    return is_copy | _repeated_blocks(times, part)


def _repeated_blocks(times: Floats, part: Floats) -> Booleans:
    """Mark blocks of rows that follow their originals within one step of a coarse clock."""
    result = np.zeros(times.size, bool)
    starts, sizes = _steps_of(times)
    # A block makes its step longer than the others by at least its own length.
    excess = sizes - np.median(sizes)
    for tick in np.flatnonzero(excess >= _MIN_HIDDEN_ROWS).tolist():
        start = int(starts[tick])
        rows = part[start : start + int(sizes[tick])]
        for length in range(2, int(excess[tick]) + 2):
            # Rows that equal the row `length` rows later; a whole run of them is a block and its copy.
            equal = (rows[length:] == rows[:-length]).all(axis=1)
            originals = [first for first, stop in runs_of(equal) if stop - first >= length]
            # At rest, all rows are equal without being copies.
            moving = [first for first in originals if np.ptp(rows[first : first + length], axis=0).any()]
            if moving:
                copy = start + moving[0] + length
                result[copy : copy + length] = True
                break
    return result


def _conflicts(times: Floats) -> Booleans:
    """Mark rows that share a time although the clock is fine: a digit of one of them is damaged.

    On a clock that jitters, a shorter step precedes or follows a longer one; on a coarse clock, many rows
    share their times.
    """
    steps = np.diff(times)
    result = np.zeros(times.size, bool)
    shared = np.flatnonzero(steps == 0.0)
    if not shared.size or shared.size > _MAX_CONFLICTS * times.size:
        return result
    typical = float(np.median(steps))
    for row in shared.tolist():
        near = np.concatenate((steps[max(row - 3, 0) : row], steps[row + 1 : row + 4]))
        if near.size and typical > 0.0 and (np.abs(near - typical) < 0.3 * typical).all():
            result[row : row + 2] = True
    return result


def _steps_of(times: Floats) -> tuple[Integers, Integers]:
    """Return the first row of each time of a coarse clock, and the number of rows that have this time."""
    starts = np.flatnonzero(np.diff(times, prepend=-np.inf) != 0.0)
    return starts, np.diff(np.append(starts, times.size))


def _without_stalls(times: Floats, unit_s: float) -> tuple[Floats, int, float, str]:
    """Count on where a clock stands still for many rows, and goes on as if they had taken no time.

    Returns the times, the number of rows that moved, the longest time that the clock lost, and what happened.
    """
    starts, sizes = _steps_of(times)
    if starts.size < _MIN_TIMES:
        return times, 0, 0.0, ""
    typical_rows = float(np.median(sizes))
    step = float(np.median(np.diff(times[starts]))) / typical_rows
    longest = max(_STALL_ROWS, _STALL_SHARE * float(np.quantile(sizes, 0.95)))
    result, moved, lost, texts = times.copy(), 0, 0.0, []
    for tick in np.flatnonzero(sizes[:-1] > longest).tolist():
        start, stop = int(starts[tick]), int(starts[tick + 1])
        # A clock that goes on with the right time has lost nothing.
        missing = (stop - start) * step - float(times[stop] - times[start])
        if missing < 0.5 * (stop - start) * step:
            continue
        result[start:stop] += step * np.arange(stop - start)
        result[stop:] += missing
        moved, lost = moved or times.size - start, max(lost, missing)
        texts.append(f"{stop - start} rows at {times[start] * unit_s:.6g} s, counted on at their usual rate")
    return result, moved, lost, ", ".join(texts)


def _counted_on(times: Floats, unit_s: float) -> tuple[Floats, int, str]:
    """Spread rows that share a time; return times, the number of these rows, and the way in words."""
    shared = np.zeros(times.size, bool)
    shared[1:] = np.diff(times) == 0.0
    count = int(shared.sum())
    if not count or times.size < _MIN_TIMES:
        return times, 0, ""
    starts, sizes = _steps_of(times)
    ticks = times[starts]
    if ticks.size < 2:
        raise FlightDataError(f"all {times.size} rows have the same time {times[0]:g}", NO_CLOCK)
    first_s = float(times[int(np.argmax(shared))]) * unit_s
    about = f"up to {int(sizes.max())} rows per time, from {first_s:.6g} s on"
    rows = np.arange(times.size, dtype=np.float64)
    lengths = np.diff(ticks)
    # Times with a fixed number of digits are coarsest at the end of the file.
    resolution = float(np.median(lengths[-max(1, lengths.size // 5) :]))
    # The first and the last time may have lost rows, so that their rows are not in the middle of a tick.
    middles = starts + 0.5 * (sizes - 1.0)
    time_per_row, _ = _line(middles[1:-1], ticks[1:-1]) if ticks.size > 3 else _line(rows, times)
    start = float(np.mean(times - time_per_row * rows))
    even: Floats = start + time_per_row * rows
    # If no time is farther from the line than rounding explains, the rows were recorded evenly.
    if time_per_row > 0.0 and np.abs(times - even).max() <= 1.05 * max(resolution, time_per_row):
        rate_Hz = 1.0 / (time_per_row * unit_s)
        return even, count, f"{about}; the rows were counted on evenly at {rate_Hz:.6g} Hz"
    typical = float(np.median(lengths))
    # The rows before a gap do not spread over it.
    longest = typical * np.maximum(1.0, sizes / np.median(sizes))
    lengths = np.minimum(np.append(lengths, typical), longest)
    place_in_tick = rows - np.repeat(starts, sizes)
    spread: Floats = np.repeat(ticks, sizes) + place_in_tick * np.repeat(lengths / sizes, sizes)
    return spread, count, f"{about}; the rows were spread evenly within each step of the clock"


def _hidden_time(times: Floats) -> float:
    """Return how long the gaps are within one step of a coarse clock, in the unit of the times.

    A step with fewer rows than the others has lost some, at a place that the clock does not show.
    """
    starts, sizes = _steps_of(times)
    if starts.size < _MIN_TIMES:
        return 0.0
    # The first step may have begun before the file, and the last one goes on after it.
    whole, lengths = sizes[:-1], np.diff(times[starts])
    typical = float(np.median(whole))
    lost = float(np.max(typical - whole[1:], initial=0.0))
    return lost * float(np.median(lengths)) / typical if lost >= _MIN_HIDDEN_ROWS else 0.0


def _line(rows: Floats, times: Floats) -> tuple[float, float]:
    """Return slope and start of the straight line through `times`."""
    centre, middle = float(rows.mean()), float(times.mean())
    slope = float(((rows - centre) @ (times - middle)) / ((rows - centre) @ (rows - centre)))
    return slope, middle - slope * centre


def settle_blank_cells(
    table: Table, t_s: Floats, held: Collection[str], interpolated: Collection[str], max_missing: float
) -> tuple[Table, Floats]:
    """Bring columns of several rates to the rows of the fastest one of the columns that are used.

    Values of `held` columns last until the next one; between the values of `interpolated` columns lies a
    straight line. A value is used for `max_missing` intervals of its column. Rows that still lack a value
    are left out.
    """
    used = [name for name in table.columns if name in held or name in interpolated]
    has_number = {name: np.isfinite(table.columns[name].values) for name in used}
    if all(cells.all() for cells in has_number.values()):
        return table, t_s
    fastest = max(used, key=lambda name: int(has_number[name].sum()))
    is_base = has_number[fastest]
    # A column of another rate lacks many of these rows; damage blanks only a few.
    sparse = [
        name
        for name in used
        if has_number[name].any() and (has_number[name] & is_base).sum() < _SAME_RATE_SHARE * is_base.sum()
    ]
    columns = dict(table.columns)
    for name in sparse:
        values = _carried(columns[name].values, t_s, has_number[name], name in held, max_missing)
        columns[name] = replace(columns[name], values=values)
    is_kept = is_base & np.logical_and.reduce([np.isfinite(columns[name].values) for name in used])
    changes = []
    is_lost = ~is_kept
    if sparse:
        names = ", ".join(f"'{name}'" for name in sparse)
        # Rows between those of the fastest column: their values went to its rows.
        is_merged = ~is_base & np.logical_or.reduce([has_number[name] for name in used])
        is_lost &= ~is_merged
        if is_merged.any():
            changes.append(
                RowChange("merged", int(is_merged.sum()), f"with {names}, which have another rate")
            )
        is_completed = is_kept & ~np.logical_and.reduce([has_number[name] for name in sparse])
        how = "voltages were held, and angles interpolated"
        changes.append(
            RowChange("completed", int(is_completed.sum()), f"that lack {names}, of another rate: {how}")
        )
    if is_lost.any():
        lacking = [name for name in used if not np.isfinite(columns[name].values[is_lost]).all()]
        columns_text = " or ".join(f"'{name}'" for name in lacking)
        first_s = float(t_s[int(np.argmax(is_lost))])
        reason = f"without a number in {columns_text} (first at {first_s:.3f} s)"
        changes.append(RowChange("left out", int(is_lost.sum()), reason))
    kept = np.flatnonzero(is_kept)
    return replace(table, columns=columns).selected(kept, changes), t_s[kept]


def _carried(values: Floats, t_s: Floats, known: Booleans, is_held: bool, max_missing: float) -> Floats:
    """Fill the blank cells of a column between its values, up to `max_missing` typical intervals long."""
    at = np.flatnonzero(known)
    interval_s = float(np.median(np.diff(t_s[at]))) if at.size > 1 else 0.0
    rows = np.arange(values.size)
    last = np.searchsorted(at, rows, side="right") - 1
    after = np.searchsorted(at, rows, side="left")
    has_last, has_next = last >= 0, after < at.size
    last, after = np.clip(last, 0, None), np.clip(after, None, at.size - 1)
    filled: Floats = values[at[last]] if is_held else interpolated_angle(t_s, t_s[at], values[at])
    distance_s = (t_s if is_held else t_s[at[after]]) - t_s[at[last]]
    usable = has_last & (has_next | is_held) & (distance_s <= max_missing * interval_s) & (distance_s >= 0.0)
    result: Floats = np.where(usable | known, filled, np.nan)
    return result


def equal_runs(t_s: Floats, values: Floats) -> list[tuple[int, int]]:
    """Find the parts in which all columns repeat the row before, while the time goes on.

    Returns the first row of each part and the row after its last. Shapes: `t_s` (n,), `values` (n, columns).
    """
    equal = (values[1:] == values[:-1]).all(axis=1) & (np.diff(t_s) > 0.0)
    return [(start, stop + 1) for start, stop in runs_of(equal)]


def spikes(values: Floats) -> Booleans:
    """Mark single values that jump away from their neighbours and back, as damaged digits do. Shape: (n,)."""
    result = np.zeros(values.size, bool)
    if values.size < _MIN_TIMES:
        return result
    steps = np.abs(np.diff(values))
    # A slow angle at a high rate stays in most rows.
    typical = float(np.quantile(steps, 0.95)) or float(np.median(steps[steps > 0.0])) if steps.any() else 0.0
    is_spike = np.minimum(steps[:-1], steps[1:]) > _SPIKE_STEPS * typical
    is_spike &= np.abs(values[2:] - values[:-2]) <= 3.0 * typical
    if typical > 0.0 and is_spike.sum() < _MAX_SPIKES * values.size:
        result[1:-1] = is_spike | _is_substitute(values, is_spike)
    return result | substitutes(values)


def substitutes(values: Floats) -> Booleans:
    """Mark the rows with a number far beyond all others, such as -999, which a program writes for as long as
    it has no value. Shape: (n,).
    """
    result = np.zeros(values.size, bool)
    if not values.size:
        return result
    for number in (values.min(), values.max()):
        has_number = values == number
        # A single row is a spike, and a number in many rows is a measurement.
        if has_number.sum() < 2 or has_number.mean() > _MAX_SUBSTITUTES:
            continue
        others = values[~(has_number | result)]
        # Only other values that vary show what is far.
        if not others.size or not np.ptp(others) > 0.0:
            continue
        distance = max(float(others.min()) - number, number - float(others.max()))
        is_beyond = distance > _FAR_RANGES * float(np.ptp(others))
        # Motors that are off before a flight have a voltage that is beyond the others, but small.
        is_large = abs(number) > _FAR_RATIO * float(np.abs(others).max())
        if is_beyond and is_large:
            result |= has_number
    return result


def _is_substitute(values: Floats, is_spike: Booleans) -> Booleans:
    """Mark single rows with the number that a program writes instead of a value, such as -1 or 999: spikes
    share it, and its other rows may be close to their neighbours. Shapes: (n,), `is_spike` (n - 2,).
    """
    numbers, counts = np.unique(values[1:-1][is_spike], return_counts=True)
    result = np.zeros(is_spike.size, bool)
    if counts.max(initial=0) < _MIN_SUBSTITUTES:
        return result
    number = numbers[counts.argmax()]
    others = np.flatnonzero(values != number)
    place = np.searchsorted(others, np.arange(1, values.size - 1))
    before, after = others[np.maximum(place - 1, 0)], others[np.minimum(place, others.size - 1)]
    # Between its neighbours, the number may be the value.
    is_beyond = (number - values[before]) * (number - values[after]) > 0.0
    result |= (values[1:-1] == number) & is_beyond
    return result if result.mean() < _MAX_SPIKES * 2.0 else np.zeros(is_spike.size, bool)


def is_active(part: Floats, whole: Floats) -> bool:
    """Whether the steps in a `part` of a column are as frequent as in the `whole`, and as large.

    The steps of a column that settles become rarer and smaller.
    """
    moving, typical = np.abs(part[part != 0.0]), np.abs(whole[whole != 0.0])
    if not moving.size or moving.size < _ACTIVE_SHARE * part.size * typical.size / whole.size:
        return False
    return bool(np.median(moving) > _ACTIVE_SIZE * np.median(typical))


def runs_of(mask: Booleans) -> list[tuple[int, int]]:
    """Return the first row of each run of true rows, and the row after its last. Shapes: `mask` (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], mask.astype(int), [0]))))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
