"""Parts of flights: the beginning and the rest of a flight, and two folds of several."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from heli_lab.fit.records import Record
from heli_lab.fit.thresholds import MIN_SEGMENT_S


def split(record: Record, seconds: float) -> tuple[Record, Record]:
    """Split the free flight of a `record` after so many `seconds`."""
    rows_left = round(seconds / record.step_s)
    beginning, rest = [], []
    for start, stop in record.segments:
        split_row = min(stop, start + rows_left)
        rows_left -= split_row - start
        if split_row > start:
            beginning.append((start, split_row))
        if stop > split_row:
            rest.append((split_row, stop))
    min_rows = round(MIN_SEGMENT_S / record.step_s)
    long_segments = [(start, stop) for start, stop in rest if stop - start >= min_rows]
    return replace(record, segments=tuple(beginning)), replace(record, segments=tuple(long_segments or rest))


def two_folds(records: Sequence[Record]) -> tuple[tuple[Record, ...], tuple[Record, ...]]:
    """Divide flights (`records`) into two folds: the first and the second half of the flights, or of the free
    flight if there is only one.
    """
    if len(records) > 1:
        middle = (len(records) + 1) // 2
        return tuple(records[:middle]), tuple(records[middle:])
    first, second = split(records[0], 0.5 * records[0].used_s)
    return (first,), (second,)
